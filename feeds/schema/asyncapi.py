"""The AsyncAPI 3 document: what a session publishes and receives over MQTT."""

from __future__ import annotations

import json
import re
from functools import lru_cache
from importlib.metadata import version
from importlib.resources import files
from typing import Any

from google.protobuf.descriptor import Descriptor

from plotfeed.feeds.messages.message import MESSAGE_EXPIRY_S
from plotfeed.feeds.schema.flows import OURS, Flow, flows
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.content_types import JSON, PROTOBUF
from plotfeed.proto.json_schemas import json_schema
from plotfeed.proto.message_kinds import OUR_MESSAGES

BINDING = "0.2.0"
# Where a definition of our protobuf schema begins, with what is said before it.
DEFINITION = re.compile(r"\n\n(?=(?://.*\n)*(?:message|enum) \w+ \{)")
NAME = re.compile(r"(?m)^(?:message|enum) (\w+) \{")
CLOUD_EVENTS: dict[str, dict[str, Any]] = {
    "specversion": {"const": "1.0"},
    "id": {"type": "string", "description": "Unique among those of its source."},
    "source": {"type": "string", "description": "Prefix and sensor, or the prefix."},
    "time": {"type": "string", "format": "date-time", "description": "Of what it tells of."},
}
ATTRIBUTES: dict[str, dict[str, Any]] = {
    "sensor": {"type": "string"},
    "drone": {"type": "string"},
    "scan": {"type": "string", "pattern": "^[0-9]+$", "description": "floor(time / period)"},
    "sector": {"type": "string", "pattern": "^[0-9]+$", "description": "0 begins at north."},
}
PARAMETERS = {
    "prefix": {
        "description": "One or more levels: mqtt.prefix of the scene.",
        "default": "plotfeed",
        "examples": ["plotfeed", "north/site/7"],
    },
    "sensor": {"description": "The sensor's id in the scene.", "examples": ["radar"]},
    "drone": {
        "description": "Any name of 1 to 64 printable characters without / + #.",
        "examples": ["phantom-4"],
    },
}
DESCRIPTION = (
    "Plots of simulated counter-UAS sensors. Header objects are user properties of MQTT 5, the "
    "attributes of CloudEvents 1.0 in binary mode; over MQTT 3.1.1 they are left out, and so are "
    "content types. Where an operation has x-qos, the scene's mqtt.qos tells which; x-needs says "
    "what must be so that there are any such messages."
)


def document() -> dict[str, Any]:
    """The whole AsyncAPI document."""
    found = flows()
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "plotfeed",
            "version": version("plotfeed"),
            "description": DESCRIPTION,
            "license": {"name": "Apache-2.0"},
        },
        "servers": _servers(),
        "channels": _channels(found),
        "operations": {_operation_name(flow): _operation(flow) for flow in found},
        "components": {
            "messages": {flow.name: _message(flow) for flow in found},
            "schemas": _schemas(),
            "securitySchemes": {
                "password": {"type": "userPassword"},
                "certificate": {"type": "X509"},
            },
        },
    }


def _servers() -> dict[str, Any]:
    embedded = "The embedded broker's usual port, on loopback; `plotfeed run` tells others."
    return {
        "embedded5": _server("127.0.0.1:1883", "mqtt", "5.0", embedded),
        "embedded3": _server("127.0.0.1:1883", "mqtt", "3.1.1", embedded),
        "browsers": {
            "host": "127.0.0.1:1884",
            "protocol": "ws",
            "description": "MQTT over WebSocket, subprotocol mqtt, for the pages that "
            f"mqtt.embedded.websocket_origins names. {embedded}",
        },
        "yours": {
            **_server("{host}:{port}", "secure-mqtt", "5.0", "A broker of your own: mqtts://."),
            "variables": {"host": {"default": "localhost"}, "port": {"default": "8883"}},
            "security": [
                {"$ref": "#/components/securitySchemes/password"},
                {"$ref": "#/components/securitySchemes/certificate"},
            ],
        },
    }


def _server(host: str, protocol: str, number: str, description: str) -> dict[str, Any]:
    return {
        "host": host,
        "protocol": protocol,
        "protocolVersion": number,
        "description": description,
    }


def _channels(found: list[Flow]) -> dict[str, Any]:
    """One for each address, named by what is on it."""
    channels: dict[str, Any] = {}
    for flow in found:
        channel = channels.setdefault(
            channel_name(flow),
            {
                "address": flow.address,
                "messages": {},
                "parameters": {
                    name: value
                    for name, value in PARAMETERS.items()
                    if f"{{{name}}}" in flow.address
                },
            },
        )
        channel["messages"][flow.name] = {"$ref": f"#/components/messages/{flow.name}"}
        if flow.sensors:
            channel["x-sensor-types"] = list(flow.sensors)
    return channels


def channel_name(flow: Flow) -> str:
    """The name of the channel that a flow is on."""
    levels = [level for level in flow.address.split("/") if not level.startswith("{")]
    return "-".join(levels)


def _operation_name(flow: Flow) -> str:
    verb = "receive" if flow.inbound else "send"
    return f"{verb}{flow.name[0].upper()}{flow.name[1:]}"


def _operation(flow: Flow) -> dict[str, Any]:
    channel = f"#/channels/{channel_name(flow)}"
    binding: dict[str, Any] = {"bindingVersion": BINDING}
    if flow.inbound:
        binding["qos"] = 1  # with which we subscribe
    else:
        binding |= {"qos": flow.qos or 0, "retain": flow.retain}
        if not flow.retain:
            binding["messageExpiryInterval"] = MESSAGE_EXPIRY_S
    operation: dict[str, Any] = {
        "action": "receive" if flow.inbound else "send",
        "channel": {"$ref": channel},
        "summary": flow.summary,
        "messages": [{"$ref": f"{channel}/messages/{flow.name}"}],
        "bindings": {"mqtt": binding},
    }
    if flow.qos is None and not flow.inbound:
        operation["x-qos"] = [0, 1]
    if flow.needs:
        operation["x-needs"] = flow.needs
    return operation


def _message(flow: Flow) -> dict[str, Any]:
    message: dict[str, Any] = {"name": flow.name, "contentType": flow.content_type}
    if not flow.inbound:
        properties = {
            **CLOUD_EVENTS,
            "type": {"const": flow.kind},
            **{name: ATTRIBUTES[name] for name in flow.attributes},
        }
        message["headers"] = {
            "type": "object",
            "properties": properties,
            "required": list(properties),
            "additionalProperties": False,
        }
    message["payload"] = _payload(flow)
    if flow.name in _examples():  # formats that others add have none
        message["examples"] = [_example(flow)]
    if flow.message:
        message["x-protobuf-message"] = flow.message
    return message


def _example(flow: Flow) -> dict[str, Any]:
    payload = _examples()[flow.name]
    if isinstance(payload, str):
        return {"summary": "The octets in base64.", "payload": payload}
    if flow.content_type != JSON and flow.schema is None:
        return {"summary": "The fields, as in JSON.", "payload": payload}
    return {"payload": payload}


@lru_cache
def _examples() -> dict[str, Any]:
    text = files("plotfeed.feeds.schema").joinpath("message_examples.json").read_text("utf-8")
    found: dict[str, Any] = json.loads(text)
    return found


def _payload(flow: Flow) -> dict[str, Any]:
    if flow.schema is not None:
        return dict(flow.schema)
    if flow.content_type == JSON:
        descriptor = pb.DESCRIPTOR.message_types_by_name[flow.message.rpartition(".")[2]]
        return json_schema(descriptor, flow.required)
    if flow.content_type.startswith(PROTOBUF) and flow.message.startswith(f"{OURS}."):
        return {"$ref": f"#/components/schemas/{flow.message.rpartition('.')[2]}"}
    return {"type": "string", "format": "binary", "description": flow.summary}


IMPORT = 'import "plotfeed/proto/plotfeed.proto";\n'


def messages_schema() -> str:
    """The protobuf schema of our messages, the ledger's behind the others."""
    ours, ledger = (
        files("plotfeed.proto").joinpath(f"{name}.proto").read_text("utf-8").rstrip()
        for name in ("plotfeed", "ledger")
    )
    return f"{ours}\n{ledger.partition(IMPORT)[2]}"


def _schemas() -> dict[str, Any]:
    """A protobuf schema for each message, since validators take a text of one root alone."""
    proto3 = "application/vnd.google.protobuf;version=3"
    roots = {
        flow.message.rpartition(".")[2]
        for flow in flows()
        if flow.content_type.startswith(PROTOBUF) and flow.message.startswith(f"{OURS}.")
    }
    return {root: {"schemaFormat": proto3, "schema": _schema_of(root)} for root in sorted(roots)}


def _schema_of(root: str) -> str:
    """What our protobuf schema says of that message, and of what is in it."""
    needed = _names_in(OUR_MESSAGES[f"{OURS}.{root}"].DESCRIPTOR)
    head, *blocks = DEFINITION.split(messages_schema())
    kept = [block for block in blocks if (found := NAME.search(block)) and found[1] in needed]
    return "\n\n".join([head.strip(), *(block.strip() for block in kept)])


def _names_in(message: Descriptor) -> set[str]:
    """The message's name, and those of messages and enumerations that it holds."""
    names = {message.name}
    for field in message.fields:
        if field.enum_type is not None:
            names.add(field.enum_type.name)
        elif field.message_type is not None and field.message_type.file.package == OURS:
            names |= _names_in(field.message_type)
    return names

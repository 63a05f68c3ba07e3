"""The AsyncAPI 3 document: what a session publishes and receives over MQTT."""

from __future__ import annotations

import base64
import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.metadata import version
from importlib.resources import files
from typing import Any

from google.protobuf.descriptor import Descriptor
from google.protobuf.json_format import MessageToDict

from plotfeed.feeds.formats import FORMATS
from plotfeed.feeds.messages.message import MESSAGE_EXPIRY_S, type_of
from plotfeed.feeds.scene.changes import Command
from plotfeed.feeds.scene.claim_keys import CLAIMED, COOPERATIVE
from plotfeed.feeds.scene.report_formats import CUE_TOPIC
from plotfeed.feeds.scene.sensors import SENSORS
from plotfeed.feeds.scene.sensors.mount_keys import Cue
from plotfeed.feeds.scene.sensors.sensor_keys import SensorGeometry
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.content_types import JSON, PROTOBUF, asterix_content_type
from plotfeed.proto.json_schemas import json_schema
from plotfeed.proto.message_kinds import OUR_MESSAGES

OURS = "plotfeed.v1"
OF_SENSOR = ("sensor",)
OF_SECTOR = ("sensor", "scan", "sector")
# Without which telemetry is refused.
REQUIRED = ("time_utc", "latitude_deg", "longitude_deg", "altitude_m", "altitude_reference")


@dataclass(frozen=True, slots=True, kw_only=True)
class Flow:
    """One kind of message on one topic."""

    name: str
    address: str  # The topic; {prefix}, {sensor} and {drone} stand for what differs
    content_type: str
    summary: str
    message: str = ""  # The protobuf message that it is, in protobuf or in JSON
    attributes: tuple[str, ...] = ()  # User properties besides those that CloudEvents demands
    kind: str = ""  # Its CloudEvents type
    qos: int | None = None  # None is what the scene says
    retain: bool = False
    needs: str = ""  # What must be so that there are any, if there need not be
    sensors: tuple[str, ...] = ()  # Types of sensors that publish it
    inbound: bool = False
    required: tuple[str, ...] | None = None  # Keys of JSON; None is what protobuf always writes
    schema: Mapping[str, Any] | None = None  # Of JSON that is no protobuf message


def flows() -> list[Flow]:
    """Everything that flows, from sensors first."""
    found: dict[str, Flow] = {}
    for name in sorted(FORMATS):
        for flow in _of_format(name):
            before = found.get(flow.name, flow)
            sensors = sorted({*flow.sensors, *before.sensors})
            found[flow.name] = replace(flow, sensors=tuple(sensors))
    return [*found.values(), *_of_session(), *_coming_in()]


def types_that_report(name: str) -> tuple[str, ...]:
    """Sensor types whose scene may ask for that format."""
    return tuple(kind for kind, keys in SENSORS.items() if name in keys.formats)


def _of_format(name: str) -> Iterator[Flow]:
    sensors = types_that_report(name)
    facts = FORMATS[name].facts
    if facts.categories:
        for category, sent in facts.categories.items():
            yield _asterix(
                category,
                sent.summary,
                address=f"{{prefix}}/{{sensor}}/asterix/{category:03d}",
                attributes=OF_SECTOR,
                sensors=tuple(
                    kind
                    for kind in sensors
                    if SENSORS[kind].geometry is SensorGeometry.BISTATIC
                    or not sent.has_illuminators
                ),
            )
        return
    announces = bool(facts.inbox)
    plots = Flow(
        name=f"{name}Detections" if announces else name,
        address=f"{{prefix}}/{{sensor}}/{facts.topic}",
        content_type=facts.content_type,
        summary=facts.summary,
        message=facts.message,
        attributes=OF_SECTOR,
        kind=type_of(facts.topic),
        sensors=sensors,
        schema=facts.schema,
    )
    yield plots
    for what in ("registration", "status", "goodbye", "answer") if announces else ():
        yield replace(
            plots,
            name=f"{name}{what.capitalize()}",
            summary=plots.summary.replace("detections", what),
            attributes=OF_SENSOR,
            kind=f"plotfeed.{name}.{what}",
            qos=1,
            retain=what in {"registration", "goodbye"},
            needs="somebody asked something" if what == "answer" else "",
        )
    if facts.inbox:
        yield Flow(
            name=f"{name}Task",
            address=f"{{prefix}}/{{sensor}}/{facts.inbox}",
            content_type=facts.content_type,
            summary=plots.summary.replace("detections", "something that a sensor is asked to do"),
            message=facts.message,
            sensors=sensors,
            inbound=True,
        )


def _asterix(category: int, summary: str, **more: Any) -> Flow:
    return Flow(
        name=f"asterix{category:03d}",
        content_type=asterix_content_type(category),
        summary=f"An ASTERIX data block of category {category:03d}: {summary}.",
        kind=f"plotfeed.asterix.{category:03d}",
        **more,
    )


def _below(name: str, summary: str, *, of: str = "{prefix}", **more: Any) -> Flow:
    """A flow, of JSON unless told otherwise, on the topic of its name below those levels."""
    how = {"kind": f"plotfeed.{name}", "content_type": JSON, "address": f"{of}/{name}", **more}
    return Flow(name=name, summary=summary, **how)


def _of_session() -> Iterator[Flow]:
    retained: dict[str, Any] = {"qos": 1, "retain": True}
    of_sensor = {"of": "{prefix}/{sensor}", "attributes": OF_SENSOR, **retained}
    yield _below(
        "status",
        "A sensor's state, every 5 s, at the end, and as a last will.",
        message=f"{OURS}.SensorStatus",
        **of_sensor,
    )
    yield _below(
        "settings",
        "What the keys of a sensor are at the moment, and which control has changed.",
        schema=_object("sensor time_utc: string, controlled in_force: object"),
        **of_sensor,
    )
    yield _below(
        "description",
        "What a sensor is, where it stands, what it covers, how well and where it reports.",
        message=f"{OURS}.SensorDescription",
        **of_sensor,
    )
    yield _below(
        "session",
        "Which scene runs, or has run: at the start, at the end, as a last will, when "
        "another session is heard, and when a clock faster than the world's reaches another speed.",
        schema=_object(
            "session state: string, heard: array, scene: string, seed: integer, start_utc: string, "
            "start_utc_ns tick_ms: integer, sensors: array, site: object, plotfeed: string, "
            "speed speed_reached: number?"
        ),
        **retained,
    )
    yield _below(
        "truth",
        "The ledger of sectors: whose plot is whose, what was missed. Not for trackers.",
        content_type=f"{PROTOBUF}; messageType={OURS}.LedgerBatch",
        message=f"{OURS}.LedgerBatch",
        qos=0,
        needs="mqtt.truth is not false",
    )
    yield _below(
        "score",
        "How the tracker under test and the feed do, once a second. Not for trackers.",
        qos=0,
        needs="page.tracks_topic says where a tracker publishes, and mqtt.truth is not false",
        schema=_object(
            "time_utc tracks_topic: string, cutoff_m: number, dimensions drones tracks reports "
            "unreadable: integer, problem: string, now: object, window_s: integer, window: object, "
            "feed_false_rate: number, feed: array"
        ),
    )
    yield _below(
        "errors",
        "Telemetry or a command that was refused, and why.",
        message=f"{OURS}.Refusal",
        qos=0,
        needs="something was refused",
    )
    yield _asterix(
        129,
        "what a cooperative drone says of itself",
        address=f"{{prefix}}/{COOPERATIVE}/asterix/129",
        attributes=("drone",),
        needs="[cooperative] has asterix-129 in its report",
    )
    for name, content_type in (
        ("Json", JSON),
        ("Protobuf", f"{PROTOBUF}; messageType={OURS}.Telemetry"),
    ):
        yield Flow(
            name=f"claimed{name}",
            address=f"{{prefix}}/{CLAIMED}/{{drone}}",
            content_type=content_type,
            summary="What a cooperative drone says of itself, as telemetry.",
            message=f"{OURS}.Telemetry",
            attributes=("drone",),
            kind="plotfeed.claimed",
            needs=f"[cooperative] has {name.lower()} in its report",
            required=REQUIRED,
        )


def _coming_in() -> Iterator[Flow]:
    for name, content_type, message in (
        ("Protobuf", PROTOBUF, f"{OURS}.Telemetry"),
        ("Json", JSON, f"{OURS}.Telemetry"),
        ("Asterix129", asterix_content_type(129), ""),
    ):
        yield Flow(
            name=f"telemetry{name}",
            address="{prefix}/telemetry/{drone}",
            content_type=content_type,
            summary="Where a drone is.",
            message=message,
            inbound=True,
            required=REQUIRED,
        )
    yield _below(
        "control",
        "What is to be otherwise from now on: keys of a sensor, or a simulated clock.",
        inbound=True,
        schema=_inlined(Command.model_json_schema()),
    )
    yield _below(
        CUE_TOPIC,
        "Where the mount of a sensor is to look, for a while.",
        of="{prefix}/{sensor}",
        sensors=tuple(kind for kind, keys in SENSORS.items() if "mount" in keys.model_fields),
        inbound=True,
        schema=_inlined(Cue.model_json_schema()),
    )


def _object(types: str) -> dict[str, Any]:
    """The schema of an object with the keys in "KEY KEY: TYPE, KEY: TYPE".

    It has all of them but those whose type ends with "?".
    """
    properties: dict[str, Any] = {}
    required = []
    for names, _, kind in (alike.partition(": ") for alike in types.split(", ")):
        for name in names.split():
            properties[name] = {"type": kind.removesuffix("?")}
            required += [] if kind.endswith("?") else [name]
    return {"type": "object", "properties": properties, "required": required}


def _inlined(schema: dict[str, Any]) -> dict[str, Any]:
    """A schema of pydantic's with its definitions where they are referred to."""
    definitions = schema.pop("$defs", {})

    def inlined(value: Any) -> Any:
        if isinstance(value, list):
            return [inlined(inner) for inner in value]
        if not isinstance(value, dict):
            return value
        if "$ref" in value:
            return inlined(definitions[value["$ref"].rpartition("/")[2]])
        # OpenAPI's discriminator is an object; AsyncAPI's is another thing, and refuses it.
        return {key: inlined(inner) for key, inner in value.items() if key != "discriminator"}

    inside: dict[str, Any] = inlined(schema)
    return inside


BINDING = "0.2.0"
MOST_OCTETS = 1200  # Of an example, unless no message is so short
# Where a definition of our protobuf schema begins, with what is said before it.
DEFINITION = re.compile(r"\n\n(?=(?://.*\n)*(?:message|enum) \w+ \{)")
NAME = re.compile(r"(?m)^(?:message|enum) (\w+) \{")


@lru_cache
def _fixed() -> Mapping[str, Any]:
    """What stands fixed in the document, and what its parts may have, from asyncapi.toml."""
    return tomllib.loads(
        files("plotfeed.feeds.schema").joinpath("asyncapi.toml").read_text("utf-8")
    )


def document() -> dict[str, Any]:
    """The whole AsyncAPI document."""
    found, fixed = flows(), _fixed()
    return {
        "asyncapi": fixed["asyncapi"],
        "info": fixed["info"] | {"version": version("plotfeed")},
        "servers": fixed["servers"],
        "channels": _channels(found),
        "operations": {_operation_name(flow): _operation(flow) for flow in found},
        "components": {
            "messages": {flow.name: _message(flow) for flow in found},
            "schemas": _schemas(),
            "securitySchemes": fixed["securitySchemes"],
        },
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
                    for name, value in _fixed()["parameters"].items()
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
            **_fixed()["cloud_events"],
            "type": {"const": flow.kind},
            **{name: _fixed()["attributes"][name] for name in flow.attributes},
        }
        message["headers"] = {
            "type": "object",
            "properties": properties,
            "required": list(properties),
            "additionalProperties": False,
        }
    message["payload"] = _payload(flow)
    if (example := _example(flow)) is not None:
        message["examples"] = [example]
    if flow.message:
        message["x-protobuf-message"] = flow.message
    return message


def _example(flow: Flow) -> dict[str, Any] | None:
    """The longest of short messages, or the first; None of a format that others add."""
    # Telemetry that comes in is as what cooperative drones say.
    kind = "plotfeed.claimed" if flow.message.endswith(".Telemetry") else flow.kind
    kind = "plotfeed.asterix.129" if flow.name == "telemetryAsterix129" else kind
    found = _payloads().get(flow.name) or _payloads().get(kind) or []
    if not found:
        return None
    payload = max([each for each in found if len(each) <= MOST_OCTETS] or found[:1], key=len)
    if "json" in flow.content_type or kind == "plotfeed.claimed":
        fields = json.loads(payload)
    elif flow.message in OUR_MESSAGES:
        message = OUR_MESSAGES[flow.message].FromString(payload)
        fields = MessageToDict(message, preserving_proto_field_name=True)
    else:
        octets = base64.b64encode(payload).decode()
        return {"summary": "The octets in base64.", "payload": octets}
    as_json = {"summary": "The fields, as in JSON."} if "json" not in flow.content_type else {}
    return {**as_json, "payload": fields}


@lru_cache
def _payloads() -> Mapping[str, Sequence[bytes]]:
    from plotfeed.feeds.schema.examples import payloads  # which other schemas do without

    return payloads()


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

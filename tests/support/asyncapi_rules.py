"""What AsyncAPI 3.0 asks of a document, as far as ours goes: names, what must be there, references.

From the specification's tables of fields; MQTT bindings 0.2.0. Extensions begin with x-.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import jsonschema

# What each kind of object must and what it may have.
FIELDS: Mapping[str, tuple[set[str], set[str]]] = {
    "document": (
        {"asyncapi", "info"},
        {"id", "servers", "defaultContentType", "channels", "operations", "components"},
    ),
    "info": (
        {"title", "version"},
        {"description", "termsOfService", "contact", "license", "tags", "externalDocs"},
    ),
    "server": (
        {"host", "protocol"},
        {"protocolVersion", "pathname", "description", "title", "summary", "variables", "security"}
        | {"tags", "externalDocs", "bindings"},
    ),
    "channel": (
        set(),
        {"address", "messages", "title", "summary", "description", "servers", "parameters"}
        | {"tags", "externalDocs", "bindings"},
    ),
    "parameter": (set(), {"enum", "default", "description", "examples", "location"}),
    "operation": (
        {"action", "channel"},
        {"title", "summary", "description", "security", "tags", "externalDocs", "bindings"}
        | {"traits", "messages", "reply"},
    ),
    "message": (
        set(),
        {"headers", "payload", "correlationId", "contentType", "name", "title", "summary"}
        | {"description", "tags", "externalDocs", "bindings", "examples", "traits"},
    ),
    "mqtt": (set(), {"qos", "retain", "messageExpiryInterval", "bindingVersion"}),
    "reference": ({"$ref"}, set()),
}


def problems(api: Mapping[str, Any]) -> list[str]:
    """What breaks the rules, a line each."""
    return list(_problems(api))


def _problems(api: Mapping[str, Any]) -> Iterator[str]:
    yield from _fields("document", "", api)
    yield from _fields("info", "info", api["info"])
    if api["asyncapi"] != "3.0.0":
        yield "asyncapi: not 3.0.0"
    for name, server in api.get("servers", {}).items():
        yield from _fields("server", f"servers/{name}", server)
    for name, channel in api.get("channels", {}).items():
        yield from _channel(f"channels/{name}", channel)
    for name, operation in api.get("operations", {}).items():
        yield from _operation(f"operations/{name}", operation)
    for name, message in api.get("components", {}).get("messages", {}).items():
        yield from _message(f"messages/{name}", message)


def _fields(kind: str, where: str, value: Any) -> Iterator[str]:
    if not isinstance(value, dict):
        yield f"{where}: {kind} is no object"
        return
    must, may = FIELDS[kind]
    given = {key for key in value if not key.startswith("x-")}
    yield from (f"{where}: {kind} lacks {key}" for key in sorted(must - given))
    yield from (f"{where}: {kind} has {key}" for key in sorted(given - must - may))


def _channel(where: str, channel: Any) -> Iterator[str]:
    yield from _fields("channel", where, channel)
    for name, message in channel.get("messages", {}).items():
        yield from _fields("reference", f"{where}/messages/{name}", message)
    parameters = channel.get("parameters", {})
    for name, parameter in parameters.items():
        yield from _fields("parameter", f"{where}/parameters/{name}", parameter)
        if f"{{{name}}}" not in channel["address"]:
            yield f"{where}: parameter {name} is not in the address"


def _operation(where: str, operation: Any) -> Iterator[str]:
    yield from _fields("operation", where, operation)
    if operation.get("action") not in {"send", "receive"}:
        yield f"{where}: action is neither send nor receive"
    for reference in (operation["channel"], *operation.get("messages", [])):
        yield from _fields("reference", where, reference)
    for reference in operation.get("messages", []):
        if not reference["$ref"].startswith(f"{operation['channel']['$ref']}/messages/"):
            yield f"{where}: a message that is not of its channel"
    mqtt = operation.get("bindings", {}).get("mqtt", {})
    yield from _fields("mqtt", f"{where}/bindings/mqtt", mqtt)
    if mqtt.get("qos", 0) not in {0, 1, 2} or not isinstance(mqtt.get("retain", False), bool):
        yield f"{where}/bindings/mqtt: qos or retain is none"


def _message(where: str, message: Any) -> Iterator[str]:
    yield from _fields("message", where, message)
    headers = message.get("headers", {})
    if headers and headers.get("type") != "object":
        yield f"{where}: headers are no object"
    for schema in (headers, message.get("payload", {})):
        if "schemaFormat" in schema:
            continue
        try:
            jsonschema.Draft7Validator.check_schema(schema)
        except jsonschema.SchemaError as error:
            yield f"{where}: {error.message}"

"""Channels of MCAP: what a series of messages has in common, its schema and its properties."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from json.encoder import encode_basestring as quoted

from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import Default

from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.content_types import (
    ASTERIX,
    GEOJSON,
    JSON,
    PROTOBUF,
    TELEMETRY,
    message_type,
    protobuf_content_type,
    schema_name,
)
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.json_schemas import JSON_SCHEMAS, json_schema
from plotfeed.replay.recorded import Recorded, Stage

Properties = tuple[tuple[str, str], ...]

_decode = json.JSONDecoder().raw_decode  # json.loads looks for other encodings first


@lru_cache(maxsize=64)  # a message is written before its link and after it
def properties_to_json(properties: Properties) -> bytes:
    """An object; a list of pairs if a name is there twice. Raises `UnicodeEncodeError`.

    By hand it takes two thirds of the time.
    """
    if len(dict(properties)) == len(properties):
        pairs = [f"{quoted(name)}:{quoted(value)}" for name, value in properties]
        return f"{{{','.join(pairs)}}}".encode()
    return json.dumps(properties, ensure_ascii=False, separators=(",", ":")).encode()


def properties_of_json(data: bytes) -> Properties:
    """User properties of their JSON; raises `DecodeError`."""
    try:
        text = data.decode()
        found, end = _decode(text)
    except (ValueError, RecursionError):
        raise DecodeError("user properties: expected JSON") from None
    if end != len(text):
        raise DecodeError("user properties: expected JSON and nothing behind it")
    if isinstance(found, dict):
        pairs = tuple(found.items())
    elif isinstance(found, list) and all(isinstance(p, list) and len(p) == 2 for p in found):
        pairs = tuple((name, value) for name, value in found)
    else:
        raise DecodeError("user properties: expected an object or a list of pairs")
    for name, value in pairs:
        if type(name) is not str or type(value) is not str:
            raise DecodeError("user properties: expected texts")
    return pairs


# Of packages: what brings their messages along, if it is installed.
MODULES = {
    "plotfeed.v1.": "plotfeed.proto.plotfeed_pb2",
    "sapient_msg.bsi_flex_335_v2_0.": "sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2",
}


def schema_of(message_type: str) -> bytes | None:
    """A FileDescriptorSet with that message and all it needs; None if it is not known here."""
    for package, module in MODULES.items():
        if message_type.startswith(package):
            with contextlib.suppress(ImportError):
                import_module(module)
    try:
        message = Default().FindMessageTypeByName(message_type)
    except KeyError:
        return None
    files: dict[str, FileDescriptor] = {}
    _collect(message.file, files)
    found = FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(found.file.add())
    return found.SerializeToString(deterministic=True)


def _collect(file: FileDescriptor, files: dict[str, FileDescriptor]) -> None:
    """Dependencies come before what needs them."""
    if file.name not in files:
        for needed in file.dependencies:
            _collect(needed, files)
        files[file.name] = file


# Our protobuf messages that are published as JSON, by the last level of their topics.
JSON_BY_TOPIC: Mapping[str, str] = {
    "status": "SensorStatus",
    "description": "SensorDescription",
    "errors": "Refusal",
}


def json_schema_of(series: ChannelKey) -> tuple[str, bytes] | None:
    """Name and JSON schema of what messages in JSON are; None of others.

    By their content type, or else by their topic; of what is neither, that it is an object.
    """
    if encoding_of(series.content_type) != "json":
        return None
    name = schema_name(series.content_type)
    schema = JSON_SCHEMAS.get(name)
    if schema is None:
        kind = JSON_BY_TOPIC.get(series.topic.rpartition("/")[2], "")
        kind = "Telemetry" if series.stage is Stage.TELEMETRY else kind
        found = pb.DESCRIPTOR.message_types_by_name.get(kind)
        name = "" if found is None else found.full_name
        schema = ANY_OBJECT if found is None else json_schema(found, ())
    return name or "plotfeed.Object", json.dumps(schema).encode()


ANY_OBJECT: Mapping[str, object] = {"type": "object"}
OURS = "plotfeed."  # Before our names in a channel's metadata
BEFORE, PROPERTIES = "before/", "properties/"  # Before topics, where one topic has several channels


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelKey:
    """What messages of a channel have in common."""

    topic: str
    content_type: str = ""
    stage: Stage = Stage.RECEIVED
    retain: bool = False
    qos: int = 0

    @classmethod
    def of(cls, recorded: Recorded) -> ChannelKey:
        """The key of a message."""
        return cls(
            topic=recorded.topic,
            content_type=recorded.content_type,
            stage=recorded.stage,
            retain=recorded.retain,
            qos=recorded.qos,
        )

    def metadata(self, *, of_properties: bool) -> dict[str, str]:
        """Everything, for a channel of the messages, or of their user properties."""
        return {
            f"{OURS}topic": self.topic,
            f"{OURS}stage": str(self.stage),
            f"{OURS}content_type": self.content_type,
            f"{OURS}retain": "true" if self.retain else "false",
            f"{OURS}qos": str(self.qos),
            f"{OURS}holds": "properties" if of_properties else "messages",
        }


@dataclass(frozen=True, slots=True)
class Channel:
    """A channel of a file that is read."""

    series: ChannelKey
    # Whether its messages are the user properties of the series' messages.
    holds_properties: bool = False


def channel_of(topic: str, encoding: str, schema: str, metadata: Mapping[str, str]) -> Channel:
    """The channel of a record with these fields; one that is not ours has been received."""
    given = {name.removeprefix(OURS): v for name, v in metadata.items() if name.startswith(OURS)}
    try:
        series = ChannelKey(
            topic=given["topic"],
            content_type=given["content_type"],
            stage=Stage(given["stage"]),
            retain=given["retain"] == "true",
            qos=int(given["qos"]),
        )
    except (KeyError, ValueError):
        return Channel(ChannelKey(topic=topic, content_type=_content_type(encoding, schema)))
    return Channel(series, given.get("holds") == "properties")


def encoding_of(content_type: str) -> str:
    """MCAP's name for how messages of a content type are written."""
    kind = content_type.partition(";")[0].strip()
    return {PROTOBUF: "protobuf", JSON: "json", GEOJSON: "json", ASTERIX: "asterix"}.get(kind, kind)


def message_type_of(series: ChannelKey) -> str:
    """Full name of the protobuf message that the messages are; empty if it is not known."""
    if series.content_type.partition(";")[0].strip() != PROTOBUF:
        return ""
    unnamed = TELEMETRY if series.stage is Stage.TELEMETRY else ""
    return message_type(series.content_type) or unnamed


def _content_type(encoding: str, schema: str) -> str:
    """What others wrote, in our words."""
    if encoding == "protobuf":
        return protobuf_content_type(schema) if schema else PROTOBUF
    return {"json": JSON, "asterix": ASTERIX}.get(encoding, f"application/x-{encoding or 'octets'}")

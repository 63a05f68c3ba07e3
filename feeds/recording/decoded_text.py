"""A message's content as text: one line for each record, plot or look in it, or JSON objects."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from google.protobuf import json_format
from google.protobuf.message import DecodeError as ProtobufDecodeError
from google.protobuf.message import Message as ProtobufMessage

from plotfeed.feeds.recording.record_text import Categories, Style, problem, record_told, short
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import decode_lenient
from plotfeed.proto.content_types import ASTERIX, COT, LEDGER, LEDGER_BATCH, SAPIENT_MESSAGE
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.proto.ledger import entries_in
from plotfeed.proto.message_kinds import OUR_MESSAGES, kind_of
from plotfeed.proto.utc import iso_utc

ENVELOPE = frozenset({"timestamp", "node_id", "destination_id", "additional_information"})
MAX_TEXT = 2000
# What a message may be.
UNREADABLE = (ValueError, RecursionError, json_format.Error, ProtobufDecodeError, DecodeError)


def sapient_line(message: Mapping[str, Any]) -> str:
    """When, who in short, what kind of message, and what is in it."""
    (kind,) = message.keys() - ENVELOPE
    content: Mapping[str, Any] = message[kind]
    parts = {
        "detection_report": _detection,
        "registration": _registration,
        "status_report": _status,
    }
    words = parts[kind](content) if kind in parts else iter([json.dumps(content)[:MAX_TEXT]])
    node = str(message.get("node_id", "?"))[:8]
    return "  ".join([str(message.get("timestamp", "?")), node, kind, *words])


def _detection(report: Mapping[str, Any]) -> Iterator[str]:
    for place in ("range_bearing", "location"):
        yield from _numbers(report.get(place, {}))
    for found in report.get("classification", ()):
        below = "".join(f"/{sub.get('type')}" for sub in found.get("sub_class", ()))
        yield f"class {found.get('type')}{below} {found.get('confidence', '')}".rstrip()
    for info in report.get("object_info", ()):
        yield f"{info.get('type')} {info.get('value')}"
    for signal in report.get("signal", ()):
        yield from _numbers(signal)
    if "id" in report:
        yield f"id {report['id']}"


def _registration(registration: Mapping[str, Any]) -> Iterator[str]:
    yield str(registration.get("name"))
    for node in registration.get("node_definition", ()):
        yield " ".join([str(node.get("node_type")), *node.get("node_sub_type", ())])
    yield str(registration.get("icd_version"))


def _status(report: Mapping[str, Any]) -> Iterator[str]:
    yield from (str(report.get(name)) for name in ("system", "info", "mode"))
    yield from _numbers(report.get("node_location", {}))


def _numbers(fields: Mapping[str, Any]) -> Iterator[str]:
    """Numbers of a part; its enumerations say the same in every message."""
    for name, value in fields.items():
        if isinstance(value, int | float):
            yield f"{name} {short(value)}"


def message_lines(
    topic: str,
    payload: bytes,
    content_type: str | None,
    style: Style = Style.LINE,
    categories: Categories = CATEGORIES,
) -> Iterator[str]:
    """The lines of one message; a tree has many. What cannot be decoded says so."""

    def line(told: Any) -> str:
        is_json = style is Style.JSON
        return json.dumps({"topic": topic, "message": told}) if is_json else f"{topic}  {told}"

    kind = kind_of(topic, content_type or "", payload)
    try:
        yield from map(line, _told(kind, payload, categories, style))
    except UNREADABLE as error:
        text = f"{len(payload)} octets that are not what the topic says: {error}"
        yield line(problem(text, style))


def _told(kind: str, payload: bytes, categories: Categories, style: Style) -> Iterator[Any]:
    """What is in a payload: values for JSON, or else texts."""
    if kind == ASTERIX:
        records, errors = decode_lenient(payload, categories)
        yield from (record_told(record, categories, style) for record in records)
        yield from (problem(error, style) for error in errors)
    elif kind == SAPIENT_MESSAGE:
        yield _sapient(payload, style)
    elif kind == COT:
        yield payload.decode()[: None if style is Style.TREE else MAX_TEXT]
    elif kind in OUR_MESSAGES:
        is_ledger = kind in (LEDGER, LEDGER_BATCH)  # of which each sector is a message
        read = entries_in if is_ledger else lambda octets: [OUR_MESSAGES[kind].FromString(octets)]
        for message in read(payload):
            yield from _protobuf(message, style)
    else:  # JSON, or nothing tells what
        value = json.loads(payload)
        if style is Style.JSON:
            yield value
        else:
            is_tree = style is Style.TREE
            yield json.dumps(value, indent=2) if is_tree else json.dumps(value)[:MAX_TEXT]


def _sapient(payload: bytes, style: Style) -> Any:
    try:
        from plotfeed.feeds.formats.sapient import need_sapient  # and with it all sensors

        need_sapient()
    except PlotfeedError as error:
        return problem(error, style)
    from plotfeed.proto.sapient.decode_sapient import decode

    message = decode(payload)
    return {"SapientMessage": message} if style is Style.JSON else sapient_line(message)


def _protobuf(message: ProtobufMessage, style: Style) -> Iterator[Any]:
    name = message.DESCRIPTOR.name
    if style is Style.LINE:
        yield from _lines_of(message)
    elif style is Style.TREE:
        yield f"{name} {json_format.MessageToJson(message, preserving_proto_field_name=True)}"
    else:
        yield {name: json_format.MessageToDict(message, preserving_proto_field_name=True)}


def _lines_of(message: ProtobufMessage) -> Iterator[str]:
    if isinstance(message, pb.PlotBatch | pb.TrackBatch):
        place = f"scan {message.scan} sector {message.sector}"
        for each in message.plots if isinstance(message, pb.PlotBatch) else message.tracks:
            yield f"{place}  {iso_utc(each.time_utc_ns)}  {_fields(each)}"
    elif isinstance(message, pb.Ledger):
        place = f"{message.sensor} scan {message.scan} sector {message.sector}"
        for look in message.looks:
            yield f"{place}  look {iso_utc(look.time_utc_ns)}  {_fields(look)}"
        for truth in message.plots:
            whose = truth.drone or truth.other or "false alarm"
            yield f"{place}  plot {iso_utc(truth.time_utc_ns)}  of {whose}"
    else:
        yield json_format.MessageToJson(message, indent=None, preserving_proto_field_name=True)


def _fields(message: ProtobufMessage) -> str:
    """The fields of a message but for its time."""
    return "  ".join(
        f"{field.name} {short(value)}"
        for field, value in message.ListFields()
        if field.name != "time_utc_ns"
    )

"""A message's content as text: one line for each record, plot or look in it, or JSON objects."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from typing import Any

from google.protobuf import json_format
from google.protobuf.message import DecodeError as ProtobufDecodeError
from google.protobuf.message import Message as ProtobufMessage

from plotfeed.feeds.recording.record_text import (
    Categories,
    record_json,
    record_line,
    record_tree,
    short,
)
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
    *,
    as_json: bool,
    categories: Categories = CATEGORIES,
    verbose: bool = False,
) -> Iterator[str]:
    """The lines of one message; `verbose` trees have many each. What cannot be decoded says so."""

    def line(told: Any) -> str:
        return json.dumps({"topic": topic, "message": told}) if as_json else f"{topic}  {told}"

    kind = kind_of(topic, content_type or "", payload)
    try:
        if verbose and kind == ASTERIX:
            records, errors = decode_lenient(payload, categories)
            trees = (record_tree(record, categories) for record in records)
            told: Iterator[Any] = chain(trees, map(str, errors))
        elif verbose and kind != SAPIENT_MESSAGE:
            told = _indented(kind, payload)
        else:
            told = _told(kind, payload, categories, as_json=as_json)
        yield from map(line, told)
    except UNREADABLE as error:
        text = f"{len(payload)} octets that are not what the topic says: {error}"
        yield line({"error": text} if as_json else text)


def _told(kind: str, payload: bytes, categories: Categories, *, as_json: bool) -> Iterator[Any]:
    """What is in a payload: values for JSON, or else texts."""
    if kind == ASTERIX:
        return _asterix(payload, categories, as_json=as_json)
    if kind == SAPIENT_MESSAGE:
        return _sapient(payload, as_json=as_json)
    if kind == COT:
        return iter([payload.decode()[:MAX_TEXT]])
    if kind not in OUR_MESSAGES:  # JSON, or nothing tells what
        value = json.loads(payload)
        return iter([value if as_json else json.dumps(value)[:MAX_TEXT]])
    return _protobuf(_ours(kind, payload), as_json=as_json)


def _ours(kind: str, payload: bytes) -> list[Any]:
    """The message of ours in a payload; of the ledger one for each sector."""
    if kind in (LEDGER, LEDGER_BATCH):
        return entries_in(payload)
    return [OUR_MESSAGES[kind].FromString(payload)]


def _asterix(payload: bytes, categories: Categories, *, as_json: bool) -> Iterator[Any]:
    records, errors = decode_lenient(payload, categories)
    for record in records:
        if as_json:
            yield record_json(record)
        else:
            yield record_line(record, categories)
    for error in errors:
        yield {"error": str(error)} if as_json else error


def _indented(kind: str, payload: bytes) -> Iterator[str]:
    """A message of JSON or protobuf with all its fields, each on a line."""
    if kind == COT:
        yield payload.decode()
        return
    if kind not in OUR_MESSAGES:
        yield json.dumps(json.loads(payload), indent=2)
        return
    for message in _ours(kind, payload):
        fields = json_format.MessageToJson(message, preserving_proto_field_name=True)
        yield f"{message.DESCRIPTOR.name} {fields}"


def _sapient(payload: bytes, *, as_json: bool) -> Iterator[Any]:
    try:
        from plotfeed.feeds.formats.sapient import need_sapient  # and with it all sensors

        need_sapient()
    except PlotfeedError as error:
        yield {"error": str(error)} if as_json else error
        return
    from plotfeed.proto.sapient.decode_sapient import decode

    message = decode(payload)
    yield {"SapientMessage": message} if as_json else sapient_line(message)


def _protobuf(messages: Iterable[ProtobufMessage], *, as_json: bool) -> Iterator[Any]:
    for message in messages:
        if as_json:
            fields = json_format.MessageToDict(message, preserving_proto_field_name=True)
            yield {type(message).__name__: fields}
        else:
            yield from _lines_of(message)


def _lines_of(message: ProtobufMessage) -> Iterator[str]:
    if isinstance(message, pb.PlotBatch):
        place = f"scan {message.scan} sector {message.sector}"
        for plot in message.plots:
            yield f"{place}  {iso_utc(plot.time_utc_ns)}  {_fields(plot, 'time_utc_ns')}"
    elif isinstance(message, pb.TrackBatch):
        place = f"scan {message.scan} sector {message.sector}"
        for track in message.tracks:
            yield f"{place}  {iso_utc(track.time_utc_ns)}  {_fields(track, 'time_utc_ns')}"
    elif isinstance(message, pb.Ledger):
        place = f"{message.sensor} scan {message.scan} sector {message.sector}"
        for look in message.looks:
            yield f"{place}  look {iso_utc(look.time_utc_ns)}  {_fields(look, 'time_utc_ns')}"
        for truth in message.plots:
            whose = truth.drone or truth.other or "false alarm"
            yield f"{place}  plot {iso_utc(truth.time_utc_ns)}  of {whose}"
    else:
        yield json_format.MessageToJson(message, indent=None, preserving_proto_field_name=True)


def _fields(message: ProtobufMessage, *left_out: str) -> str:
    return "  ".join(
        f"{field.name} {short(value)}"
        for field, value in message.ListFields()
        if field.name not in left_out
    )

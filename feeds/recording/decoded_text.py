"""A message's content as text: one line for each record, plot or look in it, or JSON objects."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from typing import Any

from google.protobuf import json_format
from google.protobuf.message import DecodeError as ProtobufDecodeError
from google.protobuf.message import Message as ProtobufMessage

from plotfeed.feeds.console.printed import printable
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.cat025 import CAT025_HALF_TURN
from plotfeed.proto.asterix.cat062 import CAT062_1_18
from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import Record, decode_lenient
from plotfeed.proto.asterix.codec.layout import Category, is_time_of_day
from plotfeed.proto.content_types import ASTERIX, JSON, message_type
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.proto.utc import iso_utc

ENVELOPE = frozenset({"timestamp", "node_id", "destination_id", "additional_information"})
MAX_TEXT = 2000
SAPIENT = REPORT_FORMATS["sapient"].message
OURS: Mapping[str, type[ProtobufMessage]] = {
    kind.DESCRIPTOR.full_name: kind
    for kind in (
        pb.Telemetry,
        pb.PlotBatch,
        pb.Ledger,
        pb.Refusal,
        pb.SensorStatus,
        pb.SensorDescription,
    )
}
HEXADECIMAL = {"I048/220": 6, "ADR": 6, "I048/260": 14, "MBDATA": 14, "ACS": 14}
"""Digits of items, and parts of items, that everybody writes so: addresses, Mode S registers."""
UNREADABLE = (ValueError, RecursionError, json_format.Error, ProtobufDecodeError, DecodeError)
"""What a message may be."""
Categories = Mapping[int, Category]
EDITIONS: Mapping[str, Category] = {"025-half-turn": CAT025_HALF_TURN, "062-1.18": CAT062_1_18}
"""Of categories that not all senders write alike."""


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
            yield f"{name} {_short(value)}"


def categories_of(editions: Iterable[str]) -> Categories:
    """The layouts to read ASTERIX by, with those editions in place of the usual ones."""
    return {**CATEGORIES, **{EDITIONS[name].number: EDITIONS[name] for name in editions}}


def record_line(record: Record, *, as_json: bool) -> str:
    """The line of one record of ASTERIX."""
    return _record_json(record) if as_json else _record_line(record)


def message_lines(
    topic: str,
    payload: bytes,
    content_type: str | None,
    *,
    as_json: bool,
    categories: Categories = CATEGORIES,
) -> Iterator[str]:
    """The lines of one MQTT message. What cannot be decoded says so in its line."""

    def line(told: Any) -> str:
        return json.dumps({"topic": topic, "message": told}) if as_json else f"{topic}  {told}"

    try:
        for told in _told(_kind(topic, content_type), payload, categories, as_json=as_json):
            yield line(told)
    except UNREADABLE as error:
        text = f"{len(payload)} octets that are not what the topic says: {error}"
        yield line({"error": text} if as_json else text)


def _told(
    kind: str | type[ProtobufMessage], payload: bytes, categories: Categories, *, as_json: bool
) -> Iterator[Any]:
    """What is in a payload: values for JSON, or else texts."""
    if kind == "asterix":
        return _asterix(payload, categories, as_json=as_json)
    if kind == "sapient":
        return _sapient(payload, as_json=as_json)
    if isinstance(kind, str):
        value = json.loads(payload)
        return iter([value if as_json else json.dumps(value)[:MAX_TEXT]])
    message = kind.FromString(payload)
    if as_json:
        fields = json_format.MessageToDict(message, preserving_proto_field_name=True)
        return iter([{type(message).__name__: fields}])
    return _protobuf(message)


def _kind(topic: str, content_type: str | None) -> str | type[ProtobufMessage]:
    """What a message is: by content type, or by topic, as MQTT 3.1.1 has no content types."""
    said = message_type(content_type or "")
    if said == SAPIENT or said in OURS:
        return OURS.get(said, "sapient")
    levels = topic.split("/")
    if (content_type or "").startswith(ASTERIX) or "asterix" in levels[-2:]:
        return "asterix"
    if (content_type or "").startswith(JSON) or levels[-1] in ("errors", "status"):
        return "json"
    if levels[-1] == "sapient" or levels[-2:] == ["sapient", "task"]:
        return "sapient"
    if levels[-2:-1] == ["telemetry"]:
        return pb.Telemetry
    kinds: dict[str, type[ProtobufMessage]] = {"plots": pb.PlotBatch, "truth": pb.Ledger}
    return kinds.get(levels[-1], "json")


def _asterix(payload: bytes, categories: Categories, *, as_json: bool) -> Iterator[Any]:
    records, errors = decode_lenient(payload, categories)
    for record in records:
        if as_json:
            yield {"category": record.category, "items": _plain(record.items)}
        else:
            yield _record_line(record)
    for error in errors:
        yield {"error": str(error)} if as_json else error


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


def _record_line(record: Record) -> str:
    """Time of day, then every item but the source's own name for the category."""
    items = dict(record.items)
    if not items:
        return f"CAT{record.category:03d}  {record.octets.hex()}"
    time_of_day = items.pop(_time_item(record.category), None)
    when = _clock(time_of_day) if isinstance(time_of_day, float) else "            "
    parts = "  ".join(
        f"{name.partition('/')[2]} {_part(name, value)}" for name, value in items.items()
    )
    return f"CAT{record.category:03d}  {when}  {parts}"


@cache
def _time_item(category: int) -> str:
    """The name of a category's time of day; empty if it has none."""
    items = CATEGORIES[category].uap if category in CATEGORIES else ()
    return next((item.name for item in items if item is not None and is_time_of_day(item)), "")


def _clock(time_of_day_s: float) -> str:
    minutes, seconds = divmod(time_of_day_s, 60)
    hours, minutes = divmod(int(minutes), 60)
    return f"{hours:02d}:{minutes:02d}:{seconds:06.3f}"


def _short(value: Any) -> str:
    """A value without a digit lost; parts of a part in brackets."""
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, Mapping):
        return " ".join(
            f"{name}=({_short(part)})" if isinstance(part, dict) else f"{name}={_part(name, part)}"
            for name, part in value.items()
        )
    if isinstance(value, list):
        return "[" + ", ".join(_short(part) for part in value) + "]"
    if isinstance(value, bytes):
        return value.hex()
    return printable(str(value))


def _part(name: str, value: Any) -> str:
    if isinstance(value, int) and name in HEXADECIMAL:
        return f"{value:0{HEXADECIMAL[name]}X}"
    return _short(value)


def _number(value: float) -> str:
    """The shortest text that reads as the same number."""
    return repr(value).removesuffix(".0")


def _record_json(record: Record) -> str:
    found: dict[str, Any] = {"category": record.category, "items": _plain(record.items)}
    if not record.items:
        found["octets"] = record.octets.hex()
    return json.dumps(found)


def _plain(value: Any) -> Any:
    """A value with octets as hexadecimal text, as JSON needs them."""
    if isinstance(value, Mapping):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, list):
        return [_plain(part) for part in value]
    return value.hex() if isinstance(value, bytes) else value


def _protobuf(message: ProtobufMessage) -> Iterator[str]:
    if isinstance(message, pb.PlotBatch):
        place = f"scan {message.scan} sector {message.sector}"
        for plot in message.plots:
            yield f"{place}  {iso_utc(plot.time_utc_ns)}  {_fields(plot, 'time_utc_ns')}"
    elif isinstance(message, pb.Ledger):
        place = f"{message.sensor} scan {message.scan} sector {message.sector}"
        for look in message.looks:
            yield f"{place}  look {iso_utc(look.time_utc_ns)}  {_fields(look, 'time_utc_ns')}"
        for truth in message.plots:
            whose = truth.drone or "false alarm"
            yield f"{place}  plot {iso_utc(truth.time_utc_ns)}  of {whose}"
    else:
        yield json_format.MessageToJson(message, indent=None, preserving_proto_field_name=True)


def _fields(message: ProtobufMessage, *left_out: str) -> str:
    return "  ".join(
        f"{field.name} {_short(value)}"
        for field, value in message.ListFields()
        if field.name not in left_out
    )

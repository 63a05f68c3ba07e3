"""Digests of what commands write: text, files, series of messages; and where two of them part.

Of each line, block or message four hexadecimal digits are kept beside the digest of the whole, so
that a difference can be placed. The whole decides whether there is one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

Item = dict[str, Any]

BLOCK = 1024
"""Octets of a file that have a mark together."""
MARK = 4
KEPT_CHARACTERS = 6000
"""A text that is no longer is kept as it is."""
PROPERTIES = "properties/"
"""Before the topic of a channel that holds the user properties of another's messages."""


def of_text(text: str) -> Item:
    lines = text.split("\n")
    item: Item = {"kind": "text", "sha256": _sha(text.encode())}
    if len(text) <= KEPT_CHARACTERS:
        return item | {"lines": lines}
    return item | {"marks": "".join(_mark(line.encode()) for line in lines)}


def of_octets(data: bytes) -> Item:
    blocks = (data[at : at + BLOCK] for at in range(0, len(data), BLOCK))
    marks = "".join(_mark(block) for block in blocks)
    return {"kind": "octets", "count": len(data), "sha256": _sha(data), "marks": marks}


class Series:
    """Messages, each some named fields."""

    def __init__(self) -> None:
        self._count = 0
        self._wholes: dict[str, Any] = {}
        self._marks: dict[str, list[str]] = {}

    def add(self, **fields: object) -> None:
        self._count += 1
        for name, value in fields.items():
            data = value if isinstance(value, bytes) else json.dumps(value).encode()
            whole = self._wholes.setdefault(name, hashlib.sha256())
            whole.update(len(data).to_bytes(8, "big") + data)
            self._marks.setdefault(name, []).append(_mark(data))

    def item(self, *, marked: bool = True) -> Item:
        """`marked` says to keep where a difference is."""
        item: Item = {"kind": "series", "count": self._count}
        item["sha256"] = {name: whole.hexdigest() for name, whole in self._wholes.items()}
        if marked:
            item["marks"] = {name: "".join(marks) for name, marks in self._marks.items()}
        return item


def of_recording(path: Path, *, marked: bool = True) -> dict[str, Item]:
    """What an MCAP file holds, by topic and stage, in the order of the file; and that order.

    How messages are cut into chunks is left out: a session writes one every 0.25 s of real time.
    """
    series: dict[str, Series] = {}
    order = Series()
    others = []
    waiting: dict[str, Any] | None = None
    for record, channel, schema in _records(path):
        if isinstance(record, Attachment):
            others.append([record.name, record.media_type, record.log_time, _sha(record.data)])
        elif isinstance(record, Metadata):
            others.append([record.name, sorted(record.metadata.items())])
        elif isinstance(record, Message) and channel is not None:
            of = channel.metadata.get("plotfeed.topic", channel.topic)
            if channel.topic.startswith(PROPERTIES) and waiting is not None:
                waiting["fields"]["properties"] = record.data
                continue
            _add(series, waiting)
            name = f"{of} {channel.metadata.get('plotfeed.stage', '')}"
            order.add(topic=name)
            fields = {
                "payload": record.data,
                "properties": b"",
                "due": record.publish_time,
                "sent": record.log_time,
                "channel": _told(channel, schema),
            }
            waiting = {"name": name, "fields": fields}
    _add(series, waiting)
    items = {f"message {name}": each.item(marked=marked) for name, each in sorted(series.items())}
    others_text = "\n".join(json.dumps(other) for other in others)
    return items | {"order": order.item(marked=marked), "attachments": of_text(others_text)}


def _records(path: Path) -> Iterator[tuple[object, Channel | None, Schema | None]]:
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    with path.open("rb") as file:
        for record in StreamReader(file).records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                yield record, channel, schemas.get(channel.schema_id)
            else:
                yield record, None, None


def _told(channel: Channel, schema: Schema | None) -> list[object]:
    of_schema = [schema.name, schema.encoding, _sha(schema.data)] if schema else []
    about = sorted(channel.metadata.items())
    return [channel.topic, channel.message_encoding, about, of_schema]


def _add(series: dict[str, Series], waiting: dict[str, Any] | None) -> None:
    if waiting is not None:
        series.setdefault(waiting["name"], Series()).add(**waiting["fields"])


def difference(one: Item, other: Item) -> str | None:
    """What differs first, in words; None if nothing does."""
    if one == other:
        return None
    if one["kind"] != other["kind"]:
        return f"{one['kind']} against {other['kind']}"
    counts = f"{one['count']} against {other['count']}" if "count" in one else ""
    if one["kind"] == "series":
        return _of_series(one, other, counts)
    if one["kind"] == "octets":
        at = _first(one["marks"], other["marks"])
        return f"{counts} octets; first difference from octet {at * BLOCK} on"
    at = _first(_marks_of_text(one), _marks_of_text(other))
    lines = [item["lines"][at : at + 1] for item in (one, other) if "lines" in item]
    return "\n    ".join([f"line {at + 1}", *(line for found in lines for line in found)])


def _of_series(one: Item, other: Item, counts: str) -> str:
    names = sorted({*one["sha256"], *other["sha256"]})
    changed = [n for n in names if one["sha256"].get(n) != other["sha256"].get(n)]
    text = f"{counts} messages, in {', '.join(changed)}"
    if "marks" not in one or "marks" not in other:
        return text
    places = {n: _first(one["marks"].get(n, ""), other["marks"].get(n, "")) for n in changed}
    first = min(places.values(), default=0)
    of = ", ".join(name for name, at in places.items() if at == first)
    return f"{text}; first the message with index {first}, in {of}"


def _marks_of_text(item: Item) -> str:
    if "marks" in item:
        return str(item["marks"])
    return "".join(_mark(line.encode()) for line in item["lines"])


def _first(one: str, other: str) -> int:
    """The index of the first marks that differ."""
    pairs: Iterable[int] = range(0, min(len(one), len(other)), MARK)
    for at in pairs:
        if one[at : at + MARK] != other[at : at + MARK]:
            return at // MARK
    return min(len(one), len(other)) // MARK


def _sha(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _mark(data: bytes) -> str:
    return _sha(data)[:MARK]

"""Tracks from files: recordings of any format, tables, and GeoJSON."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from plotfeed.feeds.messages.message import checked_topic_filter, is_chosen
from plotfeed.feeds.scene.fields import site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.score.track_decoding import entries_in, track_of_mapping, tracks_in
from plotfeed.feeds.score.track_table import TracksRead, TrackTable
from plotfeed.models.frames import LocalFrame
from plotfeed.proto.content_types import TRACK_BATCH, asterix_content_type, message_type
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.replay.files import open_recording
from plotfeed.replay.recorded import WHAT_LEFT, Recorded, Stage

TABLES, FEATURES = (".csv", ".tsv"), (".geojson", ".json")
MAX_FILE_OCTETS = 1 << 30
MOST_TOPICS = 1000
OF_ASTERIX = asterix_content_type(62)
"""Messages of tracks, whoever sends them."""


def read_tracks(
    path: Path, scene: Scene | None = None, topics: Sequence[str] = (), *, date_utc_ns: int = 0
) -> TracksRead:
    """Read what a tracker published, from a file that its content and suffix say how to read.

    `topics` are filters that choose messages of a recording; without any those of the scene's
    `page.tracks_topic` are taken where there are such, and else what holds tracks, if that is on
    one topic. The scene's site is what X and Y of ASTERIX 062 count from, and `date_utc_ns` the
    midnight with which a file without dates begins. What cannot be read is counted by its reason.
    Raises `PlotfeedError` for a file that is none of these, and `OSError`.
    """
    table = TrackTable()
    suffix = path.suffix.lower()
    if suffix in TABLES:
        _take(table, _lines(path, suffix), path)
        return table.read(path.name)
    if suffix in FEATURES:
        _take(table, _features(path), path)
        return table.read(path.name)
    site = None if scene is None else site_frame(scene.scene.site)
    for each in topics:
        checked_topic_filter(each)
    chosen = topics or _topic_in(path, scene)
    with open_recording(path, date_utc_ns=date_utc_ns) as recording:
        for message in recording.reader.messages():
            if is_chosen(message.topic, chosen) and _is_heard(message):
                take_message(table, message, site)
    where = ", ".join(chosen)
    return table.read(f"{path.name}: {where}" if where else path.name)


def take_message(table: TrackTable, message: Recorded, site: LocalFrame | None) -> None:
    """Take the tracks in a message; what cannot be read is counted."""
    try:
        received_ns = message.log_time_ns
        for told in tracks_in(message.payload, message.content_type, received_ns, site):
            table.add(told, received_ns)
    except DecodeError as error:
        table.refuse(_reason(error))


def _reason(error: DecodeError) -> str:
    """An error without what differs from message to message."""
    text = str(error)
    return text.partition(": ")[2] if text.startswith("octet ") else text


def _topic_in(path: Path, scene: Scene | None) -> Sequence[str]:
    """The topic on which a recording has tracks; none if it has no topics to choose from."""
    found: Counter[str] = Counter()
    with open_recording(path) as recording:
        if not recording.has_stages:
            return ()
        for message in recording.reader.messages():
            if _is_heard(message) and _holds_tracks(message):
                found[message.topic] += 1
                if len(found) > MOST_TOPICS:
                    break
    told = scene.page.tracks_topic if scene is not None else None
    if told is not None and (told in found or not found):
        return (told,)
    if len(found) > 1:
        some = ", ".join(sorted(found)[:5])
        raise PlotfeedError(
            f"{path}: tracks are on {len(found)} topics ({some}{', ...' * (len(found) > 5)}): "
            "--topic says which are to be scored"
        )
    if not found:
        raise PlotfeedError(
            f"{path}: no tracks: expected ASTERIX 062, a TrackBatch, or JSON with track, "
            "latitude_deg and longitude_deg on a topic of the tracker's; --topic names it, "
            "--tracks another file"
        )
    return tuple(found)


def _is_heard(message: Recorded) -> bool:
    """Whether others had a message, or a session did, and it is no telemetry."""
    if message.stage is Stage.TELEMETRY:
        return message.topic.split("/")[-2:-1] != ["telemetry"]
    return message.stage in WHAT_LEFT


def _holds_tracks(message: Recorded) -> bool:
    """Whether messages of a topic are of tracks, as its content type or its first octets say."""
    kind = message.content_type
    if kind.startswith(OF_ASTERIX) or message_type(kind) == TRACK_BATCH:
        return True
    payload = message.payload
    is_block = payload[:1] == b"\x3e" and int.from_bytes(payload[1:3], "big") <= len(payload)
    if is_block and len(payload) > 3 and (not kind or "asterix" in kind):
        return True
    head = payload[:400]
    return b'"latitude_deg"' in head and b'"track"' in head


def _lines(path: Path, suffix: str) -> Iterator[Mapping[str, Any]]:
    """Lines of a table, by the names in its first."""
    delimiter = "\t" if suffix == ".tsv" else ","
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
        rows = csv.DictReader(file, delimiter=delimiter)
        names = {name.strip() for name in rows.fieldnames or () if name}
        lacking = {"track", "latitude_deg", "longitude_deg"} - names
        if lacking or not names & {"time_utc", "time_utc_ns"}:
            raise PlotfeedError(
                f"{path}: expected columns track, time_utc, latitude_deg and longitude_deg in its "
                f"first line, not {', '.join(sorted(names))[:200] or 'an empty file'}"
            )
        try:
            for row in rows:
                yield {(name or "").strip(): value for name, value in row.items()}
        except csv.Error as error:
            raise PlotfeedError(f"{path}: line {rows.line_num}: {error}") from None


def _features(path: Path) -> Iterator[Mapping[str, Any]]:
    """Features of GeoJSON, or entries of JSON."""
    if path.stat().st_size > MAX_FILE_OCTETS:
        raise PlotfeedError(f"{path}: expected at most {MAX_FILE_OCTETS >> 20} MB of JSON")
    try:
        yield from entries_in(path.read_bytes())
    except DecodeError as error:
        raise PlotfeedError(f"{path}: {error}") from None


def _take(table: TrackTable, entries: Iterator[Mapping[str, Any]], path: Path) -> None:
    for entry in entries:
        try:
            told = track_of_mapping(entry)
        except DecodeError as error:
            table.refuse(str(error).partition(", not ")[0])
            continue
        table.add(told)
    if not len(table) and not table.unreadable:
        table.refuse(f"{path.name} holds no tracks")

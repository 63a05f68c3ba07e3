"""Tracks of recordings, tables and texts, as a tracker published them: columns of reports."""

from __future__ import annotations

import contextlib
import csv
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.console.printed import printable
from plotfeed.feeds.formats.told_tracks import (
    MAX_OCTETS,
    ToldTrack,
    entries_in,
    events_in,
    tracks_in,
    tracks_of_entries,
)
from plotfeed.feeds.messages.message import checked_topic_filter, is_chosen
from plotfeed.feeds.recording.foreign_recordings import ForeignReader
from plotfeed.feeds.scene.fields import site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.frames import LocalFrame
from plotfeed.models.state import Bools, Columns, Floats, Ints
from plotfeed.proto.content_types import (
    COT,
    SAPIENT_MESSAGE,
    TRACK_BATCH,
    asterix_content_type,
    message_type,
)
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.replay.files import FORMATS, FileFormat
from plotfeed.replay.recorded import WHAT_LEFT, Recorded, Stage

# In place of a time that nobody told.
UNKNOWN_NS = -(2**63)
LATEST_NS = 2**63 - 1
SQUARE = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])  # Which of these stands where in a matrix


@dataclass(frozen=True, kw_only=True)
class ReportedTracks(Columns):
    """Reports of tracks as they were told, (n,), right or wrong.

    Places are WGS-84, heights above its ellipsoid; velocities are east, north, up, (n, 3), and
    covariances of the position (n, 3, 3), of the place. NaN stands for what is not told, and
    `UNKNOWN_NS` for such times.
    """

    t_utc_ns: Ints  # For which the report holds
    received_utc_ns: Ints
    track: Ints  # Index of the name
    latitude_deg: Floats
    longitude_deg: Floats
    height_m: Floats
    velocity_enu_m_s: Floats
    covariance_m2: Floats
    tentative: Bools
    ended: Bools


@dataclass(frozen=True, slots=True, kw_only=True)
class TracksRead:
    """All that was read of a tracker."""

    reports: ReportedTracks
    names: Sequence[str]  # Of tracks, by their numbers in `reports`
    # What could not be read, and how often; by the reason.
    unreadable: Mapping[str, int] = field(default_factory=dict)
    source: str = ""  # Where tracks were found, in a few words
    crashed: str = ""  # How the tracker ended, where it is known to have failed


class TrackTable:
    """Takes reports one by one, and makes columns of them."""

    def __init__(self) -> None:
        self.unreadable: Counter[str] = Counter()
        self._told: list[ToldTrack] = []

    def __len__(self) -> int:
        return len(self._told)

    def add(self, told: ToldTrack, received_utc_ns: int | None = None) -> None:
        """Take a report that came at a time, if that is known."""
        is_told = received_utc_ns is None
        self._told.append(told if is_told else replace(told, received_utc_ns=received_utc_ns))

    def refuse(self, reason: str) -> None:
        """Count what could not be read."""
        self.unreadable[reason] += 1

    def take(
        self,
        payload: bytes,
        content_type: str,
        came_ns: int,
        site: LocalFrame | None,
        *,
        has_received: bool = True,
    ) -> None:
        """Take the tracks in a message; what cannot be read is counted."""
        try:
            for told in tracks_in(payload, content_type, came_ns, site, self.refuse):
                self.add(told, came_ns if has_received else None)
        except DecodeError as error:
            text = str(error)  # less what differs from message to message
            self.refuse(text.partition(": ")[2] if text.startswith("octet ") else text)

    def read(self, source: str, crashed: str = "") -> TracksRead:
        """All reports so far."""
        told, names = self._told, list(dict.fromkeys(each.name for each in self._told))
        numbers = {name: number for number, name in enumerate(names)}

        def column(name: str, kind: type = float) -> Any:
            return np.array([getattr(each, name) for each in told], kind)

        def times(told_ns: Sequence[int | None]) -> Ints:
            """Times, as far as a column can hold them."""
            held = (
                t if t is not None and UNKNOWN_NS < t <= LATEST_NS else UNKNOWN_NS for t in told_ns
            )
            return np.fromiter(held, np.int64, len(told_ns))

        came_ns = [each.received_utc_ns for each in told]
        of_ns = [each.received_utc_ns if each.t_utc_ns is None else each.t_utc_ns for each in told]
        reports = ReportedTracks(
            t_utc_ns=times(of_ns),
            received_utc_ns=times(came_ns),
            track=np.array([numbers[each.name] for each in told], np.int64),
            **{n: column(n) for n in ("latitude_deg", "longitude_deg", "height_m")},
            velocity_enu_m_s=column("velocity_enu_m_s").reshape(-1, 3),
            covariance_m2=column("covariance_m2").reshape(-1, 6)[:, SQUARE],
            tentative=column("tentative", bool),
            ended=column("ended", bool),
        )
        return TracksRead(
            reports=reports,
            names=names,
            unreadable=dict(self.unreadable),
            source=source,
            crashed=crashed,
        )


TABLES = {".csv": ",", ".tsv": "\t"}  # Suffixes of tables, with what parts their columns
FEATURES = (".geojson", ".json", ".xml", ".cot")
LINES = (".jsonl", ".ndjson")
MAX_FILE_OCTETS = 1 << 30
MOST_TOPICS = 1000
OF_ASTERIX = asterix_content_type(62)  # Messages of tracks, whoever sends them


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
    if (entries := _entries_of(path)) is not None:
        for told in tracks_of_entries(entries, table.refuse):
            table.add(told)
        if not len(table) and not table.unreadable:
            table.refuse(f"{path.name} holds no tracks")
        return table.read(path.name)
    site = None if scene is None else site_frame(scene.scene.site)
    for each in topics:
        checked_topic_filter(each)
    chosen = topics or _topic_in(path, scene)
    with ForeignReader(path, date_utc_ns=date_utc_ns) as reader:
        # Messages of raw files are of the times that they tell: nobody knows when they came.
        has_received = reader.format is not FileFormat.RAW
        for m in reader.messages():
            if is_chosen(m.topic, chosen) and _is_heard(m):
                came_ns = m.log_time_ns
                table.take(m.payload, m.content_type, came_ns, site, has_received=has_received)
    where = ", ".join(chosen)
    return table.read(f"{path.name}: {where}" if where else path.name)


def _topic_in(path: Path, scene: Scene | None) -> Sequence[str]:
    """The topic on which a recording has tracks; none if it has no topics to choose from."""
    found: Counter[str] = Counter()
    own = f"{scene.mqtt.prefix}/" if scene is not None else ""
    with ForeignReader(path) as reader:
        if not FORMATS[reader.format].holds_stages:
            return ()
        for message in reader.messages():
            if _is_heard(message) and _holds_tracks(message, own):
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


def _holds_tracks(message: Recorded, own: str) -> bool:
    """Whether messages of a topic are of tracks, as its content type or its first octets say.

    Those of SAPIENT below the topics of the scene are of its sensors; elsewhere JSON need not name
    a `track` to be of tracks.
    """
    kind, payload = message.content_type, message.payload
    is_own = bool(own) and message.topic.startswith(own)
    is_json = bool(own) and payload[:1] in (b"{", b"[")
    if not is_own and (is_json or message_type(kind) == SAPIENT_MESSAGE):
        with contextlib.suppress(PlotfeedError):
            told = tracks_in(payload, kind, message.log_time_ns, None)
            return any(math.isfinite(each.latitude_deg) for each in told)
    is_told = kind.startswith((COT, OF_ASTERIX)) or message_type(kind) == TRACK_BATCH
    if is_told or payload[:7] == b"<event ":
        return True
    is_block = payload[:1] == b"\x3e" and int.from_bytes(payload[1:3], "big") <= len(payload)
    if is_block and len(payload) > 3 and (not kind or "asterix" in kind):
        return True
    head = payload[:400]
    return b'"latitude_deg"' in head and b'"track"' in head


def _entries_of(path: Path) -> Iterator[Mapping[str, Any]] | None:
    """Entries of a table or a text, as its suffix says; None for what may be a recording."""
    suffix = path.suffix.lower()
    if suffix in TABLES:
        return _lines(path, TABLES[suffix])
    is_told = suffix in FEATURES
    if suffix in LINES:  # of JSON, which may be messages of a recording
        with path.open("rb") as file:
            is_told = b'"topic"' not in file.readline(MAX_OCTETS)
    return _features(path) if is_told else None


def _lines(path: Path, delimiter: str) -> Iterator[Mapping[str, Any]]:
    """Lines of a table, by the names in its first."""
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
        rows = csv.DictReader(file, delimiter=delimiter)
        try:
            names = {name.strip() for name in rows.fieldnames or () if name}
            if not is_table_of_tracks(delimiter.join(names), delimiter):
                there = printable(", ".join(sorted(names)))[:100]
                raise PlotfeedError(
                    f"{path}: expected columns track, time_utc, latitude_deg and longitude_deg in "
                    f"its first line, not {there or 'an empty file'}"
                )
            for row in rows:
                yield {(name or "").strip(): value for name, value in row.items()}
        except csv.Error as error:
            raise PlotfeedError(f"{path}: line {rows.line_num}: {error}") from None


def is_table_of_tracks(line: str, delimiter: str = ",") -> bool:
    """Whether the first line of a table names what a report of a track needs."""
    names = {name.strip().strip('"') for name in line.split(delimiter)}
    has_place = {"latitude_deg", "longitude_deg"} <= names
    return has_place and bool(names & {"track", "id"} and names & TIMES)


TIMES = {"time_utc", "time_utc_ns", "time"}


def _features(path: Path) -> Iterator[Mapping[str, Any]]:
    """Features of GeoJSON, entries of JSON, or events of Cursor on Target."""
    if path.stat().st_size > MAX_FILE_OCTETS:
        raise PlotfeedError(f"{path}: expected at most {MAX_FILE_OCTETS >> 20} MB of text")
    try:
        text = path.read_bytes()
        yield from (events_in if text.lstrip()[:1] == b"<" else entries_in)(text)
    except DecodeError as error:
        raise PlotfeedError(f"{path}: {error}") from None


HIGHEST_M = 1e5  # Heights beyond this are not taken for any


def is_place(told: ReportedTracks) -> Bools:
    """Which reports are of a place on Earth, (n,)."""
    with np.errstate(invalid="ignore"):
        on_earth = (np.abs(told.latitude_deg) <= 90.0) & (np.abs(told.longitude_deg) <= 180.0)
        return on_earth & (np.isnan(told.height_m) | (np.abs(told.height_m) <= HIGHEST_M))

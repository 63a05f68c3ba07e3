"""What a tracker published: tracks of messages and files, as columns."""

from __future__ import annotations

import contextlib
import csv
import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import unescape
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from google.protobuf.message import DecodeError as ProtobufDecodeError

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.console.printed import printable
from plotfeed.feeds.messages.message import checked_topic_filter, is_chosen
from plotfeed.feeds.recording.foreign_recordings import ForeignReader
from plotfeed.feeds.scene.fields import site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.frames import LocalFrame, geoid_undulation_m
from plotfeed.models.state import Bools, Columns, Floats, Ints
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.codec.decode import Record, decode, whole_blocks
from plotfeed.proto.content_types import (
    COT,
    SAPIENT_MESSAGE,
    TRACK_BATCH,
    asterix_content_type,
    message_type,
)
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.proto.units import FOOT_M
from plotfeed.proto.utc import NS, nearest_utc_ns, utc_ns
from plotfeed.replay.files import FORMATS, FileFormat
from plotfeed.replay.recorded import WHAT_LEFT, Recorded, Stage

# In place of a time that nobody told.
UNKNOWN_NS = -(2**63)
LATEST_NS = 2**63 - 1
COVARIANCES = ("east_m2", "north_m2", "up_m2", "east_north_m2", "east_up_m2", "north_up_m2")
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


@dataclass(frozen=True, slots=True, kw_only=True)
class ToldTrack:
    """One report as a message or a line has it; NaN and None for what it does not tell."""

    name: str
    t_utc_ns: int | None
    latitude_deg: float
    longitude_deg: float
    height_m: float = np.nan
    velocity_enu_m_s: tuple[float, float, float] = (np.nan,) * 3
    covariance_m2: tuple[float, ...] = (np.nan,) * 6  # As `COVARIANCES`
    tentative: bool = False
    coasted: bool = False  # Predicted, for want of a plot
    ended: bool = False
    received_utc_ns: int | None = None  # Where the report itself says it


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
        when = zip(told, came_ns, strict=True)
        of_ns = [came if each.t_utc_ns is None else each.t_utc_ns for each, came in when]
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


T = TypeVar("T")
MAX_OCTETS = 1 << 20
CATEGORY = 62
MOST_NAME = 64
NAN = math.nan
TRUE_WORDS = frozenset({"1", "true", "yes"})


def tracks_in(
    payload: bytes,
    content_type: str,
    received_utc_ns: int,
    site: LocalFrame | None,
    refuse: Callable[[str], None] | None = None,
) -> list[ToldTrack]:
    """The tracks in a message, by its content type and its first octets; raises `DecodeError`.

    Of JSON and XML `refuse` is told of each entry that cannot be read, which spoils no other.
    ASTERIX has times of day: of the day that brings them nearest to `received_utc_ns`. A record
    that has only X and Y counts from the site.
    """
    if len(payload) > MAX_OCTETS:
        raise DecodeError(f"{len(payload)} octets of tracks; at most {MAX_OCTETS} are read")
    kind = message_type(content_type)
    if kind == TRACK_BATCH:
        return list(_of_batch(payload))
    if kind == SAPIENT_MESSAGE:
        return list(_of_sapient(payload))
    held = [*whole_blocks(payload)]
    is_all = bool(held) and held[-1].at_octet + len(held[-1].body) == len(payload)
    if payload[:1] == bytes([CATEGORY]) or (is_all and CATEGORY in [b.category for b in held]):
        records = (record for record in decode(payload) if record.category == CATEGORY)
        found = (_of_record(record, received_utc_ns, site) for record in records)
        return [told for told in found if told is not None]
    head = payload.lstrip()[:5]
    if head[:1] in (b"{", b"["):
        return list(_tracks_of(entries_in(payload), refuse))
    if head in (b"<?xml", b"<even"):
        return list(_tracks_of(events_in(payload), refuse))
    for read in (_of_batch, _of_sapient):
        try:
            if told := list(read(payload)):
                return told
        except PlotfeedError:  # SAPIENT is an extra that may be missing
            continue
    raise DecodeError("is neither ASTERIX 062, SAPIENT, a TrackBatch, JSON nor Cursor on Target")


def _of_record(record: Record, near_utc_ns: int, site: LocalFrame | None) -> ToldTrack | None:
    """A record of category 062; None without a number or a place."""

    def value(path: str) -> float:
        found = record.get(f"I062/{path}")
        return float(found) if isinstance(found, int | float) else NAN

    number = record.get("I062/040")
    latitude_deg, longitude_deg = value("105/LAT"), value("105/LON")
    if math.isnan(latitude_deg) and site is not None and not math.isnan(value("100/X")):
        place = site.to_geodetic([value("100/X"), value("100/Y"), 0.0])
        latitude_deg, longitude_deg = float(place[0]), float(place[1])
    if not isinstance(number, int) or math.isnan(latitude_deg):
        return None
    time_of_day_s = value("070")
    day_ns = 0 if math.isnan(time_of_day_s) else round(time_of_day_s * NS)
    east_m, north_m, cross = value("500/APC/X"), value("500/APC/Y"), value("500/COV")
    # The part in common is told as a length with the sign of the covariance.
    cross_m2 = 0.0 if math.isnan(cross) else math.copysign(cross * cross, cross)
    source = ".".join(str(record.get(f"I062/010/{part}")) for part in ("SAC", "SIC"))
    return ToldTrack(
        name=f"{source}.{number}",
        t_utc_ns=None if math.isnan(time_of_day_s) else nearest_utc_ns(day_ns, near_utc_ns),
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        height_m=value("130") * FOOT_M,
        velocity_enu_m_s=(value("185/VX"), value("185/VY"), value("220") * FOOT_M / 60),
        covariance_m2=(_squared(east_m), _squared(north_m), NAN, cross_m2, NAN, NAN),
        tentative=bool(record.get("I062/080/CNF")),
        coasted=bool(record.get("I062/080/CST")),
        ended=bool(record.get("I062/080/TSE")),
    )


def _squared(value: float) -> float:
    """The square, infinite where a power would raise an error."""
    return value * value


def _of_batch(payload: bytes) -> Iterator[ToldTrack]:
    try:
        batch = pb.TrackBatch.FromString(payload)
    except ProtobufDecodeError:
        raise DecodeError(f"{len(payload)} octets that are not a TrackBatch") from None
    for track in batch.tracks:

        def value(name: str, track: pb.Track = track) -> float:
            return float(getattr(track, name)) if track.HasField(name) else NAN

        up_m2 = _squared(value("sigma_up_m"))
        level_m2 = tuple(_squared(s) or NAN for s in (track.sigma_east_m, track.sigma_north_m))
        yield ToldTrack(
            name=(track.id or str(track.number))[:MOST_NAME],
            t_utc_ns=track.time_utc_ns,
            latitude_deg=track.latitude_deg,
            longitude_deg=track.longitude_deg,
            height_m=value("height_m"),
            velocity_enu_m_s=(
                track.velocity_east_m_s,
                track.velocity_north_m_s,
                value("climb_m_s"),
            ),
            covariance_m2=(*level_m2, up_m2, 0.0, 0.0, 0.0),
            coasted=track.coasted,
            ended=track.last,
        )


# Systems of SAPIENT in which places are angles, and how many degrees are one of theirs.
IN_DEGREES = {
    "LOCATION_COORDINATE_SYSTEM_LAT_LNG_DEG_M": 1.0,
    "LOCATION_COORDINATE_SYSTEM_LAT_LNG_RAD_M": math.degrees(1.0),
}
GEOID = "LOCATION_DATUM_WGS84_G"
# Of a meridian: good enough for what an error of an angle is in metres.
DEGREE_M = math.radians(1.0) * 6_371_000.0


def _of_sapient(payload: bytes) -> Iterator[ToldTrack]:
    """The track that a detection report tells of; what has no place by angles is none."""
    need_extra("sapient_msg", "SAPIENT", "sapient")
    from plotfeed.proto.sapient.decode_sapient import decode as decode_sapient

    message = decode_sapient(payload)
    report: Mapping[str, Any] = message.get("detection_report", {})
    place = report.get("location", {})
    system = str(place.get("coordinate_system", ""))
    unit_deg = IN_DEGREES.get(system)
    if "UTM" in system:
        raise DecodeError("a place by UTM coordinates, which has no zone there")
    if unit_deg is None:
        return
    longitude_deg, latitude_deg = unit_deg * _real(place, "x"), unit_deg * _real(place, "y")
    height_m = _real(place, "z")
    if place.get("datum") == GEOID:
        height_m += float(geoid_undulation_m(latitude_deg, longitude_deg))
    velocity = report.get("enu_velocity", {})
    east_m = unit_deg * _real(place, "x_error") * DEGREE_M * math.cos(math.radians(latitude_deg))
    north_m = unit_deg * _real(place, "y_error") * DEGREE_M
    rates = ("east_rate", "north_rate", "up_rate")
    east_m_s, north_m_s, up_m_s = (_real(velocity, name) for name in rates)
    yield ToldTrack(
        name=str(report.get("object_id", ""))[:MOST_NAME],
        t_utc_ns=utc_ns(str(message.get("timestamp", ""))),
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        height_m=height_m,
        velocity_enu_m_s=(east_m_s, north_m_s, up_m_s),
        covariance_m2=(*map(_squared, (east_m, north_m, _real(place, "z_error"))), 0.0, 0.0, 0.0),
        ended=str(report.get("state", "")).lower() in ("lost", "ended", "deleted"),
    )


def _real(values: Mapping[str, Any], name: str) -> float:
    found = values.get(name, NAN)
    return float(found) if isinstance(found, int | float) else NAN


def entries_in(payload: bytes) -> list[Mapping[str, Any]]:
    """Entries of JSON: objects, in lists or line by line, or features of GeoJSON as such."""
    try:
        try:
            found = json.loads(payload)
        except ValueError:
            if len(lines := payload.split(b"\n")) < 2:
                raise
            found = [json.loads(line) for line in lines if line.strip()]
    except (ValueError, RecursionError) as error:
        raise DecodeError(f"not JSON: {str(error)[:100]}") from None
    if isinstance(found, dict) and found.get("type") == "FeatureCollection":
        found = found.get("features")
    entries = found if isinstance(found, list) else [found]
    if not all(isinstance(entry, dict) for entry in entries):
        raise DecodeError("tracks in JSON are an object each, or a list of objects")
    features = (_of_feature(e) if e.get("type") == "Feature" else [e] for e in entries)
    return [entry for each in features for entry in each]


PLACE = ("longitude_deg", "latitude_deg", "height_m")
LINE_TIMES = ("coordTimes", "times", "time")


def _of_feature(feature: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """A feature of GeoJSON as an object for each of its places: one of a point, or of a line."""
    geometry, properties = feature.get("geometry"), feature.get("properties")
    of = geometry if isinstance(geometry, dict) else {}
    named = dict(properties) if isinstance(properties, dict) else {}
    if feature.get("id") is not None:
        named["track"] = feature["id"]
    kind, places = of.get("type"), of.get("coordinates")
    times: list[Any] | None = None
    if kind == "LineString":
        times = next((named.pop(key) for key in LINE_TIMES if isinstance(named.get(key), list)), [])
    elif kind == "Point":
        places = [places]
    if not isinstance(places, list) or kind not in ("Point", "LineString"):
        raise DecodeError("a feature of a track is a Point or a LineString")
    if not all(isinstance(place, list) and 2 <= len(place) <= 3 for place in places):
        raise DecodeError("a place is longitude, latitude and perhaps a height")
    found = [named | dict(zip(PLACE, place, strict=False)) for place in places]
    if times is None:
        return list(found)
    if len(times) != len(places):
        raise DecodeError(f"a LineString of a track has a time for each place: {LINE_TIMES[0]}")
    return [entry | {"time_utc": time} for entry, time in zip(found, times, strict=True)]


_TAG = re.compile(rb"<(event|point|track)\b([^<>]*)>")
_ATTRIBUTE = re.compile(r"""([\w:]+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")
NO_HEIGHT_M = 9_999_999.0


def events_in(payload: bytes) -> list[Mapping[str, Any]]:
    """Events of Cursor on Target as objects; `ce` and `le` are taken for two standard errors."""
    found: list[dict[str, Any]] = []
    for tag, text in _TAG.findall(payload):
        pairs = _ATTRIBUTE.findall(text.decode(errors="replace"))
        told = {name: unescape(one or other) for name, one, other in pairs}
        if tag == b"event":
            found.append({"track": told.get("uid"), "time_utc": told.get("time")})
            found[-1]["ended"] = told.get("stale", "1") <= told.get("start", "0")
        elif tag == b"point" and found:
            found[-1] |= {"latitude_deg": told.get("lat"), "longitude_deg": told.get("lon")}
            for key, name, factor in EVENT_ERRORS:
                with contextlib.suppress(ValueError):
                    value = float(told.get(name, NO_HEIGHT_M))
                    found[-1] |= {k: value / factor for k in key if value < NO_HEIGHT_M}
        elif found:
            found[-1] |= {"speed_m_s": told.get("speed"), "course_deg": told.get("course")}
    if not found:
        raise DecodeError("XML without an event of Cursor on Target")
    return list(found)


EVENT_ERRORS = (
    (("height_m",), "hae", 1.0),
    (("sigma_east_m", "sigma_north_m"), "ce", 2.0),
    (("sigma_up_m",), "le", 2.0),
)


def track_of_mapping(entry: Mapping[str, Any]) -> ToldTrack:
    """A track by the names of its columns, of JSON or of a table; raises `DecodeError`."""
    name = entry.get("track", entry.get("id"))
    if name is None or name == "" or isinstance(name, bool | float | list | dict):
        raise DecodeError("track: expected a number or a name")
    latitude_deg, longitude_deg = (_number(entry, f"{n}_deg") for n in ("latitude", "longitude"))
    east_m_s, north_m_s = (_number(entry, f"velocity_{n}_m_s") for n in ("east", "north"))
    speed_m_s, course = _number(entry, "speed_m_s"), math.radians(_number(entry, "course_deg"))
    if math.isnan(east_m_s) and math.isfinite(speed_m_s) and math.isfinite(course):
        east_m_s, north_m_s = speed_m_s * math.sin(course), speed_m_s * math.cos(course)
    climb_m_s = _number(entry, "climb_m_s")
    up_m_s = _number(entry, "velocity_up_m_s") if math.isnan(climb_m_s) else climb_m_s
    return ToldTrack(
        name=str(name)[:MOST_NAME],
        t_utc_ns=_time_of(entry, "time_utc"),
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        height_m=_number(entry, "height_m"),
        velocity_enu_m_s=(east_m_s, north_m_s, up_m_s),
        covariance_m2=tuple(_covariances(entry)),
        tentative=_is_true(entry, "tentative"),
        coasted=_is_true(entry, "coasted"),
        ended=_is_true(entry, "ended") or _is_true(entry, "last"),
        received_utc_ns=_time_of(entry, "received_utc"),
    )


def _covariances(entry: Mapping[str, Any]) -> Iterator[float]:
    """Covariances that are told, or the squares of sigmas; with these the others are 0."""
    is_told = False
    for name in COVARIANCES:
        found = _number(entry, f"covariance_{name}")
        sigma = f"sigma_{name.removesuffix('2')}"
        if math.isnan(found) and name.count("_") == 1:
            found = _squared(_number(entry, sigma))
        is_told = is_told or not math.isnan(found)
        yield 0.0 if math.isnan(found) and is_told and name.count("_") > 1 else found


def _number(entry: Mapping[str, Any], key: str) -> float:
    """A number, or the text of one; NaN where it is not there."""
    value = entry.get(key)
    return NAN if value is None or value == "" else _told(value, key, float, "a number")


def _is_true(entry: Mapping[str, Any], key: str) -> bool:
    return str(entry.get(key, "")).strip().lower() in TRUE_WORDS


def _time_of(entry: Mapping[str, Any], key: str) -> int | None:
    """A time as text, or as whole nanoseconds or seconds since 1970; None where it is not there."""
    value, whole = entry.get(key), entry.get(f"{key}_ns")
    if key == "time_utc" and value in (None, ""):
        value = entry.get("time")
    if whole not in (None, ""):
        return _told(whole, f"{key}_ns", int, SOME_TIME)
    if value is None or value == "":
        return None
    found = utc_ns(value.strip().replace(" ", "T")) if isinstance(value, str) else None
    if found is not None:
        return found
    return _told(value, key, lambda seconds: round(float(seconds) * NS), SOME_TIME)


SOME_TIME = "a time such as 2026-01-01T12:00:00.5Z"


def _told(value: Any, key: str, read: Callable[[Any], T], expected: str) -> T:
    """What is read of a value; raises `DecodeError` for one that is not what was expected."""
    try:
        if isinstance(value, bool):
            raise TypeError
        return read(value)
    except (ValueError, TypeError, OverflowError):
        raise DecodeError(f"{key}: expected {expected}, not {str(value)[:40]!r}") from None


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
    suffix = path.suffix.lower()
    if suffix in TABLES:
        _take(table, _lines(path, suffix), path)
        return table.read(path.name)
    is_told = suffix in FEATURES
    if suffix in LINES:  # of JSON, which may be messages of a recording
        with path.open("rb") as file:
            is_told = b'"topic"' not in file.readline(MAX_OCTETS)
    if is_told:
        _take(table, _features(path), path)
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
    kind, is_own = message.content_type, bool(own) and message.topic.startswith(own)
    is_json = bool(own) and message.payload[:1] in (b"{", b"[")
    if not is_own and (is_json or message_type(kind) == SAPIENT_MESSAGE):
        with contextlib.suppress(PlotfeedError):
            told = tracks_in(message.payload, kind, message.log_time_ns, None)
            return any(math.isfinite(each.latitude_deg) for each in told)
    if kind.startswith(COT) or message.payload[:7] == b"<event ":
        return True
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
    delimiter = TABLES[suffix]
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


def _tracks_of(
    entries: Iterable[Mapping[str, Any]], refuse: Callable[[str], None] | None
) -> Iterator[ToldTrack]:
    for entry in entries:
        try:
            yield track_of_mapping(entry)
        except DecodeError as error:
            if refuse is None:
                raise
            refuse(str(error).partition(", not ")[0])


def _take(table: TrackTable, entries: Iterator[Mapping[str, Any]], path: Path) -> None:
    for told in _tracks_of(entries, table.refuse):
        table.add(told)
    if not len(table) and not table.unreadable:
        table.refuse(f"{path.name} holds no tracks")


HIGHEST_M = 1e5  # Heights beyond this are not taken for any


def is_place(told: ReportedTracks) -> Bools:
    """Which reports are of a place on Earth, (n,)."""
    with np.errstate(invalid="ignore"):
        on_earth = (np.abs(told.latitude_deg) <= 90.0) & (np.abs(told.longitude_deg) <= 180.0)
        return on_earth & (np.isnan(told.height_m) | (np.abs(told.height_m) <= HIGHEST_M))

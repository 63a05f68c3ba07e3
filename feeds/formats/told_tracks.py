"""Tracks as a tracker tells them: reports in messages of any format, and in entries of tables."""

from __future__ import annotations

import contextlib
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from html import unescape
from typing import Any, TypeVar

from google.protobuf.message import DecodeError as ProtobufDecodeError

from plotfeed.feeds.console.extras import need_extra
from plotfeed.models.frames import LocalFrame, geoid_undulation_m
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.codec.decode import Record, decode, whole_blocks
from plotfeed.proto.content_types import SAPIENT_MESSAGE, TRACK_BATCH, message_type
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.proto.units import FOOT_M
from plotfeed.proto.utc import NS, nearest_utc_ns, utc_ns

NAN = math.nan
COVARIANCES = ("east_m2", "north_m2", "up_m2", "east_north_m2", "east_up_m2", "north_up_m2")


@dataclass(frozen=True, slots=True, kw_only=True)
class ToldTrack:
    """One report as a message or a line has it; NaN and None for what it does not tell."""

    name: str
    t_utc_ns: int | None
    latitude_deg: float
    longitude_deg: float
    height_m: float = NAN
    velocity_enu_m_s: tuple[float, float, float] = (NAN,) * 3
    covariance_m2: tuple[float, ...] = (NAN,) * 6  # As `COVARIANCES`
    tentative: bool = False
    coasted: bool = False  # Predicted, for want of a plot
    ended: bool = False
    received_utc_ns: int | None = None  # Where the report itself says it


T = TypeVar("T")
MAX_OCTETS = 1 << 20
CATEGORY = 62
MOST_NAME = 64
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
        return list(tracks_of_entries(entries_in(payload), refuse))
    if head in (b"<?xml", b"<even"):
        return list(tracks_of_entries(events_in(payload), refuse))
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
NOT_KNOWN = 9_999_999.0


def events_in(payload: bytes) -> list[Mapping[str, Any]]:
    """Events of Cursor on Target as objects; by event.xsd 2.0 `ce` and `le` are one sigma."""
    found: list[dict[str, Any]] = []
    for tag, text in _TAG.findall(payload):
        pairs = _ATTRIBUTE.findall(text.decode(errors="replace"))
        told = {name: unescape(one or other) for name, one, other in pairs}
        if tag == b"event":
            found.append({"track": told.get("uid"), "time_utc": told.get("time")})
            found[-1]["ended"] = told.get("stale", "1") <= told.get("start", "0")
        elif tag == b"point" and found:
            found[-1] |= {"latitude_deg": told.get("lat"), "longitude_deg": told.get("lon")}
            for keys, name in EVENT_COLUMNS:
                with contextlib.suppress(ValueError):
                    value = float(told.get(name, NOT_KNOWN))
                    found[-1] |= dict.fromkeys(keys if value < NOT_KNOWN else (), value)
        elif found:
            found[-1] |= {"speed_m_s": told.get("speed"), "course_deg": told.get("course")}
    if not found:
        raise DecodeError("XML without an event of Cursor on Target")
    return list(found)


EVENT_COLUMNS = (
    (("height_m",), "hae"),
    (("sigma_east_m", "sigma_north_m"), "ce"),
    (("sigma_up_m",), "le"),
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


def tracks_of_entries(
    entries: Iterable[Mapping[str, Any]], refuse: Callable[[str], None] | None
) -> Iterator[ToldTrack]:
    """Reports of entries; `refuse` is told why one is none, or else `DecodeError` is raised."""
    for entry in entries:
        try:
            yield track_of_mapping(entry)
        except DecodeError as error:
            if refuse is None:
                raise
            refuse(str(error).partition(", not ")[0])

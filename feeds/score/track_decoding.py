"""Tracks in messages: ASTERIX 062, SAPIENT detections, our protobuf, JSON and GeoJSON.

Messages come from outside: whatever they are, they give tracks or a `DecodeError`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from google.protobuf.message import DecodeError as ProtobufDecodeError

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.score.track_table import COVARIANCES, ToldTrack
from plotfeed.models.frames import LocalFrame
from plotfeed.models.geoid import geoid_undulation_m
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.codec.decode import Record, decode
from plotfeed.proto.content_types import SAPIENT_MESSAGE, TRACK_BATCH, message_type
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.proto.units import FOOT_M
from plotfeed.proto.utc import NS, nearest_utc_ns, utc_ns

MAX_OCTETS = 1 << 20
CATEGORY = 62
MOST_NAME = 64
NAN = math.nan
TRUE_WORDS = frozenset({"1", "true", "yes"})


def tracks_in(
    payload: bytes, content_type: str, received_utc_ns: int, site: LocalFrame | None
) -> list[ToldTrack]:
    """The tracks in a message, by its content type and its first octets; raises `DecodeError`.

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
    if payload[:1] == bytes([CATEGORY]):
        records = (record for record in decode(payload) if record.category == CATEGORY)
        found = (_of_record(record, received_utc_ns, site) for record in records)
        return [told for told in found if told is not None]
    if payload.lstrip()[:1] in (b"{", b"["):
        return [track_of_mapping(entry) for entry in entries_in(payload)]
    for read in (_of_batch, _of_sapient):
        try:
            if told := list(read(payload)):
                return told
        except PlotfeedError:  # SAPIENT is an extra that may be missing
            continue
    raise DecodeError("is neither ASTERIX 062, SAPIENT, a TrackBatch nor JSON")


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
        covariance_m2=(east_m**2, north_m**2, NAN, cross_m2, NAN, NAN),
        tentative=bool(record.get("I062/080/CNF")),
        coasted=bool(record.get("I062/080/CST")),
        ended=bool(record.get("I062/080/TSE")),
    )


def _of_batch(payload: bytes) -> Iterator[ToldTrack]:
    try:
        batch = pb.TrackBatch.FromString(payload)
    except ProtobufDecodeError:
        raise DecodeError(f"{len(payload)} octets that are not a TrackBatch") from None
    for track in batch.tracks:

        def value(name: str, track: pb.Track = track) -> float:
            return float(getattr(track, name)) if track.HasField(name) else NAN

        up_m2 = value("sigma_up_m") ** 2
        level_m2 = (track.sigma_east_m**2 or NAN, track.sigma_north_m**2 or NAN)
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


IN_DEGREES = {
    "LOCATION_COORDINATE_SYSTEM_LAT_LNG_DEG_M": 1.0,
    "LOCATION_COORDINATE_SYSTEM_LAT_LNG_RAD_M": math.degrees(1.0),
}
"""Systems of SAPIENT in which places are angles, and how many degrees are one of theirs."""
GEOID = "LOCATION_DATUM_WGS84_G"
DEGREE_M = math.radians(1.0) * 6_371_000.0
"""Of a meridian: good enough for what an error of an angle is in metres."""


def _of_sapient(payload: bytes) -> Iterator[ToldTrack]:
    """The track that a detection report tells of; what has no place by angles is none."""
    need_extra("sapient_msg", "SAPIENT", "sapient")
    from plotfeed.proto.sapient.decode_sapient import decode as decode_sapient

    message = decode_sapient(payload)
    report: Mapping[str, Any] = message.get("detection_report", {})
    place = report.get("location", {})
    unit_deg = IN_DEGREES.get(place.get("coordinate_system", ""))
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
        covariance_m2=(east_m**2, north_m**2, _real(place, "z_error") ** 2, 0.0, 0.0, 0.0),
        ended=str(report.get("state", "")).lower() in ("lost", "ended", "deleted"),
    )


def _real(values: Mapping[str, Any], name: str) -> float:
    found = values.get(name, NAN)
    return float(found) if isinstance(found, int | float) else NAN


def entries_in(payload: bytes) -> list[Mapping[str, Any]]:
    """Entries of JSON: one object, a list of them, or features of GeoJSON as such objects."""
    try:
        found = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise DecodeError(f"not JSON: {str(error)[:100]}") from None
    if isinstance(found, dict) and found.get("type") == "FeatureCollection":
        found = found.get("features")
    entries = found if isinstance(found, list) else [found]
    if not all(isinstance(entry, dict) for entry in entries):
        raise DecodeError("tracks in JSON are an object each, or a list of objects")
    return [_of_feature(entry) if entry.get("type") == "Feature" else entry for entry in entries]


def _of_feature(feature: Mapping[str, Any]) -> Mapping[str, Any]:
    """A feature of GeoJSON as an object with its place: longitude, latitude, perhaps height."""
    geometry, properties = feature.get("geometry"), feature.get("properties")
    place = geometry.get("coordinates") if isinstance(geometry, dict) else None
    is_point = isinstance(geometry, dict) and geometry.get("type") == "Point"
    if not is_point or not isinstance(place, list) or not 2 <= len(place) <= 3:
        raise DecodeError("a feature of a track is a Point")
    named = dict(properties) if isinstance(properties, dict) else {}
    if feature.get("id") is not None:
        named["track"] = feature["id"]
    return named | dict(zip(("longitude_deg", "latitude_deg", "height_m"), place, strict=False))


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
            found = _number(entry, sigma) ** 2
        is_told = is_told or not math.isnan(found)
        yield 0.0 if math.isnan(found) and is_told and name.count("_") > 1 else found


def _number(entry: Mapping[str, Any], key: str) -> float:
    """A number, or the text of one; NaN where it is not there."""
    value = entry.get(key)
    if value is None or value == "":
        return NAN
    try:
        if isinstance(value, bool):
            raise TypeError
        return float(value)
    except (ValueError, TypeError, OverflowError):
        raise DecodeError(f"{key}: expected a number, not {str(value)[:40]!r}") from None


def _is_true(entry: Mapping[str, Any], key: str) -> bool:
    return str(entry.get(key, "")).strip().lower() in TRUE_WORDS


def _time_of(entry: Mapping[str, Any], key: str) -> int | None:
    """A time as text, or as whole nanoseconds or seconds since 1970; None where it is not there."""
    value, whole = entry.get(key), entry.get(f"{key}_ns")
    if whole not in (None, ""):
        return _counted(whole, f"{key}_ns", int)
    if value is None or value == "":
        return None
    found = utc_ns(value.strip().replace(" ", "T")) if isinstance(value, str) else None
    if found is not None:
        return found
    return _counted(value, key, lambda seconds: round(float(seconds) * NS))


def _counted(value: Any, key: str, read: Callable[[Any], int]) -> int:
    try:
        if isinstance(value, bool):
            raise TypeError
        return read(value)
    except (ValueError, TypeError, OverflowError):
        raise DecodeError(
            f"{key}: expected a time such as 2026-01-01T12:00:00.5Z, not {str(value)[:40]!r}"
        ) from None

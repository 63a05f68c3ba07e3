"""Tracks of the tracker under test, from the messages that it publishes: ASTERIX 062, or JSON.

Messages come from outside: whatever they are, they give tracks or a `DecodeError`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from google.protobuf.timestamp_pb2 import Timestamp

from plotfeed.feeds.page.updates import TrackFlag
from plotfeed.feeds.telemetry.position_report import LATEST_UTC_NS
from plotfeed.models.frames import LocalFrame, geodetic_to_ecef
from plotfeed.models.state import Columns, Floats, Ints
from plotfeed.proto.asterix.codec.decode import Record, decode
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.utc import NS, nearest_utc_ns

MAX_OCTETS = 1 << 20
MAX_TRACKS = 5_000
"""In a message."""
CATEGORY = 62


@dataclass(frozen=True, kw_only=True)
class TrackNews(Columns):
    """What a tracker says of its tracks; columns (n,), velocities NaN where it does not say."""

    t_utc_ns: Ints
    track: Ints
    latitude_deg: Floats
    longitude_deg: Floats
    height_m: Floats
    velocity_east_m_s: Floats
    velocity_north_m_s: Floats
    flags: Ints


def decode_tracks(payload: bytes, now_utc_ns: int, site: LocalFrame) -> TrackNews:
    """The tracks in a message, whatever its format; raises `DecodeError`.

    ASTERIX has times of day: of the day that brings them nearest to now. A record that has only
    X and Y is taken to count from the site.
    """
    if len(payload) > MAX_OCTETS:
        raise DecodeError(f"{len(payload)} octets of tracks; at most {MAX_OCTETS} are taken")
    if payload[:1] == bytes([CATEGORY]):
        records = [r for r in decode(payload) if r.category == CATEGORY]
        rows = [_of_record(record, now_utc_ns, site) for record in records[:MAX_TRACKS]]
    else:
        rows = [_of_entry(entry, now_utc_ns) for entry in _entries(payload)[:MAX_TRACKS]]
    return _news([row for row in rows if row is not None])


def east_north_m(news: TrackNews, site: LocalFrame) -> tuple[Floats, Floats]:
    """East and north of tracks, metres from the site along its horizontal, each (n,)."""
    height_m = np.where(np.isnan(news.height_m), site.height_m, news.height_m)
    enu_m = site.from_ecef(geodetic_to_ecef(news.latitude_deg, news.longitude_deg, height_m))
    return enu_m[:, 0], enu_m[:, 1]


_Row = tuple[int, int, float, float, float, float, float, int]


def _news(rows: Sequence[_Row]) -> TrackNews:
    columns = list(zip(*rows, strict=True)) or [()] * 8
    t_utc_ns, track, *floats, flags = columns
    latitude_deg, longitude_deg, height_m, east_m_s, north_m_s = (
        np.array(column, dtype=np.float64) for column in floats
    )
    return TrackNews(
        t_utc_ns=np.array(t_utc_ns, dtype=np.int64),
        track=np.array(track, dtype=np.int64),
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        height_m=height_m,
        velocity_east_m_s=east_m_s,
        velocity_north_m_s=north_m_s,
        flags=np.array(flags, dtype=np.int64),
    )


def _of_record(record: Record, now_utc_ns: int, site: LocalFrame) -> _Row | None:
    """A record of category 062; None if it has no number or no place."""
    track = record.get("I062/040")
    latitude_deg, longitude_deg = (_float(record.get(f"I062/105/{c}")) for c in ("LAT", "LON"))
    if math.isnan(latitude_deg):
        x_m, y_m = (_float(record.get(f"I062/100/{c}")) for c in ("X", "Y"))
        latitude_deg, longitude_deg = (float(v) for v in site.to_geodetic([x_m, y_m, 0.0])[:2])
    if not isinstance(track, int) or math.isnan(latitude_deg):
        return None
    state = {n: record.get(f"I062/080/{n}") for n in ("CNF", "TSE", "CST")}
    flags = (
        TrackFlag.TENTATIVE * bool(state["CNF"])
        | TrackFlag.COASTED * bool(state["CST"])
        | TrackFlag.ENDED * bool(state["TSE"])
    )
    east_m_s, north_m_s = (_float(record.get(f"I062/185/{c}")) for c in ("VX", "VY"))
    time_of_day_s = _float(record.get("I062/070"))
    t_utc_ns = (
        now_utc_ns
        if math.isnan(time_of_day_s)
        else nearest_utc_ns(round(time_of_day_s * NS), now_utc_ns)
    )
    return t_utc_ns, track, latitude_deg, longitude_deg, math.nan, east_m_s, north_m_s, int(flags)


def _entries(payload: bytes) -> list[Mapping[str, Any]]:
    """Entries of JSON: one object, or a list of them."""
    try:
        found = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise DecodeError(f"tracks are neither ASTERIX 062 nor JSON: {error}") from None
    entries = found if isinstance(found, list) else [found]
    if not all(isinstance(entry, dict) for entry in entries):
        raise DecodeError("tracks in JSON are an object each, or a list of objects")
    return entries


def _of_entry(entry: Mapping[str, Any], now_utc_ns: int) -> _Row:
    """A track as JSON; raises `DecodeError` that names the key."""
    track = entry.get("track")
    if not isinstance(track, int) or not 0 <= track < 1 << 32:
        raise DecodeError(f"track: expected a whole number below 2^32, not {str(track)[:40]!r}")
    latitude_deg = _number(entry, "latitude_deg", 90.0)
    longitude_deg = _number(entry, "longitude_deg", 180.0)
    if math.isnan(latitude_deg) or math.isnan(longitude_deg):
        raise DecodeError("latitude_deg and longitude_deg are needed")
    flags = (
        TrackFlag.TENTATIVE * (entry.get("tentative") is True)
        | TrackFlag.COASTED * (entry.get("coasted") is True)
        | TrackFlag.ENDED * (entry.get("ended") is True)
    )
    return (
        _time(entry, now_utc_ns),
        track,
        latitude_deg,
        longitude_deg,
        _number(entry, "height_m", 1e5),
        _number(entry, "velocity_east_m_s", 1e4),
        _number(entry, "velocity_north_m_s", 1e4),
        int(flags),
    )


def _time(entry: Mapping[str, Any], now_utc_ns: int) -> int:
    text = entry.get("time_utc")
    if text is None:
        return now_utc_ns
    stamp = Timestamp()
    try:
        stamp.FromJsonString(text)
    except (ValueError, TypeError, AttributeError, OverflowError):
        raise DecodeError(
            f"time_utc: expected a time such as 2026-01-01T12:00:00.5Z, not {str(text)[:40]!r}"
        ) from None
    return min(stamp.ToNanoseconds(), LATEST_UTC_NS)


def _number(entry: Mapping[str, Any], key: str, most: float) -> float:
    """NaN if it is not there."""
    value = entry.get(key)
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= most:
        raise DecodeError(f"{key}: expected a number of at most {most:g}, not {str(value)[:40]!r}")
    return float(value)


def _float(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan

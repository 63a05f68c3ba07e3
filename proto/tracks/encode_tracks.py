"""Tracks as receivers take them: protobuf of ours, Cursor on Target, GeoJSON, Foxglove, UTM's JSON.

Cursor on Target is XML by MITRE's event.xsd 2.0: `ce` and `le` are one standard deviation, `hae` is
above the WGS-84 ellipsoid, 9999999 says that nothing is known. Types are those of MIL-STD-2525: an
unknown thing in the air that is unmanned and of rotary wings; `how` is m-s, made by a machine,
simulated. GeoJSON is RFC 7946. UTM systems are Flight Blender and ASTM F3411.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from hashlib import blake2b
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.state import Bools, Columns, Floats, Ints
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.open_drone_id import (
    EDGE_95,
    HORIZONTAL_CLASSES_M,
    RADIUS_95,
    SPEED_CLASSES_M_S,
    UNKNOWN_ALTITUDE_M,
    UNKNOWN_CLIMB_M_S,
    UNKNOWN_SPEED_M_S,
    VERTICAL_CLASSES_M,
)
from plotfeed.proto.utc import NS, iso_utc_ms


@dataclass(frozen=True, kw_only=True)
class Tracks(Columns):
    """Tracks of a sensor at their own times; columns (n,), NaN for what it does not estimate.

    East and north are from the system's reference point, height is above the WGS-84 ellipsoid,
    age is that of the last plot in a track. `coasted` tracks are predicted without one, `first`
    and `last` reports begin and end a track.
    """

    track: Ints
    t_utc_ns: Ints
    latitude_deg: Floats
    longitude_deg: Floats
    east_m: Floats
    north_m: Floats
    velocity_east_m_s: Floats
    velocity_north_m_s: Floats
    height_m: Floats
    climb_m_s: Floats
    age_s: Floats
    sigma_east_m: Floats
    sigma_north_m: Floats
    tentative: Bools
    coasted: Bools
    first: Bools
    last: Bools


@dataclass(frozen=True, kw_only=True)
class ToldTracks(Tracks):
    """Tracks as `Tracks` has them, with what 062 has no room for; NaN for what is not estimated.

    Standard deviations are one sigma, of the position upwards and of the velocity's components.
    """

    sigma_up_m: Floats
    sigma_velocity_east_m_s: Floats
    sigma_velocity_north_m_s: Floats
    sigma_climb_m_s: Floats

    @property
    def speed_m_s(self) -> Floats:
        """Speed over the ground, m/s, (n,)."""
        return np.hypot(self.velocity_east_m_s, self.velocity_north_m_s)

    @property
    def course_deg(self) -> Floats:
        """Clockwise from true north in [0, 360), (n,)."""
        course = np.degrees(np.arctan2(self.velocity_east_m_s, self.velocity_north_m_s)) % 360.0
        return np.where(course == 360.0, 0.0, course)

    @property
    def sigma_level_m(self) -> Floats:
        """The larger one of the deviations east and north, (n,)."""
        return np.maximum(self.sigma_east_m, self.sigma_north_m)

    @property
    def sigma_speed_m_s(self) -> Floats:
        """The larger one of the deviations of the level velocity's components, (n,)."""
        return np.maximum(self.sigma_velocity_east_m_s, self.sigma_velocity_north_m_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackOrigin:
    """Whose tracks they are, and from where: what is the same in all messages of a sensor."""

    sensor: str
    kind: Literal["smoothed-truth", "plain"]
    stale_after_s: float  # A track of which nothing has come for so long is gone

    def name_of(self, number: int) -> str:
        """Name a track so that no other of the session has it."""
        return f"{self.sensor}-{number}"

    def short_name_of(self, number: int) -> str:
        """Name a track in 24 characters; what does not fit gives way to a digest of it."""
        name = self.name_of(number)
        if len(name) <= 24 and name.isascii():
            return name
        digest = blake2b(self.sensor.encode(), digest_size=4).hexdigest()
        return f"{digest}-{number}"


Told = dict[str, Any]  # One track: columns by their names, None for what is not estimated


def one_by_one(tracks: ToldTracks) -> list[Told]:
    """Tracks as values of Python, with speed, course and the deviations of these."""
    columns: dict[str, NDArray[Any]] = dict(vars(tracks))
    columns |= {name: getattr(tracks, name) for name in _DERIVED}
    lists = [_values(column) for column in columns.values()]
    return [dict(zip(columns, values, strict=True)) for values in zip(*lists, strict=True)]


def _values(column: NDArray[Any]) -> list[Any]:
    values: list[Any] = column.tolist()
    if column.dtype.kind == "f" and np.isnan(column).any():
        return [None if value != value else value for value in values]  # noqa: PLR0124 - NaN is not
    return values


_DERIVED = ("speed_m_s", "course_deg", "sigma_level_m", "sigma_speed_m_s")
_DTYPES = {"Ints": np.int64, "Bools": np.bool_, "Floats": np.float64}
NO_TRACKS = ToldTracks(**{f.name: np.zeros(0, _DTYPES[str(f.type)]) for f in fields(ToldTracks)})


KINDS = {"smoothed-truth": pb.SMOOTHED_TRUTH, "plain": pb.PLAIN}
_FIELDS = [
    field.name
    for field in pb.Track.DESCRIPTOR.fields
    if field.name not in {"id", "number", "time_utc_ns"}
]


def track_batch(tracks: ToldTracks, origin: TrackOrigin, scan: int, sector: int) -> bytes:
    """A serialised TrackBatch of a sector; what is not estimated is left out."""
    batch = pb.TrackBatch(sensor=origin.sensor, scan=scan, sector=sector, kind=KINDS[origin.kind])
    for told in one_by_one(tracks):
        number = told["track"]
        batch.tracks.add(
            id=origin.name_of(number),
            number=number,
            time_utc_ns=told["t_utc_ns"],
            **{name: told[name] for name in _FIELDS},
        )
    return batch.SerializeToString()


TYPE, SIMULATED = "a-u-A-M-H-Q", "m-s"
UNKNOWN = "9999999.0"


def cot_events(tracks: ToldTracks, origin: TrackOrigin) -> list[bytes]:
    """An event for each track; that of a track that ends is stale at once."""
    return [_event(told, origin) for told in one_by_one(tracks)]


def _event(told: Told, origin: TrackOrigin) -> bytes:
    from xml.sax.saxutils import quoteattr  # which loads an HTTP client

    name, at_ns = quoteattr(origin.name_of(told["track"])), told["t_utc_ns"]
    time = iso_utc_ms(at_ns)
    stays_ns = 0 if told["last"] else round(origin.stale_after_s * NS)
    remarks = f"plotfeed {origin.kind}{', coasted' if told['coasted'] else ''}"
    return (
        f'<?xml version="1.0" encoding="UTF-8" standalone="yes"?>'
        f'<event version="2.0" uid={name} type="{TYPE}" how="{SIMULATED}"'
        f' time="{time}" start="{time}" stale="{iso_utc_ms(at_ns + stays_ns)}">'
        f'<point lat="{told["latitude_deg"]:.7f}" lon="{told["longitude_deg"]:.7f}"'
        f' hae="{_known(told["height_m"])}" ce="{_known(told["sigma_level_m"])}"'
        f' le="{_known(told["sigma_up_m"])}"/>'
        f'<detail><track course="{told["course_deg"]:.2f}" speed="{told["speed_m_s"]:.2f}"/>'
        f"<contact callsign={name}/><remarks>{remarks}</remarks></detail></event>"
    ).encode()


def _known(value: float | None) -> str:
    return UNKNOWN if value is None else f"{value:.2f}"


# Variance of an altitude that is not measured, and stands as 0 where a number must stand.
UNKNOWN_HEIGHT_M2 = 1e8
DIAGONAL = 2  # Of foxglove.LocationFix: the diagonal of the covariance is known


def feature_of(told: Told, origin: TrackOrigin) -> dict[str, Any]:
    """A track as a point: longitude, latitude and, if it is measured, height over the ellipsoid."""
    name = origin.name_of(told["track"])
    place = [round(told["longitude_deg"], 8), round(told["latitude_deg"], 8)]
    if told["height_m"] is not None:
        place.append(round(told["height_m"], 2))
    return {
        "type": "Feature",
        "id": name,
        "geometry": {"type": "Point", "coordinates": place},
        "properties": {
            "name": name,
            "sensor": origin.sensor,
            "track": told["track"],
            "kind": origin.kind,
            "time_utc": iso_utc_ms(told["t_utc_ns"]),
            "speed_m_s": round(told["speed_m_s"], 2),
            "course_deg": round(told["course_deg"], 2),
            "climb_m_s": _rounded(told["climb_m_s"]),
            "sigma_level_m": _rounded(told["sigma_level_m"]),
            "sigma_up_m": _rounded(told["sigma_up_m"]),
            "coasted": told["coasted"],
            "first": told["first"],
            "last": told["last"],
        },
    }


def feature_collection(tracks: ToldTracks, origin: TrackOrigin) -> bytes:
    """A FeatureCollection of the tracks of a sector."""
    return _collection([feature_of(told, origin) for told in one_by_one(tracks)]).encode()


class LiveFeatures:
    """The living tracks of one sensor as foxglove.GeoJSON: a map shows the last message alone."""

    def __init__(self) -> None:
        self._features: dict[int, tuple[int, dict[str, Any]]] = {}

    def message(self, tracks: ToldTracks, origin: TrackOrigin) -> bytes:
        """All tracks that live at the end of the sector that these are of."""
        told = one_by_one(tracks)
        for one in told:
            self._features[one["track"]] = one["t_utc_ns"], feature_of(one, origin)
        shown = [feature for _, feature in self._features.values()]
        ended = {one["track"] for one in told if one["last"]}
        now_ns = max(one["t_utc_ns"] for one in told)
        oldest_ns = now_ns - round(origin.stale_after_s * NS)
        self._features = {
            number: (at_ns, feature)
            for number, (at_ns, feature) in self._features.items()
            if number not in ended and at_ns >= oldest_ns
        }
        return json.dumps({"geojson": _collection(shown)}, separators=(",", ":")).encode()


def location_fixes(tracks: ToldTracks, origin: TrackOrigin) -> list[bytes]:
    """A foxglove.LocationFix for each track; its frame is the track's name."""
    return [_fix(told, origin) for told in one_by_one(tracks)]


def _fix(told: Told, origin: TrackOrigin) -> bytes:
    seconds, ns = divmod(told["t_utc_ns"], NS)
    is_flat = told["height_m"] is None
    up_m2 = UNKNOWN_HEIGHT_M2 if is_flat else told["sigma_up_m"] ** 2
    level_m2 = told["sigma_east_m"] ** 2, told["sigma_north_m"] ** 2
    fix = {
        "timestamp": {"sec": seconds, "nsec": ns},
        "frame_id": origin.name_of(told["track"]),
        "latitude": told["latitude_deg"],
        "longitude": told["longitude_deg"],
        "altitude": 0.0 if is_flat else told["height_m"],
        "position_covariance": [level_m2[0], 0, 0, 0, level_m2[1], 0, 0, 0, up_m2],
        "position_covariance_type": DIAGONAL,
    }
    return json.dumps(fix, separators=(",", ":")).encode()


def _collection(features: list[dict[str, Any]]) -> str:
    collection = {"type": "FeatureCollection", "features": features}
    return json.dumps(collection, separators=(",", ":"), ensure_ascii=False)


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 2)


PRIMARY_RADAR = 5  # Flight Blender's `traffic_source` of what does not answer
OF_ONE_SOURCE = 0  # Its `source_type` of what is not fused
MOST_SPEED_M_S, MOST_CLIMB_M_S = 254.25, 62.0  # That F3411 has numbers for


def air_traffic(tracks: ToldTracks, origin: TrackOrigin) -> bytes:
    """The body of Flight Blender's set_air_traffic: an observation a track.

    `icao_address` is the name of the track, in at most 24 characters; altitudes are above the
    WGS-84 ellipsoid, and 0 where none is measured, which the metadata say.
    """
    observations = [
        {
            "lat_dd": round(told["latitude_deg"], 8),
            "lon_dd": round(told["longitude_deg"], 8),
            "altitude_mm": round(1000.0 * (told["height_m"] or 0.0), 1),
            "icao_address": origin.short_name_of(told["track"]),
            "traffic_source": PRIMARY_RADAR,
            "source_type": OF_ONE_SOURCE,
            "timestamp": told["t_utc_ns"] // 1_000_000,
            "metadata": {
                "sensor": origin.sensor,
                "kind": origin.kind,
                "simulated": True,
                "altitude_is_measured": told["height_m"] is not None,
                "speed_m_s": round(told["speed_m_s"], 2),
                "course_deg": round(told["course_deg"], 2),
                "coasted": told["coasted"],
                "last": told["last"],
            },
        }
        for told in one_by_one(tracks)
    ]
    return _json({"observations": observations})


def f3411_flights(tracks: ToldTracks, origin: TrackOrigin) -> bytes:
    """Flights as a service provider answers GET /uss/flights of ASTM F3411-22a."""
    told = one_by_one(tracks)
    at_ns = max(one["t_utc_ns"] for one in told)
    flights = [_flight(one, origin) for one in told]
    return _json({"timestamp": rfc3339(at_ns), "flights": flights})


def _flight(told: Told, origin: TrackOrigin) -> dict[str, Any]:
    climb_m_s, speed_m_s = told["climb_m_s"], told["speed_m_s"]
    height_m = told["height_m"]
    return {
        "id": origin.name_of(told["track"]),
        "aircraft_type": "NotDeclared",
        "simulated": True,
        "current_state": {
            "timestamp": rfc3339(told["t_utc_ns"]),
            "timestamp_accuracy": 0.0,
            "operational_status": "Undeclared",
            "position": {
                "lat": round(told["latitude_deg"], 7),
                "lng": round(told["longitude_deg"], 7),
                "alt": UNKNOWN_ALTITUDE_M if height_m is None else round(height_m, 1),
                "accuracy_h": _bound(HORIZONTAL_CLASSES_M, RADIUS_95, told["sigma_level_m"]),
                "accuracy_v": _bound(VERTICAL_CLASSES_M, EDGE_95, told["sigma_up_m"]),
                "extrapolated": told["coasted"],
            },
            "track": round(told["course_deg"], 1) % 360.0,
            "speed": round(speed_m_s, 2) if speed_m_s <= MOST_SPEED_M_S else UNKNOWN_SPEED_M_S,
            "speed_accuracy": _bound(SPEED_CLASSES_M_S, RADIUS_95, told["sigma_speed_m_s"]),
            "vertical_speed": (
                UNKNOWN_CLIMB_M_S
                if climb_m_s is None or abs(climb_m_s) > MOST_CLIMB_M_S
                else round(climb_m_s, 2)
            ),
        },
    }


def _bound(classes: Mapping[str, float], of_sigma: float, sigma: float | None) -> str:
    """The name of the least bound that holds 95 % of an error; beyond the last one, of that."""
    unknown, *bounded = classes
    if sigma is None:
        return unknown
    for name in reversed(bounded):
        if of_sigma * sigma <= classes[name]:
            return name
    return f"{bounded[0]}Plus"


def rfc3339(t_utc_ns: int) -> dict[str, str]:
    """A time as F3411 has it."""
    return {"value": iso_utc_ms(t_utc_ns), "format": "RFC3339"}


def _json(value: object) -> bytes:
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()

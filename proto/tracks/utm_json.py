"""Tracks as UTM systems take them in JSON: Flight Blender and ASTM F3411."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

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
from plotfeed.proto.tracks.told_tracks import Told, ToldTracks, TrackOrigin, one_by_one
from plotfeed.proto.utc import iso_utc_ms

PRIMARY_RADAR = 5
"""Flight Blender's `traffic_source` of what does not answer."""
OF_ONE_SOURCE = 0
"""Its `source_type` of what is not fused."""
MOST_SPEED_M_S, MOST_CLIMB_M_S = 254.25, 62.0
"""That F3411 has numbers for."""


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
    return _json({"timestamp": _time(at_ns), "flights": flights})


def _flight(told: Told, origin: TrackOrigin) -> dict[str, Any]:
    climb_m_s, speed_m_s = told["climb_m_s"], told["speed_m_s"]
    height_m = told["height_m"]
    return {
        "id": origin.name_of(told["track"]),
        "aircraft_type": "NotDeclared",
        "simulated": True,
        "current_state": {
            "timestamp": _time(told["t_utc_ns"]),
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


def _time(t_utc_ns: int) -> dict[str, str]:
    return {"value": iso_utc_ms(t_utc_ns), "format": "RFC3339"}


def _json(value: object) -> bytes:
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()

"""Tracks as GeoJSON (RFC 7946), and as Foxglove's messages of places."""

from __future__ import annotations

import json
from typing import Any

from plotfeed.proto.tracks.told_tracks import Told, ToldTracks, TrackOrigin, one_by_one
from plotfeed.proto.utc import NS, iso_utc_ms

UNKNOWN_HEIGHT_M2 = 1e8
"""Variance of an altitude that is not measured, and stands as 0 where a number must stand."""
DIAGONAL = 2
"""Of foxglove.LocationFix: the diagonal of the covariance is known."""


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

"""JSON schemas of what sensors report in JSON, by the names that content types and MCAP have.

Those of Foxglove are as its documentation describes them; the others are what is written here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Schema = Mapping[str, Any]
NUMBER: Schema = {"type": "number"}
TEXT: Schema = {"type": "string"}
WHOLE: Schema = {"type": "integer"}
TRUTH: Schema = {"type": "boolean"}
PERHAPS: Schema = {"type": ["number", "null"]}
LATITUDE: Schema = {"type": "number", "minimum": -90, "maximum": 90}
LONGITUDE: Schema = {"type": "number", "minimum": -180, "maximum": 180}


def _object(**properties: Schema) -> dict[str, Any]:
    """An object that has all of those keys."""
    return {"type": "object", "properties": properties, "required": list(properties)}


def _list(items: Schema, **more: int) -> dict[str, Any]:
    return {"type": "array", "items": items, **more}


def _one_of(*values: object) -> Schema:
    return {"enum": list(values)}


_KIND = _one_of("smoothed-truth", "plain")
_FEATURE = _object(
    type=_one_of("Feature"),
    id=TEXT,
    geometry=_object(type=_one_of("Point"), coordinates=_list(NUMBER, minItems=2, maxItems=3)),
    properties=_object(
        name=TEXT,
        sensor=TEXT,
        track=WHOLE,
        kind=_KIND,
        time_utc=TEXT,
        speed_m_s=NUMBER,
        course_deg=NUMBER,
        climb_m_s=PERHAPS,
        sigma_level_m=NUMBER,
        sigma_up_m=PERHAPS,
        coasted=TRUTH,
        first=TRUTH,
        last=TRUTH,
    ),
)
_TIME = _object(value=TEXT, format=_one_of("RFC3339"))
_POSITION = _object(
    lat=LATITUDE,
    lng=LONGITUDE,
    alt=NUMBER,
    accuracy_h=TEXT,
    accuracy_v=TEXT,
    extrapolated=TRUTH,
)
_STATE = _object(
    timestamp=_TIME,
    timestamp_accuracy=NUMBER,
    operational_status=TEXT,
    position=_POSITION,
    track={"type": "number", "minimum": 0, "maximum": 361},
    speed={"type": "number", "minimum": 0, "maximum": 255},
    speed_accuracy=TEXT,
    vertical_speed={"type": "number", "minimum": -63, "maximum": 63},
)
_OBSERVATION = _object(
    lat_dd=LATITUDE,
    lon_dd=LONGITUDE,
    altitude_mm=NUMBER,
    icao_address={"type": "string", "maxLength": 24},
    traffic_source=WHOLE,
    source_type=WHOLE,
    timestamp=WHOLE,
    metadata=_object(
        sensor=TEXT,
        kind=_KIND,
        simulated=TRUTH,
        altitude_is_measured=TRUTH,
        speed_m_s=NUMBER,
        course_deg=NUMBER,
        coasted=TRUTH,
        last=TRUTH,
    ),
)

JSON_SCHEMAS: Mapping[str, Schema] = {
    "plotfeed.TrackFeatures": _object(type=_one_of("FeatureCollection"), features=_list(_FEATURE)),
    "plotfeed.AirTraffic": _object(observations=_list(_OBSERVATION)),
    "plotfeed.F3411Flights": _object(
        timestamp=_TIME,
        flights=_list(_object(id=TEXT, aircraft_type=TEXT, simulated=TRUTH, current_state=_STATE)),
    ),
    "foxglove.GeoJSON": _object(geojson=TEXT),
    "foxglove.LocationFix": _object(
        timestamp=_object(sec=WHOLE, nsec=WHOLE),
        frame_id=TEXT,
        latitude=LATITUDE,
        longitude=LONGITUDE,
        altitude=NUMBER,
        position_covariance=_list(NUMBER, minItems=9, maxItems=9),
        position_covariance_type=_one_of(0, 1, 2, 3),
    ),
}

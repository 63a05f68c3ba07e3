"""JSON schemas: of protobuf's messages by the names of fields, and of what sensors report in JSON.

The latter go by the names that content types and MCAP have. Those of Foxglove are as its
documentation describes them; the others are what is written here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from google.protobuf.descriptor import Descriptor, FieldDescriptor

TIMESTAMP = "google.protobuf.Timestamp"
_WHOLE_IN_TEXT = {"type": "string", "pattern": "^-?[0-9]+$"}
_NUMBERS: dict[int, dict[str, Any]] = {
    FieldDescriptor.TYPE_DOUBLE: {"type": "number"},
    FieldDescriptor.TYPE_FLOAT: {"type": "number"},
    FieldDescriptor.TYPE_INT32: {"type": "integer"},
    FieldDescriptor.TYPE_UINT32: {"type": "integer", "minimum": 0},
    FieldDescriptor.TYPE_INT64: _WHOLE_IN_TEXT,
    FieldDescriptor.TYPE_UINT64: _WHOLE_IN_TEXT,
    FieldDescriptor.TYPE_BOOL: {"type": "boolean"},
    FieldDescriptor.TYPE_STRING: {"type": "string"},
}


def json_schema(message: Descriptor, required: Sequence[str] | None = None) -> dict[str, Any]:
    """Schema of a message; without `required`, what is always written: fields without presence."""
    if required is None:
        required = [f.name for f in message.fields if f.is_repeated or not f.has_presence]
    return {
        "type": "object",
        "properties": {field.name: _field(field) for field in message.fields},
        "required": list(required),
        "additionalProperties": False,
    }


def _field(field: FieldDescriptor) -> dict[str, Any]:
    if field.message_type is not None and field.message_type.GetOptions().map_entry:
        values = _one(field.message_type.fields_by_name["value"])
        return {"type": "object", "additionalProperties": values}
    one = _one(field)
    return {"type": "array", "items": one} if field.is_repeated else one


def _one(field: FieldDescriptor) -> dict[str, Any]:
    if field.enum_type is not None:
        return {"type": "string", "enum": [value.name for value in field.enum_type.values]}
    if field.message_type is None:
        return dict(_NUMBERS[field.type])
    if field.message_type.full_name == TIMESTAMP:
        return {"type": "string", "format": "date-time"}
    return json_schema(field.message_type, [])


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
    lat=LATITUDE, lng=LONGITUDE, alt=NUMBER, accuracy_h=TEXT, accuracy_v=TEXT, extrapolated=TRUTH
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

"""JSON schemas of protobuf messages, as protobuf writes them in JSON by the names of fields."""

from __future__ import annotations

from collections.abc import Sequence
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

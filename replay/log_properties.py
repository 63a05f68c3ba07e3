"""User properties of MQTT 5 as JSON: the payload of a message beside the message that has them."""

from __future__ import annotations

import json

from plotfeed.proto.errors import DecodeError

Properties = tuple[tuple[str, str], ...]

_encoder = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"))


def properties_to_json(properties: Properties) -> bytes:
    """An object; a list of pairs if a name is there twice. Raises `UnicodeEncodeError`."""
    names = dict(properties)
    return _encoder.encode(names if len(names) == len(properties) else properties).encode()


def properties_of_json(data: bytes) -> Properties:
    """The same back; raises `DecodeError`."""
    try:
        found = json.loads(data)
    except (ValueError, RecursionError):
        raise DecodeError("user properties: expected JSON") from None
    pairs = list(found.items()) if isinstance(found, dict) else found
    if not isinstance(pairs, list):
        raise DecodeError("user properties: expected an object or a list of pairs")
    for pair in pairs:
        if not (isinstance(pair, (list, tuple)) and len(pair) == 2 and _are_texts(pair)):
            raise DecodeError("user properties: expected texts")
    return tuple((name, value) for name, value in pairs)


def _are_texts(values: list[object] | tuple[object, ...]) -> bool:
    return all(isinstance(value, str) for value in values)

"""Our own messages at another time: protobuf, protobuf's JSON, and times written as text.

Everything that is nanoseconds of UTC or a Timestamp moves by the same shift, exactly. Numbers of
scans stay what they were, and so do names in which a time is hidden.
"""

from __future__ import annotations

import json
import re
from functools import cache
from typing import Any, TypeVar

from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.message import DecodeError as ProtobufDecodeError
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

from plotfeed.proto.errors import DecodeError
from plotfeed.proto.utc import NS

TIMESTAMP = Timestamp.DESCRIPTOR.full_name
NANOSECONDS = "_utc_ns"  # How the names of our times end that are not Timestamps
WHOLE = (FieldDescriptor.TYPE_INT64, FieldDescriptor.TYPE_SFIXED64)
# The years 1 to 9999, which a Timestamp can tell.
EARLIEST_NS, LATEST_NS = -62_135_596_800 * NS, 253_402_300_800 * NS
# Members of our JSON objects that tell a time.
JSON_TIMES = ("time_utc", "timeUtc", "start_utc", "start_utc_ns")
_MEMBER = re.compile(rf'("({"|".join(JSON_TIMES)})"\s*:\s*)(?:"[^"\\]*"|-?\d+\b)')

OneMessage = TypeVar("OneMessage", bound=Message)


def retime_protobuf(data: bytes, kind: type[OneMessage], shift_ns: int) -> bytes:
    """A serialised message with all its times later by that, absent ones excepted.

    Raises `DecodeError`, also where a time would be beyond what a Timestamp can tell.
    """
    try:
        message = kind.FromString(data)
        if moves := _moves(message.DESCRIPTOR):
            _move(message, moves, shift_ns)
    except (ProtobufDecodeError, ValueError, OverflowError) as error:
        raise DecodeError(f"not a message {kind.DESCRIPTOR.name}: {error}") from None
    return message.SerializeToString()


def retime_json(data: bytes, shift_ns: int) -> bytes:
    """A JSON object with its times later by that; raises `DecodeError` if it has none.

    The other characters stay as they are, unless a time is written so oddly that the whole object
    has to be written anew.
    """
    try:
        text = data.decode()
        fields = json.loads(text)
        times = {name: fields[name] for name in JSON_TIMES if name in fields}
        if not times:
            raise DecodeError(f"a JSON object without {' or '.join(JSON_TIMES)}")
        moved = {
            name: retime_text(time, shift_ns) if isinstance(time, str) else time + shift_ns
            for name, time in times.items()
        }
        new = _MEMBER.sub(lambda found: found[1] + json.dumps(moved.get(found[2])), text)
        if json.loads(new) != {**fields, **moved}:
            new = json.dumps({**fields, **moved})
    except (ValueError, TypeError, RecursionError) as error:
        raise DecodeError(f"not a JSON object with a time: {error}") from None
    return new.encode()


def retime_text(text: str, shift_ns: int) -> str:
    """A time of RFC 3339 later by that, in UTC, with at least as many digits as it had.

    Raises `ValueError`.
    """
    time = Timestamp()
    time.FromJsonString(text)
    _move_timestamp(time, shift_ns)
    fraction = re.search(r"\.(\d+)", text)
    needed = next(n for n in (0, 3, 6, 9) if time.nanos % 10 ** (9 - n) == 0)
    digits = max(len(fraction[1]) if fraction else 0, needed)
    whole = Timestamp(seconds=time.seconds).ToJsonString().removesuffix("Z")
    return f"{whole}.{time.nanos:09d}"[: len(whole) + 1 + digits].removesuffix(".") + "Z"


# A field, whether it is repeated, and what to move within it: nothing of a number.
_Move = tuple[str, bool, "list[_Move] | None"]


@cache
def _moves(descriptor: Descriptor, above: tuple[str, ...] = ()) -> list[_Move]:
    """What to move in a message of that kind; nothing where it has no times.

    `above` names the kinds around it, which it may hold again.
    """
    moves: list[_Move] = []
    around = (*above, descriptor.full_name)
    for field in descriptor.fields:
        if field.message_type is None:
            if field.name.endswith(NANOSECONDS) and field.type in WHOLE:
                moves.append((field.name, field.is_repeated, None))
        elif field.message_type.full_name == TIMESTAMP:
            moves.append((field.name, field.is_repeated, []))
        elif field.message_type.full_name not in around:
            inner = _moves(field.message_type, around)
            if inner:
                moves.append((field.name, field.is_repeated, inner))
    return moves


def _move(message: Any, moves: list[_Move], shift_ns: int) -> None:
    if not moves:  # a Timestamp
        _move_timestamp(message, shift_ns)
    for name, is_repeated, inner in moves:
        value = getattr(message, name)
        if inner is not None:
            parts = value if is_repeated else [value] if message.HasField(name) else []
            for part in parts:
                _move(part, inner, shift_ns)
        elif is_repeated:
            value[:] = [each + shift_ns if each else 0 for each in value]
        elif value:
            setattr(message, name, value + shift_ns)


def _move_timestamp(time: Any, shift_ns: int) -> None:
    t_ns = time.seconds * NS + time.nanos + shift_ns
    if not EARLIEST_NS <= t_ns < LATEST_NS:
        raise ValueError(f"{t_ns // NS} s since 1970 is beyond what a Timestamp can tell")
    time.seconds, time.nanos = divmod(t_ns, NS)

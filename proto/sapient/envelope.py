"""The envelope of every message, the names in it, and what no SAPIENT message may hold."""

from __future__ import annotations

import math
from hashlib import blake2b
from typing import Any
from uuid import UUID

from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage

from plotfeed.models.state import Floats
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.utc import NS

MAX_UTC_NS = 2**63 - 1  # year 2262: the last that int64 holds
MAX_TEXT = 1000


def measured(field: str, values: Floats, low: float, high: float) -> list[float | None]:
    """A column within [low, high], None for NaN: what was not measured; raises `EncodeError`.

    Value by value: most columns have a few rows, and NumPy takes longer to begin than these do.
    """
    found: list[float | None] = values.tolist()
    for i, value in enumerate(values.tolist()):
        if not low <= value <= high:
            if not math.isnan(value):
                check_number(field, value, low, high)
            found[i] = None
    return found


def check_number(field: str, value: float, low: float, high: float) -> None:
    """Check that a number is finite and within [low, high]; raises `EncodeError`."""
    if not (low <= value <= high and math.isfinite(value)):
        raise EncodeError(f"{value:g} is not a number from {low:g} to {high:g}", field=field)


def check_text(field: str, value: str) -> None:
    """Check that a text is neither empty nor endless; raises `EncodeError`."""
    if not 0 < len(value) <= MAX_TEXT:
        raise EncodeError(f"expected 1 to {MAX_TEXT} characters, not {len(value)}", field=field)


_BASE32 = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"  # Crockford's: neither I, L, O nor U
_PAIRS = [high + low for high in _BASE32 for low in _BASE32]
_COUNTER_BITS = 30
MAX_IDS = 1 << _COUNTER_BITS  # How many names there are of one purpose at one time


def node_id(seed: int, sensor: str) -> str:
    """The UUID of a scene's sensor, version 4 in form, lower case as middlewares ask for it."""
    return str(UUID(bytes=_digest(seed, sensor, "node", 16), version=4))


class Ulids:
    """The ULIDs that a sensor gives at one time, each greater than the last.

    48 bits of milliseconds, 50 of a digest of all that they are for, and a counter of 30.
    """

    def __init__(self, seed: int, sensor: str, purpose: str, t_utc_ns: int) -> None:
        digest = _digest(seed, sensor, f"{purpose} {t_utc_ns}", 8)
        self._prefix = _base32(t_utc_ns // 1_000_000, 10) + _base32(
            int.from_bytes(digest, "big") >> 14, 10
        )

    def __getitem__(self, n: int) -> str:
        """The n-th, from 0."""
        if not 0 <= n < MAX_IDS:
            raise IndexError(n)
        return f"{self._prefix}{_PAIRS[n >> 20]}{_PAIRS[n >> 10 & 1023]}{_PAIRS[n & 1023]}"


def _digest(seed: int, sensor: str, purpose: str, octets: int) -> bytes:
    text = f"{purpose}\0{sensor}".encode()
    return blake2b(text, digest_size=octets, key=seed.to_bytes(8, "big")).digest()


def _base32(value: int, digits: int) -> str:
    return "".join(_BASE32[value >> 5 * i & 31] for i in reversed(range(digits)))


ICD_VERSION = "BSI Flex 335 v2.0"
STAMP_NS = 1000  # Timestamps are whole microseconds: what a datetime holds, and no more


def stamp_ns(t_utc_ns: int) -> int:
    """The timestamp of a message sent then: never ahead of it."""
    return t_utc_ns // STAMP_NS * STAMP_NS


def envelope(node_id: str, t_utc_ns: int, **content: Any) -> SapientMessage:
    """A message with that content by the standard's names, if any; raises `EncodeError`."""
    message = SapientMessage(node_id=node_id, **content)
    set_stamp(message, t_utc_ns)
    return message


def serialised(node_id: str, t_utc_ns: int, **content: Any) -> bytes:
    """The octets of a message with that content; raises `EncodeError`."""
    return envelope(node_id, t_utc_ns, **content).SerializeToString()


def set_stamp(message: SapientMessage, t_utc_ns: int) -> None:
    """Write when it is sent; raises `EncodeError`."""
    if not 0 <= t_utc_ns <= MAX_UTC_NS:
        raise EncodeError(f"{t_utc_ns} ns is not from 1970 to 2262", field="timestamp")
    message.timestamp.seconds, ns = divmod(stamp_ns(t_utc_ns), NS)
    message.timestamp.nanos = ns

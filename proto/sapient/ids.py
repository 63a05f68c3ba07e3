"""Names of nodes and reports. The same scene at the same time gives the same names."""

from __future__ import annotations

from hashlib import blake2b
from uuid import UUID

_BASE32 = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"
"""Crockford's: neither I, L, O nor U."""
_PAIRS = [high + low for high in _BASE32 for low in _BASE32]
_COUNTER_BITS = 30
MAX_IDS = 1 << _COUNTER_BITS
"""Of one purpose at one time."""


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

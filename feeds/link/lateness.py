"""Lateness of the last messages, in a room that does not grow."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from plotfeed.models.state import Ints

LATENESS_KEPT = 100_000
_FIRST_ROOM = 64
_FEW = 16  # Values of which arrays of NumPy would take longer than one after the other


class LastLateness:
    """How late messages left, nanoseconds: of the last `most` of them, 8 octets each, in order."""

    def __init__(self, most: int = LATENESS_KEPT) -> None:
        self._most = most
        self._values = array("q", bytes(8 * min(_FIRST_ROOM, most)))
        self._count = 0  # Of all since the beginning, of which the last are kept

    def __len__(self) -> int:
        return min(self._count, self._most)

    def __iter__(self) -> Iterator[int]:
        return iter(self.values().tolist())

    def append(self, lateness_ns: int) -> None:
        """Keep another; the oldest gives way where there is no more room."""
        if self._count >= len(self._values):
            self._make_room(self._count + 1)
        self._values[self._count % self._most] = lateness_ns
        self._count += 1

    def extend(self, lateness_ns: Iterable[int]) -> None:
        """Keep others, in that order; a column of integers is taken as it is."""
        if isinstance(lateness_ns, list) and len(lateness_ns) < _FEW:
            self._make_room(self._count + len(lateness_ns))
            kept, most = self._values, self._most
            for number, each in enumerate(lateness_ns, self._count):
                kept[number % most] = each
            self._count += len(lateness_ns)
            return
        values = np.asarray(
            lateness_ns if isinstance(lateness_ns, np.ndarray) else list(lateness_ns), np.int64
        )
        self._make_room(self._count + len(values))
        at = np.arange(self._count, self._count + len(values))[-self._most :] % self._most
        np.frombuffer(self._values, np.int64)[at] = values[-self._most :]
        self._count += len(values)

    def clear(self) -> None:
        """Keep none; the room stays."""
        self._count = 0

    def values(self) -> Ints:
        """The last of them, oldest first; a copy."""
        oldest = self._count % self._most if self._count > self._most else 0
        return np.roll(self.in_any_order(), -oldest)

    def in_any_order(self) -> Ints:
        """The last of them, as they are kept: to be read at once."""
        return np.frombuffer(self._values, np.int64)[: len(self)]

    def _make_room(self, count: int) -> None:
        if count <= (room := len(self._values)):
            return
        while room < min(count, self._most):
            room = min(2 * room, self._most)
        if room > len(self._values):
            self._values = array("q", self._values.tobytes().ljust(8 * room, b"\0"))


def lateness_us(lateness_ns: LastLateness | Sequence[int], *percentiles: float) -> list[float]:
    """Percentiles of how late messages left, microseconds; zeros if none did."""
    if not lateness_ns:
        return [0.0] * len(percentiles)
    values = lateness_ns.in_any_order() if isinstance(lateness_ns, LastLateness) else lateness_ns
    ordered = np.sort(np.asarray(values))  # of integers quicker than what np.percentile does
    at = np.array(percentiles) / 100 * (len(ordered) - 1)
    below = at.astype(np.int64)
    above = np.minimum(below + 1, len(ordered) - 1)
    found = ordered[below] + (at - below) * (ordered[above] - ordered[below])
    return [float(p) / 1e3 for p in found]

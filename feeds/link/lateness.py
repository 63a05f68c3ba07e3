"""Lateness of the last messages, in a room that does not grow."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence

import numpy as np

from plotfeed.models.state import Ints

LATENESS_KEPT = 100_000


class LastLateness:
    """How late messages left, nanoseconds: of the last `most` of them, 8 octets each, in order."""

    def __init__(self, most: int = LATENESS_KEPT) -> None:
        self._most = most
        self._values = array("q")
        self._at = 0  # Where the next one goes: at the end, or once that is full, over the oldest

    def __len__(self) -> int:
        return len(self._values)

    def __iter__(self) -> Iterator[int]:
        return iter(self.values().tolist())

    def append(self, lateness_ns: int) -> None:
        """Keep another; the oldest gives way where there is no more room."""
        self.extend((lateness_ns,))

    def extend(self, lateness_ns: Sequence[int]) -> None:
        """Keep others, in that order."""
        at, count = self._at, len(lateness_ns)
        if at + count > self._most:
            first = self._most - at
            self.extend(lateness_ns[:first])
            self.extend(lateness_ns[first:])
            return
        self._values[at : at + count] = array("q", lateness_ns)
        self._at = 0 if at + count == self._most else at + count

    def clear(self) -> None:
        """Keep none."""
        del self._values[:]
        self._at = 0

    def values(self) -> Ints:
        """The last of them, oldest first; a copy."""
        return np.roll(self.in_any_order(), -self._at)

    def in_any_order(self) -> Ints:
        """The last of them, as they are kept; a copy."""
        return np.array(self._values, np.int64)


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

"""What was delivered, second by second: plots of each sensor, losses, lateness of the engine."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

HISTORY_S = 120
MAX_LATENESS = 20_000
"""Messages of a second whose lateness is taken; what comes on top is not."""


class Rates:
    """Counts of the second under way, and of those before it.

    Seconds are those of the wall clock: what a tracker has to cope with.
    """

    def __init__(self, sensors: int) -> None:
        self.history: deque[dict[str, Any]] = deque(maxlen=HISTORY_S)
        self._sensors = sensors
        self._second: int | None = None
        self._begin()

    def plots(self, sensor: int, count: int) -> None:
        """That many plots of a sensor, by number, were delivered."""
        self._plots[sensor] += count

    def sent(self, lateness_ns: int) -> None:
        """A message left so long after its link let it."""
        self._messages += 1
        if len(self._lateness_ns) < MAX_LATENESS:
            self._lateness_ns.append(lateness_ns)

    def lost(self) -> None:
        """A message did not leave."""
        self._lost += 1

    def over(self, monotonic_s: float) -> list[dict[str, Any]]:
        """The second that is over since the last call; empty ones after it are left out."""
        second = int(monotonic_s)
        if self._second is None:
            self._second = second
        if second == self._second:
            return []
        p50_us, p99_us = np.percentile(self._lateness_ns or [0], (50, 99)) / 1e3
        ended = {
            "plots": self._plots,
            "messages": self._messages,
            "lost": self._lost,
            "late_p50_us": round(float(p50_us), 1),
            "late_p99_us": round(float(p99_us), 1),
        }
        self._second = second
        self._begin()
        self.history.append(ended)
        return [ended]

    def _begin(self) -> None:
        self._plots = [0] * self._sensors
        self._messages = self._lost = 0
        self._lateness_ns: list[int] = []

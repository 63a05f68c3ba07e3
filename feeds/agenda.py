"""What is to be done when: one heap of absolute deadlines for everything that a session does."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from itertools import count

Action = Callable[[], None]


class Agenda:
    """Actions in the order of their deadlines; those due together in the order they were put."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, Action]] = []
        self._order = count()

    def put(self, due_utc_ns: int, action: Action) -> None:
        """Do this then."""
        heapq.heappush(self._heap, (due_utc_ns, next(self._order), action))

    def next_due_ns(self) -> int | None:
        """The next deadline; None if there is nothing to do."""
        return self._heap[0][0] if self._heap else None

    def due_by(self, t_utc_ns: int) -> Iterator[Action]:
        """Take out what is due by then, including what is put there meanwhile."""
        while self._heap and self._heap[0][0] <= t_utc_ns:
            yield heapq.heappop(self._heap)[2]

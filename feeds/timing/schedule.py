"""What is to be done when: one heap of absolute deadlines for everything that a session does."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from enum import IntEnum
from itertools import count

Action = Callable[[], None]


class ActionKind(IntEnum):
    """What becomes of an action when the session ends before it is due."""

    BETWEEN = -1  # It is not done any more. It comes after all else that is due then.
    WORK = 0  # It is not done any more
    SENDING = 1  # What was worked out is still sent, unless the session ends at a set time
    DELIVERY = 2  # What was handed to a link is still delivered


# Of actions that are due together: who planned first is not to matter where plans differ.
ORDER = (ActionKind.WORK, ActionKind.DELIVERY, ActionKind.SENDING, ActionKind.BETWEEN)


class Schedule:
    """Actions in the order of their deadlines; of those due together, of their kinds.

    Of one kind they are done in the order they were put. `on_earlier` is called when something
    becomes the next to be done.
    """

    def __init__(self, on_earlier: Callable[[], object] | None = None) -> None:
        self._heap: list[tuple[int, int, int, Action, ActionKind]] = []
        self._order = count()
        self._on_earlier = on_earlier

    def __len__(self) -> int:
        return len(self._heap)

    def put(self, due_utc_ns: int, action: Action, kind: ActionKind = ActionKind.WORK) -> None:
        """Do this then."""
        entry = (due_utc_ns, ORDER.index(kind), next(self._order), action, kind)
        heapq.heappush(self._heap, entry)
        if self._on_earlier is not None and self._heap[0] is entry:
            self._on_earlier()

    def next_due_ns(self) -> int | None:
        """The next deadline; None if there is nothing to do."""
        return self._heap[0][0] if self._heap else None

    def next_kind(self) -> ActionKind:
        """Kind of the next action; there must be one."""
        return self._heap[0][4]

    def take(self) -> Action:
        """Take out the next action; there must be one."""
        return heapq.heappop(self._heap)[3]

    def due_by(self, t_utc_ns: int) -> Iterator[tuple[int, Action]]:
        """Take out what is due by then, and when it was, including what is put there meanwhile."""
        while (due_utc_ns := self.next_due_ns()) is not None and due_utc_ns <= t_utc_ns:
            yield due_utc_ns, self.take()

    def keep(self, least: ActionKind) -> None:
        """Forget what is of a lesser kind."""
        self._heap = [entry for entry in self._heap if entry[4] >= least]
        heapq.heapify(self._heap)

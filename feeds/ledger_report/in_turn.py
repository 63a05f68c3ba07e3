"""Messages put back into the order in which they were handed over."""

from __future__ import annotations

from collections.abc import Iterator
from heapq import heappop, heappush
from typing import NamedTuple

WINDOW = 4096
"""Messages that are held back at most until an earlier one is told of."""


class Turn(NamedTuple):
    """What the order of messages is needed for."""

    number: int
    due_utc_ns: int
    sent_utc_ns: int
    """0 if it did not leave."""
    fate: int
    row: int
    """Which link setting it is of."""


class InTurn:
    """Turns by their numbers, which count from 0 in each session; some may be missing."""

    def __init__(self) -> None:
        self.next = 0
        """The number after the last one that was given out."""
        self.out_of_turn = 0
        """Told of so late that they had to be left out."""
        self._held: list[Turn] = []
        self._last_due_utc_ns = 0

    def add(self, turn: Turn) -> Iterator[Turn]:
        """Take one, and give those whose turn it is."""
        if turn.number < self.next:
            if turn.due_utc_ns <= self._last_due_utc_ns:
                self.out_of_turn += 1
                return
            yield from self.rest()
            self.next = 0  # another session: numbers and due times rise together
        if turn.number == self.next and not self._held:
            yield self._given(turn)
            return
        heappush(self._held, turn)
        while self._held and (self._held[0].number <= self.next or len(self._held) > WINDOW):
            yield self._given(heappop(self._held))

    def rest(self) -> Iterator[Turn]:
        """All that are held back, since no more will come before them."""
        while self._held:
            yield self._given(heappop(self._held))

    def _given(self, turn: Turn) -> Turn:
        self.next = turn.number + 1
        self._last_due_utc_ns = max(self._last_due_utc_ns, turn.due_utc_ns)
        return turn

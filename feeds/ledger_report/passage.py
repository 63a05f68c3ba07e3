"""What shows only in the order of a sensor's messages: bursts of losses, and who overtook whom."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

from plotfeed.feeds.ledger_report.in_turn import InTurn, Turn
from plotfeed.proto import plotfeed_pb2 as pb

PASSED_LOSS = frozenset({pb.SENT, pb.QUEUE_FULL, pb.UNDELIVERED, pb.ENDED, pb.STALE})
"""Fates of messages that the model of loss let through."""
LONGEST = 10_000
"""Bursts that are longer are counted with these."""


@dataclass(slots=True)
class Order:
    """Of the messages under one link setting."""

    bursts: Counter[int] = field(default_factory=Counter)
    """How many bursts of losses were so long."""
    cut_bursts: int = 0
    """Of which it is not known where they began or ended."""
    left: int = 0
    """Messages that left, first copies."""
    overtook: int = 0
    """Of those, the ones that left before one that had been handed over earlier."""


class Passage:
    """Follows one sensor's messages through its link, in the order in which they were sent in."""

    def __init__(self) -> None:
        self.turns = InTurn()
        self._rows: dict[int, Order] = {}
        self._row = self._number = -1
        self._order = Order()
        self._lost = 0
        self._is_cut = True
        """Whether the current burst may have begun before what is known."""
        self._latest_ns = 0

    def order_of(self, row: int) -> Order:
        """What was found of one link setting."""
        if row not in self._rows:
            self._rows[row] = Order()
        return self._rows[row]

    def add(self, turn: Turn) -> None:
        """Take a message, in the order in which the ledger tells of them."""
        self._follow(self.turns.add(turn))

    def end(self) -> None:
        """There are no more."""
        self._follow(self.turns.rest())
        self._break()

    def _follow(self, turns: Iterable[Turn]) -> None:
        for turn in turns:
            if turn.number != self._number + 1 or turn.row != self._row:
                self._break()
                self._order = self.order_of(turn.row)
                if turn.number <= self._number:
                    self._latest_ns = 0
            self._number, self._row = turn.number, turn.row
            self._take_loss(turn.fate)
            if turn.fate == pb.SENT:
                self._take_time(turn.sent_utc_ns)

    def _take_loss(self, fate: int) -> None:
        if fate == pb.LOST:
            self._lost += 1
        elif fate in PASSED_LOSS:
            if self._lost and not self._is_cut:
                self._order.bursts[min(self._lost, LONGEST)] += 1
                self._lost = 0
            elif self._lost:
                self._break()
            self._is_cut = False
        else:
            self._break()

    def _take_time(self, sent_utc_ns: int) -> None:
        order = self._order
        order.left += 1
        order.overtook += sent_utc_ns < self._latest_ns
        self._latest_ns = max(self._latest_ns, sent_utc_ns)

    def _break(self) -> None:
        """What comes next is not known to follow what came."""
        if self._lost:
            self._order.cut_bursts += 1
        self._lost, self._is_cut = 0, True

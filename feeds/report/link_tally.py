"""What became of a sensor's messages under one link setting."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np
from pydantic import ValidationError

from plotfeed.feeds.impairment.link import LinkExpectation
from plotfeed.feeds.report.spreads import LawFit, Spread
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.problems import problems_of
from plotfeed.models.state import Ints
from plotfeed.proto import plotfeed_pb2 as pb

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
        """Turns that are held back, since no more will come before them."""
        while self._held:
            yield self._given(heappop(self._held))

    def _given(self, turn: Turn) -> Turn:
        self.next = turn.number + 1
        self._last_due_utc_ns = max(self._last_due_utc_ns, turn.due_utc_ns)
        return turn


PASSED_LOSS = frozenset({pb.SENT, pb.QUEUE_FULL, pb.UNDELIVERED, pb.ENDED, pb.STALE})
"""Fates of messages that the model of loss let through."""
LONGEST = 10_000
"""Bursts that are longer are counted with these."""


@dataclass(slots=True)
class Order:
    """The order of messages under one link setting: bursts and overtaking."""

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
                if turn.number <= self._number or turn.row != self._row:
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


AT_ONCE = 4096
"""Messages that are counted together."""
LET_THROUGH = frozenset({pb.SENT, pb.UNDELIVERED, pb.ENDED, pb.STALE})
"""Fates of messages whose link had said when they were to leave."""


@dataclass(frozen=True, slots=True)
class Setting:
    """A link as the ledger has it."""

    text: str
    """JSON of its keys, empty for none."""
    asked: LinkExpectation | None
    """None if it is not a link as we know them."""
    problem: str = ""
    """Why not."""

    @classmethod
    def of(cls, text: str) -> Setting:
        """Whatever it may be."""
        if not text:
            return cls(text, LinkExpectation(LinkSettings()))
        try:
            tree = json.loads(text)
        except (ValueError, RecursionError):
            return cls(text, None, "expected JSON")
        if not isinstance(tree, dict):
            return cls(text, None, "expected an object")
        try:
            return cls(text, LinkExpectation(LinkSettings.model_validate_json(text)))
        except ValidationError as error:
            key, what = next(problems_of(error, tree))
            return cls(text, None, f"{key}: {what}" if key else what)


@dataclass(slots=True)
class LinkTally:
    """Counts of one sensor and one setting. Delays are of first copies, lateness is of all."""

    setting: Setting
    first_due_utc_ns: int | None = None
    last_due_utc_ns: int | None = None
    fates: Counter[int] = field(default_factory=Counter)
    """Of first copies."""
    duplicates: int = 0
    let_through: int = 0
    """Copies that the link let through, first ones and duplicates."""
    corrupted: int = 0
    delay: Spread = field(default_factory=Spread)
    """Sending less being handed over."""
    lateness: Spread = field(default_factory=Spread)
    """Sending less when the link was to let it leave."""
    sent_fit: LawFit | None = None
    """Of the delays as delivered."""
    link_fit: LawFit | None = None
    """Of the delays as the link drew them, without the engine's lateness."""
    other_delays: int = 0
    """Messages whose link drew another delay than the only one that is asked."""
    _only_ns: int | None = None
    _delays_ns: list[int] = field(default_factory=list)
    _drawn_ns: list[int] = field(default_factory=list)
    _late_ns: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        asked = self.setting.asked
        if asked is not None and not why_not_plain(asked):
            self.sent_fit, self.link_fit = LawFit(asked.delay), LawFit(asked.delay)
        elif asked is not None and why_not_plain(asked) == ALL_THE_SAME:
            self._only_ns = round(asked.delay.mean_ms() * 1e6)

    def add(self, sent: pb.Sent, fate: int) -> None:
        """Take what became of a copy."""
        due_ns, link_due_ns = sent.due_utc_ns, sent.link_due_utc_ns
        first = sent.copy == 0
        if first:
            self.fates[fate] += 1
            self._take_due(due_ns)
        else:
            self.duplicates += 1
        if fate not in LET_THROUGH:
            return
        self.let_through += 1
        self.corrupted += sent.HasField("flipped_bit")
        if first:
            self._drawn_ns.append(link_due_ns - due_ns)
        if fate == pb.SENT:
            sent_ns = sent.sent_utc_ns
            self._late_ns.append(sent_ns - link_due_ns)
            if first:
                self._delays_ns.append(sent_ns - due_ns)
        if len(self._late_ns) >= AT_ONCE or len(self._drawn_ns) >= AT_ONCE:
            self.count()

    def count(self) -> None:
        """Count what has been gathered."""
        delays_ns, late_ns = _array(self._delays_ns), _array(self._late_ns)
        self.delay.add(delays_ns)
        self.lateness.add(late_ns)
        if self._only_ns is not None:
            drawn_ns = _array(self._drawn_ns)
            self.other_delays += int((np.abs(drawn_ns - self._only_ns) > 1).sum())
        if self.sent_fit is not None and self.link_fit is not None:
            self.sent_fit.add(delays_ns)
            self.link_fit.add(_array(self._drawn_ns))
        for gathered in (self._delays_ns, self._late_ns, self._drawn_ns):
            gathered.clear()

    def _take_due(self, due_ns: int) -> None:
        if self.first_due_utc_ns is None or self.last_due_utc_ns is None:
            self.first_due_utc_ns = self.last_due_utc_ns = due_ns
        elif due_ns > self.last_due_utc_ns:
            self.last_due_utc_ns = due_ns
        elif due_ns < self.first_due_utc_ns:
            self.first_due_utc_ns = due_ns

    @property
    def messages(self) -> int:
        """First copies, whatever became of them."""
        return self.fates.total()


ALL_THE_SAME = "all the same"


def why_not_plain(asked: LinkExpectation) -> str:
    """Why delays do not follow the law that a link asks for, if it has a spread; else empty."""
    link, (least_ms, most_ms) = asked.link, asked.delay.quantile_ms([0.0, 1.0])
    reasons = {
        "down": link.down,
        "stalls": link.on_loss == "stall",
        "kept in order": link.in_order,
        "rate limited": link.rate_kbit_s is not None,
        "reordered on purpose": link.reorder is not None,
        ALL_THE_SAME: not most_ms > least_ms,
    }
    return ", ".join(reason for reason, holds in reasons.items() if holds)


def _array(times_ns: list[int]) -> Ints:
    """Differences of times that a hostile file may have made too large for 64 bits."""
    try:
        return np.array(times_ns, np.int64)
    except OverflowError:
        limit = 1 << 62
        return np.array([max(-limit, min(limit, t)) for t in times_ns], np.int64)

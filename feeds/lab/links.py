"""What a link asked of a sensor's messages, and what it delivered."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from plotfeed.feeds.impairment.link import LinkExpectation
from plotfeed.feeds.impairment.losses import LossChain
from plotfeed.feeds.lab.laws import ENOUGH, LawFit, Spread, p_of_distance, z_score
from plotfeed.feeds.lab.ledger_columns import ToldMessages
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.problems import problems_of
from plotfeed.models.state import Floats, Ints
from plotfeed.models.tail_chances import Cumulants, p_of_binomial, p_of_lengths, p_of_whole
from plotfeed.proto import plotfeed_pb2 as pb

STEP = 1e-3


def p_of_losses(chain: LossChain, of: int, count: int) -> float:
    """Probability of so many losses among messages that a chain decided on in turn."""
    step, emissions = chain.steps, np.array(chain.emissions)

    def log_moment(t: float) -> float:
        tilt = 1 - emissions + emissions * math.exp(t)
        first, matrix, log, scale = chain.stationary * tilt, step * tilt, 0.0, 0.0
        vector, left = first, of - 1
        while left:
            if left & 1:
                vector = vector @ matrix
                size = float(vector.sum())
                vector, log = vector / size, log + math.log(size) + scale
            matrix = matrix @ matrix
            size = float(matrix.max())
            matrix, scale = matrix / size, 2 * scale + math.log(size)
            left >>= 1
        return log + math.log(float(vector.sum()))

    return p_of_whole(count, _by_differences(log_moment), of)


def _by_differences(log_moment: Callable[[float], float]) -> Callable[[float], Cumulants]:
    def cumulants(t: float) -> Cumulants:
        below, here, above = log_moment(t - STEP), log_moment(t), log_moment(t + STEP)
        return Cumulants(here, (above - below) / (2 * STEP), (above - 2 * here + below) / STEP**2)

    return cumulants


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

    def __post_init__(self) -> None:
        asked = self.setting.asked
        if asked is not None and not why_not_plain(asked):
            self.sent_fit, self.link_fit = LawFit(asked.delay), LawFit(asked.delay)
        elif asked is not None and why_not_plain(asked) == ALL_THE_SAME:
            self._only_ns = round(asked.delay.mean_ms() * 1e6)

    def add(self, sent: ToldMessages, fate: Ints) -> None:
        """Take what became of copies, (n,)."""
        is_first, passed = sent.copy == 0, np.isin(fate, [*LET_THROUGH])
        self.fates.update(fate[is_first].tolist())
        self.duplicates += int((~is_first).sum())
        self.let_through += int(passed.sum())
        self.corrupted += int((passed & (sent.flipped_bit >= 0)).sum())
        dues_ns = sent.due_utc_ns[is_first].tolist()
        if dues_ns:
            first_ns, last_ns = self.first_due_utc_ns, self.last_due_utc_ns
            self.first_due_utc_ns = min(dues_ns if first_ns is None else (first_ns, *dues_ns))
            self.last_due_utc_ns = max(dues_ns if last_ns is None else (last_ns, *dues_ns))
        drawn, left = sent.rows(passed & is_first), sent.rows(fate == pb.SENT)
        drawn_ns = _apart_ns(drawn.link_due_utc_ns, drawn.due_utc_ns)
        delays_ns = _apart_ns(left.sent_utc_ns, left.due_utc_ns)[left.copy == 0]
        self.delay.add(delays_ns)
        self.lateness.add(_apart_ns(left.sent_utc_ns, left.link_due_utc_ns))
        if self._only_ns is not None:
            self.other_delays += int((np.abs(drawn_ns - self._only_ns) > 1).sum())
        if self.sent_fit is not None and self.link_fit is not None:
            self.sent_fit.add(delays_ns)
            self.link_fit.add(drawn_ns)

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


def _apart_ns(later_ns: Ints, earlier_ns: Ints) -> Ints:
    """Differences of times that a hostile file may have made too large for 64 bits."""
    limit, apart_ns = 1 << 62, later_ns.astype(np.float64) - earlier_ns
    is_far = np.abs(apart_ns) > limit
    return np.where(is_far, np.where(apart_ns > 0, limit, -limit), later_ns - earlier_ns)


LONGEST_TOLD = 100
"""Bursts up to which the probability of so many losses or more is told."""
LONGEST_SUMMED = 4096
FEWEST_BURSTS = 10
"""From which on their mean is taken to be normal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bursts:
    """Messages lost in a row."""

    bursts: int
    """That are whole; the others are `cut`, by an end, an outage or another setting."""
    cut: int
    asked_mean: float
    delivered_mean: float
    z: float
    p: float
    """Probability of such a mean, or one further off, by chance."""
    asked_survival: Sequence[float]
    """Probability of 1, 2, ... or more."""
    delivered_survival: Sequence[float]
    lengths: Mapping[str, int]
    """How many were so long."""


def burst_figures(asked: LinkExpectation | None, order: Order) -> Bursts:
    """Bursts of losses that a link asks for, and those that were found in order."""
    lengths = order.bursts
    count, total = lengths.total(), sum(n * times for n, times in lengths.items())
    told = min(max(10, *lengths, 0), LONGEST_TOLD)
    loses = asked is not None and asked.link.on_loss == "drop"
    survival = (
        asked.loss.burst_survival(LONGEST_SUMMED) if asked and loses else np.array([math.nan])
    )
    return Bursts(
        bursts=count,
        cut=order.cut_bursts,
        asked_mean=asked.loss.mean_burst if asked and loses else math.nan,
        delivered_mean=total / count if count else math.nan,
        z=_burst_z(total, count, survival),
        p=_burst_p(total, count, survival),
        asked_survival=survival[:told].tolist(),
        delivered_survival=[
            sum(times for n, times in lengths.items() if n >= least) / count if count else math.nan
            for least in range(1, told + 1)
        ],
        lengths={str(n): times for n, times in sorted(lengths.items())},
    )


def _burst_z(total: int, count: int, survival: Floats) -> float:
    """A z-score by the mean of lengths, sum S(n), and of their squares, sum (2n - 1) S(n)."""
    if count < FEWEST_BURSTS or not survival[-1] < 1e-9:
        return math.nan
    mean = survival.sum()
    variance = ((2 * np.arange(1, len(survival) + 1) - 1) * survival).sum() - mean**2
    if not variance > 1e-9:
        return math.nan
    return float((total - count * mean) / math.sqrt(count * variance))


def _burst_p(total: int, count: int, survival: Floats) -> float:
    if count < FEWEST_BURSTS or not survival[-1] < 1e-9:
        return math.nan
    return p_of_lengths(survival, count, total)


CURVE = np.concatenate([[0.0, 0.001, 0.002, 0.005], np.arange(1, 100) / 100, [0.995, 0.998, 0.999]])
"""Probabilities at which whole distributions are told, and 1."""
OTHER_FATES = {
    "queue_full": pb.QUEUE_FULL,
    "outage": pb.OUTAGE,
    "stale": pb.STALE,
    "undelivered": pb.UNDELIVERED,
    "ended": pb.ENDED,
    "unknown": pb.FATE_UNSPECIFIED,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyFigures:
    """A distribution of times in milliseconds."""

    mean_ms: float
    p50_ms: float
    p90_ms: float
    p99_ms: float
    max_ms: float
    curve_ms: Sequence[float]
    """At the probabilities of the report's `curve`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """Delivered delays against the law that was asked; Kolmogorov and Smirnov."""

    distance: float = math.nan
    """Of what was delivered, engine and all."""
    p_value: float = math.nan
    link_distance: float = math.nan
    """Of the delays that the link drew, without the engine's lateness."""
    link_p_value: float = math.nan
    independent: float = math.nan
    """Messages that tell as much as these did, where successive delays are correlated."""
    other: int = 0
    """Messages with another delay than the one that is asked of all of them."""
    not_comparable: str = ""
    """Why there is nothing to compare with; empty if there is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """A share of messages, asked and delivered."""

    count: int
    of: int
    asked: float
    delivered: float
    z: float
    """Of the delivered share, in standard deviations from the asked one."""
    p: float
    """Probability of such a share, or one further off, by chance; NaN if nothing is asked."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkFigures:
    """A sensor's messages under one link setting, in figures."""

    sensor: str
    number: int
    """Of the setting, among this sensor's, from 1 as they came into force."""
    link: object
    """The keys that were in force."""
    link_problem: str
    """Why nothing is known of what the link asked; empty if it is."""
    first_utc_ns: int
    """When the first message was handed over."""
    last_utc_ns: int
    messages: int
    sent: int
    asked: LatencyFigures | None
    delivered: LatencyFigures
    fit: Fit
    lateness: LatencyFigures
    """Of the engine: sending less when the link was to let the message leave."""
    loss: Share
    bursts: Bursts
    duplicates: Share
    corrupted: Share
    overtook: Share
    """Messages that left before one that had been handed over earlier."""
    other_fates: Mapping[str, int]


def link_figures(sensor: str, number: int, tally: LinkTally, order: Order) -> LinkFigures:
    """Figures of what was counted to the end."""
    asked = tally.setting.asked
    return LinkFigures(
        sensor=sensor,
        number=number,
        link=_keys(tally.setting),
        link_problem=tally.setting.problem,
        first_utc_ns=tally.first_due_utc_ns or 0,
        last_utc_ns=tally.last_due_utc_ns or 0,
        messages=tally.messages,
        sent=tally.fates[pb.SENT],
        asked=None if asked is None or asked.link.down else _asked_times(asked),
        delivered=_found_times(tally.delay),
        fit=_fit(tally),
        lateness=_found_times(tally.lateness),
        loss=_loss(tally),
        bursts=burst_figures(asked, order),
        duplicates=_duplicates(tally),
        corrupted=_corrupted(tally),
        overtook=_overtaking(asked, order),
        other_fates={name: tally.fates[fate] for name, fate in OTHER_FATES.items()},
    )


def _keys(setting: Setting) -> Any:
    if not setting.text:
        return {}
    return setting.text if setting.asked is None else json.loads(setting.text)


def _times(
    mean_ms: float, max_ms: float, quantiles_ms: Callable[[Floats], Floats]
) -> LatencyFigures:
    p50_ms, p90_ms, p99_ms = quantiles_ms(np.array([0.5, 0.9, 0.99])).tolist()
    return LatencyFigures(
        mean_ms=mean_ms,
        p50_ms=p50_ms,
        p90_ms=p90_ms,
        p99_ms=p99_ms,
        max_ms=max_ms,
        curve_ms=quantiles_ms(np.append(CURVE, 1.0)).tolist(),
    )


def _found_times(spread: Spread) -> LatencyFigures:
    return _times(spread.mean_ms, spread.max_ms, spread.quantiles_ms)


def _asked_times(asked: LinkExpectation) -> LatencyFigures:
    max_ms = float(asked.delay.quantile_ms([1.0])[0])
    return _times(asked.delay.mean_ms(), max_ms, asked.delay.quantile_ms)


def _fit(tally: LinkTally) -> Fit:
    asked = tally.setting.asked
    if asked is None:
        return Fit(not_comparable="not known")
    why_not = why_not_plain(asked)
    if why_not or tally.sent_fit is None or tally.link_fit is None:
        return Fit(not_comparable=why_not, other=tally.other_delays)
    # The sum of an autoregression's correlations rho^k bounds how much its distribution function
    # varies more than that of independent draws.
    rho = abs(asked.link.delay_correlation)
    share = (1 - rho) / (1 + rho)

    def compared(fit: LawFit) -> tuple[float, float]:
        distance = fit.distance()
        return distance, p_of_distance(distance, fit.count * share)

    distance, p_value = compared(tally.sent_fit)
    link_distance, link_p_value = compared(tally.link_fit)
    return Fit(
        distance=distance,
        p_value=p_value,
        link_distance=link_distance,
        link_p_value=link_p_value,
        independent=tally.sent_fit.count * share,
    )


def _share(count: int, of: int, asked: float, z: float = math.nan, p: float = math.nan) -> Share:
    delivered = count / of if of else math.nan
    return Share(count=count, of=of, asked=asked, delivered=delivered, z=z, p=p)


def _binomial(count: int, of: int, asked: float) -> Share:
    z = z_score(count - of * asked, of * asked * (1 - asked))
    return _share(count, of, asked, z, p_of_binomial(count, of, asked) if of else math.nan)


def _loss(tally: LinkTally) -> Share:
    """Loss among messages on which the model of loss decided: outages hide what it would have."""
    asked, lost = tally.setting.asked, tally.fates[pb.LOST]
    of = lost + sum(tally.fates[fate] for fate in PASSED_LOSS)
    if asked is None:
        return _share(lost, of, math.nan)
    mean = 0.0 if asked.link.on_loss == "stall" else asked.loss.mean_loss
    if not of:
        return _share(lost, of, mean)
    if not 0 < mean < 1:
        return _share(lost, of, mean, p=p_of_binomial(lost, of, mean))
    p, z = p_of_losses(asked.loss, of, lost), math.nan
    if of * mean / asked.loss.mean_burst >= ENOUGH:
        variance = (of * asked.loss.spread_of_loss(of)) ** 2
        z = z_score(lost - of * mean, variance)
    return _share(lost, of, mean, z, p)


def _duplicates(tally: LinkTally) -> Share:
    asked = tally.setting.asked
    of = tally.let_through - tally.duplicates
    if asked is None:
        return _share(tally.duplicates, of, math.nan)
    if asked.link.rate_kbit_s is not None:  # a full queue takes some
        return _share(tally.duplicates, of, asked.link.duplicate)
    return _binomial(tally.duplicates, of, asked.link.duplicate)


def _corrupted(tally: LinkTally) -> Share:
    asked = tally.setting.asked
    if asked is None:
        return _share(tally.corrupted, tally.let_through, math.nan)
    return _binomial(tally.corrupted, tally.let_through, asked.link.corrupt)


def _asked_overtaking(asked: LinkExpectation | None) -> float:
    """Overtaking asked: 0 where order is kept, else NaN, as it depends on how messages come."""
    if asked is None:
        return math.nan
    link = asked.link
    least_ms, most_ms = asked.delay.quantile_ms([0.0, 1.0])
    kept = link.keeps_order or (least_ms == most_ms and link.reorder is None)
    return 0.0 if kept else math.nan


def _overtaking(asked: LinkExpectation | None, order: Order) -> Share:
    share, mean = _asked_overtaking(asked), math.nan
    if share == 0.0 and order.left:
        mean = 0.0 if order.overtook else 1.0
    return _share(order.overtook, order.left, share, p=mean)


MAX_DELAYS_SHOWN = 5


def link_text(link: object) -> str:
    """A link's keys in a line, as the scene has them."""
    if not isinstance(link, Mapping):
        return str(link)[:200]
    return ", ".join(f"{key} = {_value(value)}" for key, value in link.items()) or "none"


def _value(value: object) -> str:
    if isinstance(value, list) and len(value) > MAX_DELAYS_SHOWN:
        return f"[{len(value)} of them]"
    if isinstance(value, Mapping):
        return f"{{ {link_text(value)} }}"
    return json.dumps(value)

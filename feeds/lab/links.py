"""What a link asked of a sensor's messages, and what it delivered."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from pydantic import ValidationError

from plotfeed.feeds.link.impairment import LinkExpectation
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.problems import problems_of
from plotfeed.models.residuals import Check
from plotfeed.models.state import Floats, Ints
from plotfeed.models.tail_chances import p_of_binomial, p_of_distance, p_of_lengths
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import ToldMessages

# Variance of a count above which it is taken to be normal; below it, there is no z-score.
ENOUGH = 5.0


def z_score(excess: float, variance: float) -> float:
    """A count's excess in standard deviations; NaN if too few were counted for a normal law."""
    return excess / math.sqrt(variance) if variance >= ENOUGH else math.nan


# Fates of messages that the model of loss let through.
PASSED_LOSS = frozenset({pb.SENT, pb.QUEUE_FULL, pb.UNDELIVERED, pb.ENDED, pb.STALE})


@dataclass(slots=True)
class Order:
    """The order of messages under one link setting: bursts and overtaking."""

    bursts: Counter[int] = field(default_factory=Counter)  # How many bursts of losses were so long
    cut_bursts: int = 0  # Of which it is not known where they began or ended
    left: int = 0  # Messages that left, first copies
    overtook: int = 0  # Of those, the ones that left before one that had been handed over earlier


def orders_of(sent: ToldMessages, links: int) -> list[Order]:
    """The order under each of so many link settings, whose numbers stand in place of entries'.

    Of first copies, in whatever order they are told: numbers and due times rise together, and in
    another session numbers begin at 0 again.
    """
    by_time = sent.rows(np.lexsort((sent.number, sent.due_utc_ns)))
    row, number, fate = by_time.entry, by_time.number, by_time.fate
    lost, n = fate == pb.LOST, len(row)
    is_other = ~lost & ~np.isin(fate, [*PASSED_LOSS])
    after_other = np.append(False, is_other[:-1]) if n else is_other
    is_new_row = np.diff(row, prepend=-1) != 0
    # What follows a gap, an outage or another setting is not known to follow what came before.
    is_cut = (np.diff(number, prepend=-2) != 1) | is_new_row | is_other | after_other
    first = np.flatnonzero(is_cut | np.append(True, lost[1:] != lost[:-1])[:n])
    end = np.append(first[1:], n)[: len(first)]
    is_whole = ~is_cut[first] & ~np.append(is_cut, True)[end]
    found = [Order() for _ in range(links)]
    for at, length, whole in zip(first, end - first, is_whole, strict=True):
        if lost[at] and whole:
            found[row[at]].bursts[int(length)] += 1
        elif lost[at]:
            found[row[at]].cut_bursts += 1
    goes_on = np.flatnonzero((np.diff(number, prepend=-1) <= 0) | is_new_row)
    for part in np.split(np.arange(n), goes_on[goes_on > 0]):
        left_ns = by_time.sent_utc_ns[part][fate[part] == pb.SENT]
        if len(left_ns):
            latest_ns = np.maximum.accumulate(left_ns)
            found[row[part[0]]].left += len(left_ns)
            found[row[part[0]]].overtook += int((left_ns[1:] < latest_ns[:-1]).sum())
    return found


# At which delays are compared with the oracle's, and by what share they may differ, by arithmetic.
SHARES, ALIKE = np.arange(1, 100) / 100, 1e-6
# Fates of messages whose link had said when they were to leave.
LET_THROUGH = frozenset({pb.SENT, pb.UNDELIVERED, pb.ENDED, pb.STALE})


class Setting:
    """A link as the ledger has it: JSON of its keys, whatever that may be, empty for none."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.asked: LinkExpectation | None = None  # None if it is not a link as we know them
        self.problem = ""  # Why not
        try:
            tree = json.loads(text or "{}")
            if isinstance(tree, dict):
                self.asked = LinkExpectation(LinkSettings.model_validate_json(text or "{}"))
            else:
                self.problem = "expected an object"
        except ValidationError as error:
            key, what = next(problems_of(error, tree))
            self.problem = f"{key}: {what}" if key else what
        except (ValueError, RecursionError):
            self.problem = "expected JSON"

    @cached_property
    def differs(self) -> set[str]:
        """Checks that are wrong whatever came: the laws of its links are not those asked."""
        if self.asked is None:
            return set()
        from plotfeed.feeds.lab import oracle  # which takes a while to load

        link, loss = self.asked.link, self.asked.loss
        told_ms, asked_ms = self.asked.delay.quantile_ms(SHARES), oracle.delays_ms(link, SHARES)
        told, asked = (loss.mean_loss, loss.mean_burst), oracle.losses(link.loss)
        alike = np.isclose(told, asked, ALIKE, equal_nan=True).tolist()
        names = {"loss": alike[0], "bursts of losses": alike[1]}
        names["delay"] = np.allclose(told_ms, asked_ms, ALIKE, 1e-6)
        return {name for name, is_alike in names.items() if not is_alike}


def _apart_ns(later_ns: Ints, earlier_ns: Ints) -> Ints:
    """Differences of times that a hostile file may have made too large for 64 bits."""
    limit, apart_ns = 1 << 62, later_ns.astype(np.float64) - earlier_ns
    is_far = np.abs(apart_ns) > limit
    return np.where(is_far, np.where(apart_ns > 0, limit, -limit), later_ns - earlier_ns)


LONGEST_TOLD = 100  # Bursts up to which the probability of so many losses or more is told
LONGEST_SUMMED = 4096
FEWEST_BURSTS = 10  # From which on their mean is taken to be normal


class Bursts:
    """Messages lost in a row: what a link asks for, and what was found in order."""

    def __init__(self, asked: LinkExpectation | None, order: Order) -> None:
        lengths = order.bursts
        count, total = lengths.total(), sum(n * times for n, times in lengths.items())
        told = min(max(10, *lengths, 0), LONGEST_TOLD)
        loses = asked is not None and asked.link.on_loss == "drop"
        survival = (
            asked.loss.burst_survival(LONGEST_SUMMED) if asked and loses else np.array([math.nan])
        )
        self.bursts = count  # That are whole; others are `cut`: by an end, an outage, a new setting
        self.cut = order.cut_bursts
        self.asked_mean = asked.loss.mean_burst if asked and loses else math.nan
        self.delivered_mean = total / count if count else math.nan
        self.z = self.p = math.nan  # Probability of such a mean, or one further off, by chance
        if count >= FEWEST_BURSTS and survival[-1] < 1e-9:
            # The mean of lengths is sum S(n), that of their squares sum (2n - 1) S(n).
            mean = survival.sum()
            variance = ((2 * np.arange(1, len(survival) + 1) - 1) * survival).sum() - mean**2
            if variance > 1e-9:
                self.z = float((total - count * mean) / math.sqrt(count * variance))
            self.p = p_of_lengths(survival, count, total)
        # Probability of 1, 2, ... or more.
        self.asked_survival: list[float] = survival[:told].tolist()
        self.delivered_survival = [
            sum(times for n, times in lengths.items() if n >= least) / count if count else math.nan
            for least in range(1, told + 1)
        ]
        self.lengths = {str(n): times for n, times in sorted(lengths.items())}  # How many were so


# Probabilities at which whole distributions are told, and 1.
CURVE = np.concatenate([[0.0, 0.001, 0.002, 0.005], np.arange(1, 100) / 100, [0.995, 0.998, 0.999]])
OTHER_FATES = {
    "queue_full": pb.QUEUE_FULL,
    "outage": pb.OUTAGE,
    "stale": pb.STALE,
    "undelivered": pb.UNDELIVERED,
    "ended": pb.ENDED,
    "unknown": pb.FATE_UNSPECIFIED,
}


class LatencyFigures:
    """A distribution of times in milliseconds, by its quantiles."""

    def __init__(
        self, mean_ms: float, max_ms: float, quantiles_ms: Callable[[Floats], Floats]
    ) -> None:
        self.mean_ms = mean_ms
        self.p50_ms, self.p90_ms, self.p99_ms = quantiles_ms(np.array([0.5, 0.9, 0.99])).tolist()
        self.max_ms = max_ms
        # At the probabilities of the report's `curve`.
        self.curve_ms: list[float] = quantiles_ms(np.append(CURVE, 1.0)).tolist()


class Fit:
    """Delivered delays against the law that was asked, or why they do not follow one.

    By Kolmogorov and Smirnov: of what was delivered, engine and all, and of the delays that the
    link drew, without the engine's lateness.
    """

    def __init__(self, asked: LinkExpectation | None, delays_ns: Ints, drawn_ns: Ints) -> None:
        self.distance = self.p_value = self.link_distance = self.link_p_value = math.nan
        # Messages that tell as much as these did, where successive delays are correlated.
        self.independent = math.nan
        self.other = 0  # Messages with another delay than the one that is asked of all of them
        self.not_comparable = "not known"  # Why there is nothing to compare with; empty if there is
        if asked is None:
            return
        link, (least_ms, most_ms) = asked.link, asked.delay.quantile_ms([0.0, 1.0])
        reasons = {
            "down": link.down,
            "stalls": link.on_loss == "stall",
            "kept in order": link.in_order,
            "rate limited": link.rate_kbit_s is not None,
            "reordered on purpose": link.reorder is not None,
            "all the same": not most_ms > least_ms,
        }
        self.not_comparable = ", ".join(reason for reason, holds in reasons.items() if holds)
        if self.not_comparable == "all the same":
            other_ns = np.abs(drawn_ns - round(asked.delay.mean_ms() * 1e6))
            self.other = int((other_ns > 1).sum())
        if self.not_comparable:
            return
        # The sum of an autoregression's correlations rho^k bounds how much its distribution
        # function varies more than that of independent draws.
        rho = abs(link.delay_correlation)
        share = (1 - rho) / (1 + rho)
        self.independent = len(delays_ns) * share
        self.distance = asked.delay.distance(delays_ns)
        self.p_value = p_of_distance(self.distance, self.independent)
        self.link_distance = asked.delay.distance(drawn_ns)
        self.link_p_value = p_of_distance(self.link_distance, len(drawn_ns) * share)


class Share:
    """A share of messages, asked and delivered.

    `z` is that of the delivered share, in standard deviations from the asked one; `p` the
    probability of such a share, or one further off, by chance, NaN if nothing is asked.
    """

    def __init__(
        self, count: int, of: int, asked: float, z: float = math.nan, p: float = math.nan
    ) -> None:
        self.count, self.of, self.asked = count, of, asked
        self.delivered = count / of if of else math.nan
        self.z, self.p = z, p


class LinkFigures:
    """A sensor's messages under one link setting: what a link asked and what it delivered."""

    def __init__(
        self, sensor: str, number: int, setting: Setting, sent: ToldMessages, order: Order
    ) -> None:
        """`number` is that of the setting, among this sensor's, from 1 as they came into force.

        `sent` is what became of its messages under that setting: first copies, and duplicates too.
        """
        text, asked = setting.text, setting.asked
        first = sent.rows(sent.copy == 0)
        through = sent.rows(np.isin(sent.fate, [*LET_THROUGH]))
        left = sent.rows(sent.fate == pb.SENT)
        fates = Counter(first.fate.tolist())
        passed, copies = len(through), len(sent) - len(first)
        decided = fates[pb.LOST] + sum(fates[fate] for fate in PASSED_LOSS)
        corrupted = int((through.flipped_bit >= 0).sum())
        due_ns = first.due_utc_ns
        # Sending less being handed over, of first copies; and as the link drew it, without the
        # engine's lateness.
        handed, drawn = left.rows(left.copy == 0), through.rows(through.copy == 0)
        delays_ns = _apart_ns(handed.sent_utc_ns, handed.due_utc_ns)
        drawn_ns = _apart_ns(drawn.link_due_utc_ns, drawn.due_utc_ns)
        self.sensor, self.number = sensor, number
        self.link: object = text if text and asked is None else json.loads(text or "{}")
        self.link_problem = setting.problem  # Why nothing is known of what it asked; else empty
        # When the first message was handed over, and the last.
        self.first_utc_ns = int(due_ns.min(initial=1 << 62)) if len(first) else 0
        self.last_utc_ns = int(due_ns.max(initial=-(1 << 62))) if len(first) else 0
        self.messages, self.sent = len(first), fates[pb.SENT]
        self.asked: LatencyFigures | None = None
        if asked is not None and not asked.link.down:
            law, most_ms = asked.delay, float(asked.delay.quantile_ms([1.0])[0])
            self.asked = LatencyFigures(law.mean_ms(), most_ms, law.quantile_ms)
        self.delivered = found_times(delays_ns)
        self.fit = Fit(asked, delays_ns, drawn_ns)
        # Of the engine: sending less when the link was to let the message leave.
        self.lateness = found_times(_apart_ns(left.sent_utc_ns, left.link_due_utc_ns))
        self.loss = _loss(asked, fates[pb.LOST], decided)
        self.bursts = Bursts(asked, order)
        doubling = (copies, passed - copies, math.nan if asked is None else asked.link.duplicate)
        # A full queue takes some.
        is_full = asked is not None and asked.link.rate_kbit_s is not None
        self.duplicates = Share(*doubling) if is_full else _binomial(*doubling)
        self.corrupted = _binomial(corrupted, passed, asked.link.corrupt if asked else math.nan)
        # Messages that left before one that had been handed over earlier.
        self.overtook = _overtaking(asked, order)
        self.other_fates = {name: fates[fate] for name, fate in OTHER_FATES.items()}


def found_times(times_ns: Ints) -> LatencyFigures:
    """A distribution of times: the least that shares of all do not exceed; NaN of none."""
    in_order, n = np.sort(times_ns), len(times_ns)

    def quantiles_ms(shares: Floats) -> Floats:
        if not n:
            return np.full(shares.shape, np.nan)
        ranks = np.clip(np.ceil(shares * n), 1, n).astype(np.int64) - 1
        return np.asarray(in_order[ranks] / 1e6)

    mean_ms = float(times_ns.sum(dtype=np.float64)) / n / 1e6 if n else math.nan
    return LatencyFigures(mean_ms, float(in_order[-1]) / 1e6 if n else math.nan, quantiles_ms)


def _binomial(count: int, of: int, asked: float) -> Share:
    if math.isnan(asked):
        return Share(count, of, asked)
    z = z_score(count - of * asked, of * asked * (1 - asked))
    return Share(count, of, asked, z, p_of_binomial(count, of, asked) if of else math.nan)


def _loss(asked: LinkExpectation | None, lost: int, of: int) -> Share:
    """Loss among messages on which the model of loss decided: outages hide what it would have."""
    mean = math.nan if asked is None else asked.loss.mean_loss
    if asked is not None and asked.link.on_loss == "stall":
        mean = 0.0
    if asked is None or not of:
        return Share(lost, of, mean)
    if not 0 < mean < 1:
        return Share(lost, of, mean, p=p_of_binomial(lost, of, mean))
    z = math.nan
    if of * mean / asked.loss.mean_burst >= ENOUGH:
        z = z_score(lost - of * mean, (of * asked.loss.spread_of_loss(of)) ** 2)
    return Share(lost, of, mean, z, asked.loss.p_of(lost, of))


def _overtaking(asked: LinkExpectation | None, order: Order) -> Share:
    """Overtaking: none is asked where order is kept; else it depends on how messages come."""
    share = p = math.nan
    if asked is not None:
        least_ms, most_ms = asked.delay.quantile_ms([0.0, 1.0])
        if asked.link.keeps_order or (least_ms == most_ms and asked.link.reorder is None):
            share = 0.0
    if share == 0.0 and order.left:
        p = 0.0 if order.overtook else 1.0
    return Share(order.overtook, order.left, share, p=p)


def link_checks(link: LinkFigures, differs: Container[str] = ()) -> Iterator[Check]:
    """Delays as the link drew them, losses, bursts, copies, flipped bits and the order.

    Those that differ from what was asked whatever came are wrong.
    """

    def check(name: str, unit: str, of: int, p: float, *means: float) -> Check:
        expected, found = means
        p = 0.0 if name in differs else p
        found_of = Check(name=name, unit=unit, of=of, p=p, expected=expected, found=found)
        return replace(found_of, sensor=link.sensor, link=link.number)

    fit, delivered, asked = link.fit, link.delivered, link.asked
    if asked is not None:
        means = asked.mean_ms, delivered.mean_ms
        yield check("delay", "ms", link.sent, fit.link_p_value, *means)
        yield check("delay", "ms", fit.other or link.sent, 0.0 if fit.other else 1.0, *means)
    for name, share in (
        ("loss", link.loss),
        ("duplicates", link.duplicates),
        ("flipped bits", link.corrupted),
        ("order", link.overtook),
    ):
        yield check(name, "%", share.of, share.p, 100 * share.asked, 100 * share.delivered)
    bursts = link.bursts
    means = bursts.asked_mean, bursts.delivered_mean
    yield check("bursts of losses", "messages", bursts.bursts, bursts.p, *means)


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

"""What a link asked beside what it delivered, as figures; NaN where there is nothing to say."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from plotfeed.feeds.impairment.link import LinkExpectation
from plotfeed.feeds.recording.loss_chances import p_of_losses
from plotfeed.feeds.report.link_tally import PASSED_LOSS, LinkTally, Order, Setting, why_not_plain
from plotfeed.feeds.report.spreads import ENOUGH, LawFit, Spread, p_of_distance, z_score
from plotfeed.models.state import Floats
from plotfeed.models.tail_chances import p_of_binomial, p_of_lengths
from plotfeed.proto import plotfeed_pb2 as pb

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

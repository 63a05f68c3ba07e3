"""Messages lost in a row, asked and delivered; NaN where there is nothing to say."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from plotfeed.feeds.impairment.asked import Asked
from plotfeed.feeds.ledger_report.passage import Order
from plotfeed.models.state import Floats

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
    asked_survival: Sequence[float]
    """Probability of 1, 2, ... or more."""
    delivered_survival: Sequence[float]
    lengths: Mapping[str, int]
    """How many were so long."""


def burst_figures(asked: Asked | None, order: Order) -> Bursts:
    """Of what a link asks and what was found in order."""
    lengths = order.bursts
    count, total = lengths.total(), sum(n * times for n, times in lengths.items())
    told = min(max(10, *lengths, 0), LONGEST_TOLD)
    loses = asked is not None and asked.link.on_loss == "drop"
    survival = asked.burst_survival(LONGEST_SUMMED) if asked and loses else np.array([math.nan])
    return Bursts(
        bursts=count,
        cut=order.cut_bursts,
        asked_mean=asked.mean_burst if asked and loses else math.nan,
        delivered_mean=total / count if count else math.nan,
        z=_burst_z(total, count, survival),
        asked_survival=survival[:told].tolist(),
        delivered_survival=[
            sum(times for n, times in lengths.items() if n >= least) / count if count else math.nan
            for least in range(1, told + 1)
        ],
        lengths={str(n): times for n, times in sorted(lengths.items())},
    )


def _burst_z(total: int, count: int, survival: Floats) -> float:
    """By the mean of lengths, sum S(n), and of their squares, sum (2n - 1) S(n)."""
    if count < FEWEST_BURSTS or not survival[-1] < 1e-9:
        return math.nan
    mean = survival.sum()
    variance = ((2 * np.arange(1, len(survival) + 1) - 1) * survival).sum() - mean**2
    if not variance > 1e-9:
        return math.nan
    return float((total - count * mean) / math.sqrt(count * variance))

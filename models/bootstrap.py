"""How far a figure of several runs may be off by chance: the bootstrap over runs.

Runs are independent, the steps within one are not: runs alone are drawn again. Efron and
Tibshirani, An Introduction to the Bootstrap (1993), section 13.3, the percentile interval.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.state import Floats

RESAMPLES, FEWEST_SAMPLES = 2000, 200
MAX_DRAWN = 2_000_000  # Runs times samples that are held
SHARE = 0.95  # Of the interval
FEWEST = 2  # Runs, below which there is no interval


class Interval(NamedTuple):
    """A figure, and between what it lies in 95 of 100 such experiments; NaN is not known."""

    value: float
    low: float
    high: float


NOTHING = Interval(np.nan, np.nan, np.nan)


@nan_without_warnings
def ratio_interval(parts: ArrayLike, wholes: ArrayLike, seed: int = 0) -> Interval:
    """The sum of `parts` (n,) over that of `wholes` (n,), one of each a run.

    Runs whose part is NaN are left out. The draws are those of `seed`, so that the same runs have
    the same interval.
    """
    a, b = as_floats(parts), as_floats(wholes)
    known = np.isfinite(a) & np.isfinite(b)
    a, b = a[known], b[known]
    if not len(a) or not b.sum():
        return NOTHING
    value = float(a.sum() / b.sum())
    if len(a) < FEWEST:
        return Interval(value, np.nan, np.nan)
    drawn = _times_drawn(len(a), seed)
    ratios = (drawn @ a) / (drawn @ b)
    edges = [(1 - SHARE) / 2, (1 + SHARE) / 2]
    low, high = np.quantile(ratios[np.isfinite(ratios)], edges)
    return Interval(value, float(low), float(high))


@lru_cache(maxsize=4)
def _times_drawn(runs: int, seed: int) -> Floats:
    """Counts of each run in each sample, (k, n): of many runs fewer samples, which differ less."""
    samples = min(RESAMPLES, max(MAX_DRAWN // runs, FEWEST_SAMPLES))
    rng = np.random.default_rng(seed)
    return as_floats(rng.multinomial(runs, np.full(runs, 1 / runs), samples))


def mean_interval(values: ArrayLike, seed: int = 0) -> Interval:
    """The mean of values (n,), one a run; infinite where that of any run is."""
    values = as_floats(values)
    if np.isinf(values).any():
        return Interval(np.inf, np.inf, np.inf)
    return ratio_interval(values, np.ones_like(values), seed)

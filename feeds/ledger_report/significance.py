"""How far what was delivered may be by chance from what was asked."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import kolmogorov

ENOUGH = 5.0
"""Variance of a count above which it is taken to be normal; below it, there is no z-score."""
TWO_SIDED_95 = 1.959964
"""Standard deviations of a normal law on either side of its mean that hold 95 % of it."""


def z_score(excess: float, variance: float) -> float:
    """A count's excess in standard deviations; NaN if too few were counted for a normal law."""
    return excess / math.sqrt(variance) if variance >= ENOUGH else math.nan


def share_interval(count: int, of: int) -> tuple[float, float]:
    """95 % interval of a probability of which so many came true; Wilson, 1927."""
    if not of:
        return math.nan, math.nan
    share, z2 = count / of, TWO_SIDED_95**2
    middle = (share + z2 / (2 * of)) / (1 + z2 / of)
    half = TWO_SIDED_95 * math.sqrt(share * (1 - share) / of + z2 / (4 * of**2)) / (1 + z2 / of)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def p_of_distance(distance: float, n: float) -> float:
    """Probability that n independent draws are as far from their law, after Kolmogorov.

    The asymptotic law with Stephens' correction for few draws (1970); NaN of less than 8.
    """
    if not n >= 8 or math.isnan(distance):
        return math.nan
    root = math.sqrt(n)
    return float(np.clip(kolmogorov((root + 0.12 + 0.11 / root) * distance), 0.0, 1.0))

"""How improbable it is by chance that a figure is as far from what was asked as it is, or further.

Two-sided probabilities: twice the smaller tail, at most 1. Tails of sums are by Lugannani and Rice
(1980), for whole numbers with the first continuity correction of Daniels (1987): good to a few
per cent however far out, where a normal law is wrong by many times.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import bdtr, bdtrc, gammainc, gammaincc, kolmogorov, ndtr, pdtr, pdtrc

from plotfeed.models.state import Floats

FURTHEST_TILT = 60.0
HALF = 0.5
NEARLY_NORMAL = 0.1  # Standard deviations about the mean within which a tail is taken to be normal


class Cumulants(NamedTuple):
    """A tilted law: the logarithm of its generating function, its mean and its variance."""

    log: float
    mean: float
    variance: float


def two_sided(lower: float, upper: float) -> float:
    """The probability of either tail, by those of the lower and the upper one."""
    return min(2 * min(lower, upper), 1.0)


def p_of_normal(z: float) -> float:
    """Probability of a standard normal number as far out; NaN for NaN."""
    return 2 * float(ndtr(-abs(z)))


def p_of_squares(total: float, mean: float, variance: float) -> float:
    """Probability of such a sum of squares, by the gamma law of that mean and variance."""
    shape = mean * mean / variance
    x = total * mean / variance
    return two_sided(float(gammainc(shape, x)), float(gammaincc(shape, x)))


def p_of_binomial(count: int, of: int, p: float) -> float:
    """Probability of so many successes."""
    if not 0 < p < 1:
        return 1.0 if count == (of if p else 0) else 0.0
    upper = float(bdtrc(count - 1, of, p)) if count else 1.0
    return two_sided(float(bdtr(count, of, p)), upper)


def p_of_poisson(count: int, mean: float) -> float:
    """Probability of so many of what has no greatest number."""
    if not mean > 0:
        return 1.0 if not count else 0.0
    upper = float(pdtrc(count - 1, mean)) if count else 1.0
    return two_sided(float(pdtr(count, mean)), upper)


def p_of_trials(looks: Floats, mean_p: Floats, count: int) -> float:
    """Probability of so many successes: in each cell so many trials, of that mean chance.

    Where chances within a cell differ, their sum varies less than is taken here.
    """
    some = looks > 0
    n, p = looks[some], np.clip(mean_p[some], 0.0, 1.0)
    surely, possible = float(n[p >= 1].sum()), float(n[p > 0].sum())
    if not surely <= count <= possible:
        return 0.0
    open_ = (p > 0) & (p < 1)
    n, p = n[open_], p[open_]
    if not len(n):
        return 1.0

    def cumulants(t: float) -> Cumulants:
        odds = p * math.exp(t)
        tilted = odds / (1 - p + odds)
        log = float(n @ np.log1p(p * math.expm1(t)))
        return Cumulants(log, float(n @ tilted), float(n @ (tilted * (1 - tilted))))

    return p_of_whole(count - surely, cumulants, possible - surely)


def p_of_lengths(survival: Floats, bursts: int, total: int) -> float:
    """Probability of so many messages in bursts, whose lengths exceed 0, 1, ... by `survival`."""
    lengths = np.arange(1, len(survival) + 1)
    law = -np.diff(survival, append=0.0)
    if not (law[1:] > 0).any():
        return 1.0 if total == bursts * lengths[law.argmax()] else 0.0
    lengths, law = lengths[law > 0], law[law > 0]
    most = math.log(1e300) / lengths[-1]

    def cumulants(t: float) -> Cumulants:
        weights = law * np.exp(np.minimum(t, most) * lengths)
        whole = float(weights.sum())
        mean = float(weights @ lengths) / whole
        variance = float(weights @ (lengths - mean) ** 2) / whole
        return Cumulants(bursts * math.log(whole), bursts * mean, bursts * variance)

    return p_of_whole(total, cumulants, float(bursts * lengths[-1]), least=float(bursts), most=most)


def p_of_whole(
    count: float,
    cumulants: Callable[[float], Cumulants],
    greatest: float,
    *,
    least: float = 0.0,
    most: float = FURTHEST_TILT,
) -> float:
    """Probability of a whole number within bounds, by the cumulants of its law under any tilt."""

    def of_negative(t: float) -> Cumulants:
        found = cumulants(-t)
        return Cumulants(found.log, -found.mean, found.variance)

    lower = _upper_tail(-count, of_negative, (-greatest, -least), (FURTHEST_TILT, most))
    upper = _upper_tail(count, cumulants, (least, greatest), (most, FURTHEST_TILT))
    return two_sided(lower, upper)


def _upper_tail(
    count: float,
    cumulants: Callable[[float], Cumulants],
    bounds: tuple[float, float],
    tilts: tuple[float, float],
) -> float:
    """Probability of so many or more, tilted up and down by so much at most."""
    (least, greatest), (most, most_down) = bounds, tilts
    if count <= least:
        return 1.0
    if count > greatest:
        return 0.0
    if count > greatest - HALF:  # all the weight that there is under the furthest tilt
        return math.exp(min(cumulants(most).log - most * count, 0.0))
    straight = cumulants(0.0)
    spread = math.sqrt(straight.variance)
    if abs(count - straight.mean) < NEARLY_NORMAL * spread:
        return float(ndtr((straight.mean - count + 0.5) / spread))
    low, high = (0.0, most) if count > straight.mean else (-most_down, 0.0)
    for _ in range(80):
        t = (low + high) / 2
        low, high = (t, high) if cumulants(t).mean < count else (low, t)
    found = cumulants(t)
    if t > 0 and found.mean < count - HALF:  # too improbable to be tilted to: Chernoff's bound
        return math.exp(found.log - t * count)
    w = math.copysign(math.sqrt(max(2 * (t * count - found.log), 1e-12)), t)
    u = -math.expm1(-t) * math.sqrt(max(found.variance, 1e-12))
    density = math.exp(-w * w / 2) / math.sqrt(2 * math.pi)
    return min(max(float(ndtr(-w)) + density * (1 / u - 1 / w), 0.0), 1.0)


def p_of_distance(distance: float, n: float) -> float:
    """Probability that n independent draws are as far from their law, after Kolmogorov.

    The asymptotic law with Stephens' correction for few draws (1970); NaN of less than 8.
    """
    if not n >= 8 or math.isnan(distance):
        return math.nan
    root = math.sqrt(n)
    return float(np.clip(kolmogorov((root + 0.12 + 0.11 / root) * distance), 0.0, 1.0))

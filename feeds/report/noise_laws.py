"""Laws of what noise makes of a measurement, in moments: straight, through a function, in steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from plotfeed.models.state import Floats

NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(7)
WEIGHTS = WEIGHTS / WEIGHTS.sum()
"""Of a quadrature over a standard normal number."""
FEW_NODES, FEW_WEIGHTS = np.polynomial.hermite_e.hermegauss(5)
FEW_WEIGHTS = FEW_WEIGHTS / FEW_WEIGHTS.sum()
NEAR_STEPS = np.arange(-8, 9)


class Expected(NamedTuple):
    """Means of a quantity, what noise leaves of it (variance and kurtosis), and its step; (n,)."""

    mean: Floats
    variance: Floats
    kurtosis: Floats
    step: float = 0.0


def gauss(mean: Floats, sigma: Floats) -> Expected:
    """The law of a measurement with normal noise."""
    return Expected(mean, sigma**2, np.full(len(mean), 3.0))


def over(values: Floats, weights: Floats) -> Expected:
    """The law of what follows from normal noise: values (n, nodes) at the nodes of a quadrature."""
    mean = values @ weights
    excess = values - mean[:, None]
    variance = excess**2 @ weights
    return Expected(mean, variance, np.asarray(excess**4 @ weights / variance**2))


def with_rounding(law: Expected, step: float) -> Expected:
    """The law of values with an error of rounding to steps beside, about the unrounded mean.

    Sheppard's: to whoever does not know where in a step the mean is, however coarse that is.
    """
    if not step:
        return law
    mean, variance, kurtosis, _ = law
    uniform = step**2 / 12
    fourth = kurtosis * variance**2 + 6 * variance * uniform + step**4 / 80
    return Expected(mean.copy(), variance + uniform, fourth / (variance + uniform) ** 2, step)


def in_steps(law: Expected, step: float) -> Expected:
    """The law of values that are rounded to steps: Sheppard's, or a sum where steps are coarse."""
    if not step:
        return law
    told = with_rounding(law, step)
    mean, variance = law.mean, law.variance
    coarse = np.sqrt(variance) < step
    if not coarse.any():
        return told
    middle, sigma = mean[coarse], np.sqrt(variance[coarse])[:, None]
    at = np.rint(middle / step)[:, None] + NEAR_STEPS
    edges = (np.column_stack([at, at[:, -1] + 1]) - 0.5) * step
    law_at = np.diff(ndtr((edges - middle[:, None]) / np.maximum(sigma, 1e-12)), axis=1)
    means = (law_at * at * step).sum(axis=1)
    excess = at * step - means[:, None]
    variances, fourths = ((law_at * excess**power).sum(axis=1) for power in (2, 4))
    told.mean[coarse], told.variance[coarse] = means, variances
    told.kurtosis[coarse] = fourths / variances**2
    return told

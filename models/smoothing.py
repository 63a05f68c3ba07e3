"""Positions that were rounded or noisy to a smooth path and its velocity."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solveh_banded

from plotfeed.models.numerics import as_floats
from plotfeed.models.state import Floats

# White acceleration's power density: in one second the velocity changes by some 1 m/s.
ACCELERATION_DENSITY_M2_S3 = 1.0


def smooth(
    t_s: ArrayLike,
    position_m: ArrayLike,
    sigma_m: ArrayLike,
    acceleration_density: ArrayLike = ACCELERATION_DENSITY_M2_S3,
) -> tuple[Floats, Floats]:
    """Smoothed position, metres, and velocity, m/s, at each time; both (n, k).

    t_s (n,) strictly increasing, position_m (n, k), sigma_m (k,) the standard deviation of each
    column, acceleration_density (k,) or scalar in m2/s3.

    The path is taken for the integral of white acceleration of density q, measured with error
    sigma. Its most probable course f, given measurements y, minimises

        sum (y_i - f(t_i))^2 / sigma^2 + (1/q) integral f''(t)^2 dt,

    which is the natural cubic smoothing spline with lambda = sigma^2 / q. One sample has no
    velocity but zero; two give a straight line.
    """
    t = as_floats(t_s)
    y = as_floats(position_m)
    h = np.diff(t)
    if not np.all(h > 0):
        raise ValueError("times must be strictly increasing")
    if len(t) < 2:
        return y.copy(), np.zeros_like(y)
    smoothing = np.broadcast_to(np.square(sigma_m) / np.asarray(acceleration_density), y.shape[1:])
    position, curvature = y.copy(), np.zeros_like(y)
    if len(t) > 2:
        for column, lambda_m2 in enumerate(smoothing):
            position[:, column], curvature[1:-1, column] = _reinsch(h, y[:, column], lambda_m2)
    # First derivative at every knot of the cubic with those values and second derivatives.
    h = h[:, None]
    chord, slopes = np.diff(position, axis=0) / h, np.empty_like(position)
    slopes[:-1] = chord - h * (2 * curvature[:-1] + curvature[1:]) / 6
    slopes[-1] = chord[-1] + h[-1] * (curvature[-2] + 2 * curvature[-1]) / 6
    return position, slopes


def _reinsch(h: Floats, y: Floats, smoothing: float) -> tuple[Floats, Floats]:
    """Values (n,) and inner second derivatives (n-2,) of the smoothing spline with that lambda.

    Reinsch's equations (R + lambda Q'Q) c = Q'y, f = y - lambda Q c; Green and Silverman,
    Nonparametric Regression and Generalized Linear Models, section 2.3.
    """
    before, here, after = 1 / h[:-1], -1 / h[:-1] - 1 / h[1:], 1 / h[1:]
    bands = np.zeros((3, len(y) - 2))  # upper form: the main diagonal is the last row
    bands[2] = (h[:-1] + h[1:]) / 3 + smoothing * (before**2 + here**2 + after**2)
    bands[1, 1:] = h[1:-1] / 6 + smoothing * (here[:-1] * before[1:] + after[:-1] * here[1:])
    bands[0, 2:] = smoothing * after[:-2] * before[2:]
    second_difference = before * y[:-2] + here * y[1:-1] + after * y[2:]
    c = solveh_banded(bands, second_difference)
    change = np.zeros_like(y)
    change[:-2] += before * c
    change[1:-1] += here * c
    change[2:] += after * c
    return y - smoothing * change, c

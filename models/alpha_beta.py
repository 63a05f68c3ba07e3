"""What an alpha-beta filter leaves of the errors of its plots, in the steady state.

The filter predicts a straight flight over the period T, x' = x + vT, and takes a share of what a
plot z differs from that: x = x' + alpha (z - x'), v = v + beta (z - x') / T.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.state import Floats


@dataclass(frozen=True, slots=True)
class AlphaBeta:
    """The critically damped filter: a straight line by least squares through all plots so far.

    In it a plot that is n scans old weighs theta^n.
    """

    smoothing_scans: float

    @property
    def memory(self) -> float:
        """What a scan leaves of a plot's weight, theta = exp(-1 / smoothing_scans)."""
        return math.exp(-1.0 / self.smoothing_scans)

    @property
    def alpha(self) -> float:
        """Of the position: 1 - theta^2."""
        return 1.0 - self.memory**2  # Brookner, Tracking and Kalman Filtering Made Easy, ch. 1

    @property
    def beta(self) -> float:
        """Of the velocity: (1 - theta)^2."""
        return (1.0 - self.memory) ** 2

    def position_variance(self, misses: ArrayLike) -> Floats:
        """Of x after so many periods without a plot, as a multiple of a plot's own variance."""
        position, both, velocity = self._stationary()
        n = np.asarray(misses, dtype=np.float64)
        return position + n * (2.0 * both + n * velocity)

    def velocity_variance(self) -> float:
        """Of v, as a multiple of a plot's own variance over T^2."""
        return self._stationary()[2]

    def _stationary(self) -> tuple[float, float, float]:
        """Variance of x, covariance of x and vT, variance of vT, of plots with variance 1.

        The P that stays as it is under P = A P A' + K K', with K = (alpha, beta)' and
        A = (1 - alpha, 1 - alpha; -beta, 1 - beta).
        """
        alpha, beta = self.alpha, self.beta
        whole = alpha * (4.0 - 2.0 * alpha - beta)
        return (
            (2.0 * alpha**2 + 2.0 * beta - 3.0 * alpha * beta) / whole,
            beta * (2.0 * alpha - beta) / whole,
            2.0 * beta**2 / whole,
        )

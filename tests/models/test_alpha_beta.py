from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from plotfeed.models.tracks import AlphaBeta

MEMORIES = pytest.mark.parametrize("scans", [0.1, 0.5, 1.0, 3.0, 10.0, 100.0])
FLIGHT = np.array([[1.0, 1.0], [0.0, 1.0]])  # a period of x and vT


def errors_of(design: AlphaBeta) -> np.ndarray:
    """Covariance of x and vT for plots of variance 1, by the filter's own equations."""
    gain = np.array([[design.alpha], [design.beta]])
    left = (np.eye(2) - gain @ np.array([[1.0, 0.0]])) @ FLIGHT
    covariance: np.ndarray = solve_discrete_lyapunov(left, gain @ gain.T)
    return covariance


@MEMORIES
def test_variances_are_those_of_the_filters_equations(scans: float) -> None:
    design = AlphaBeta(scans)
    expected = errors_of(design)
    assert design.position_variance(0) == pytest.approx(expected[0, 0], rel=1e-9)
    assert design.velocity_variance() == pytest.approx(expected[1, 1], rel=1e-9)


@MEMORIES
def test_a_coasted_position_is_that_of_a_straight_flight(scans: float) -> None:
    design = AlphaBeta(scans)
    covariance = errors_of(design)
    for misses in range(1, 6):
        covariance = FLIGHT @ covariance @ FLIGHT.T
        assert design.position_variance(misses) == pytest.approx(covariance[0, 0], rel=1e-9)


@MEMORIES
def test_it_is_the_weighted_straight_line_through_all_plots(scans: float) -> None:
    design = AlphaBeta(scans)
    age = np.arange(int(60 * scans) + 60)
    root = np.sqrt(design.memory**age)
    # Position now and change a period, of plots at times -age: rows of weights of the plots.
    weights = np.linalg.pinv(np.stack([root, -age * root], axis=1)) * root
    assert design.position_variance(0) == pytest.approx(weights[0] @ weights[0], rel=1e-6)
    assert design.velocity_variance() == pytest.approx(weights[1] @ weights[1], rel=1e-6)


def test_without_memory_the_position_is_the_plot() -> None:
    design = AlphaBeta(0.1)
    assert design.position_variance(0) == pytest.approx(1.0, rel=1e-3)
    assert design.velocity_variance() == pytest.approx(2.0, rel=1e-3)

"""Kalman's filter against least squares, its own law of composition, and its stated errors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from support.significance import assert_chance

from plotfeed.models.plain_tracker import distances2, predicted, updated

SIGMA_M = 3.0


def test_without_acceleration_it_is_a_straight_line_by_least_squares() -> None:
    rng = np.random.default_rng(1)
    t_s = np.array([0.0, 1.0, 2.5, 3.0, 4.7])
    measured_m = rng.normal(0, 50, (5, 3))
    errors_m2 = SIGMA_M**2 * np.eye(3)[None]
    states = np.concatenate([measured_m[:1], np.zeros((1, 3))], axis=1)
    spread = np.zeros((1, 6, 6))
    spread[0, :3, :3], spread[0, 3:, 3:] = errors_m2[0], 1e8 * np.eye(3)
    for k in range(1, 5):
        states, spread = predicted(states, spread, t_s[k : k + 1] - t_s[k - 1], 0.0)
        states, spread = updated(states, spread, measured_m[k : k + 1], errors_m2)
    design = np.stack([np.ones(5), t_s - t_s[-1]], axis=1)
    line = np.linalg.lstsq(design, measured_m, rcond=None)[0]
    covariance = SIGMA_M**2 * np.linalg.inv(design.T @ design)
    assert states[0] == pytest.approx(line.ravel(), abs=1e-4)
    assert spread[0][np.ix_([0, 3], [0, 3])] == pytest.approx(covariance, rel=1e-4)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_two_predictions_are_one_over_both_times(sign: float) -> None:
    rng = np.random.default_rng(2)
    root = rng.normal(size=(4, 6, 6))
    states, spread = rng.normal(size=(4, 6)), root @ root.transpose(0, 2, 1)
    first_s, second_s = sign * rng.uniform(0, 3, 4), sign * rng.uniform(0, 3, 4)
    twice = predicted(*predicted(states, spread, first_s, 2.0), second_s, 2.0)
    once = predicted(states, spread, first_s + second_s, 2.0)
    assert twice[0] == pytest.approx(once[0])
    assert twice[1] == pytest.approx(once[1])


def test_errors_are_as_large_as_their_covariances_say() -> None:
    """NEES of 2,000 targets with white acceleration, and distances of their next plots: chi2."""
    n, density, rng = 2000, 4.0, np.random.default_rng(3)
    truth = np.concatenate([rng.normal(0, 1000, (n, 3)), rng.normal(0, 15, (n, 3))], axis=1)
    errors_m2 = np.broadcast_to(np.diag([4.0, 25.0, 100.0]), (n, 3, 3))
    sigma_m = np.array([2.0, 5.0, 10.0])
    step = np.linalg.cholesky(density * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]]))
    states = np.concatenate([truth[:, :3] + sigma_m * rng.normal(size=(n, 3)), np.zeros((n, 3))], 1)
    spread = np.zeros((n, 6, 6))
    spread[:, :3, :3], spread[:, 3:, 3:] = errors_m2, 225 * np.eye(3)
    for _ in range(8):
        truth[:, :3] += truth[:, 3:]
        kicks = np.einsum("ab,nbk->nak", step, rng.normal(size=(n, 2, 3)))
        truth += kicks.reshape(n, 6)
        measured_m = truth[:, :3] + sigma_m * rng.normal(size=(n, 3))
        states, spread = predicted(states, spread, np.ones(n), density)
        far2 = distances2(states, spread, measured_m, errors_m2)
        states, spread = updated(states, spread, measured_m, errors_m2)
    off = states - truth
    nees = np.einsum("ni,nij,nj->n", off, np.linalg.inv(spread), off)
    for values, freedom in ((nees, 6), (far2, 3)):
        assert_chance(float(stats.kstest(values, stats.chi2(freedom).cdf).pvalue), str(freedom))

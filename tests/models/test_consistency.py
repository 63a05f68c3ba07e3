from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from support.significance import assert_chance, assert_sum

from plotfeed.models.track_metrics import (
    independent_samples,
    lag_of,
    nees,
    nees_interval,
    survival_quantile,
)

N = 4000


def drawn(dimensions: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Errors of covariances of their own."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(N, dimensions, dimensions)) + 2 * np.eye(dimensions)
    covariance = root @ root.transpose(0, 2, 1)
    return (root @ rng.normal(size=(N, dimensions, 1)))[:, :, 0], covariance


@pytest.mark.parametrize("dimensions", [2, 3])
def test_nees_of_honest_errors_has_a_chi_squared_law(dimensions: int) -> None:
    values = nees(*drawn(dimensions))
    assert_chance(float(stats.kstest(values, stats.chi2(dimensions).cdf).pvalue), "NEES")
    low, high = nees_interval(N, dimensions, 1 - 1e-4)
    assert low < values.mean() < high


def test_nees_is_nan_where_a_covariance_is_none() -> None:
    covariance = np.array([[[1.0, 2.0], [2.0, 1.0]], [[np.nan, 0], [0, 1.0]], np.eye(2)])
    values = nees(np.ones((3, 2)), covariance)
    assert np.isnan(values[:2]).all()
    assert values[2] == pytest.approx(2.0)


def test_bounds_of_nees_hold_the_mean_of_so_many_runs() -> None:
    rng = np.random.default_rng(1)
    low, high = nees_interval(50, 2)
    means = rng.chisquare(2, (5000, 50)).mean(axis=1)
    inside = np.count_nonzero((means > low) & (means < high))
    assert_sum(inside, 0.95 * 5000, 0.95 * 0.05 * 5000, "runs within")
    assert np.isnan(nees_interval(0, 2)).all()


def test_correlated_samples_are_worth_fewer() -> None:
    """AR(1) of 0.8: (1 + 0.8) / (1 - 0.8) = 9 to one."""
    rng = np.random.default_rng(1)
    chain = np.zeros(20_000)
    for k, noise in enumerate(rng.normal(size=len(chain) - 1), 1):
        chain[k] = 0.8 * chain[k - 1] + noise
    one = np.zeros(len(chain), np.int64)
    assert len(chain) / independent_samples(chain, one) == pytest.approx(9.0, rel=0.3)
    white = rng.normal(size=5000)
    assert independent_samples(white, one[:5000]) > 4000
    assert independent_samples(np.ones(7), one[:7]) == 7.0
    assert independent_samples(chain, np.arange(len(chain))) == len(chain)


@pytest.mark.parametrize("stated", [False, True])
def test_lag_is_found_as_well_as_its_standard_error_says(stated: bool) -> None:
    rng = np.random.default_rng(1)
    found = []
    for _ in range(400):
        course = rng.uniform(0, 2 * np.pi, 60)
        velocity = rng.uniform(0.5, 15.0, 60)[:, None] * np.stack(
            [np.sin(course), np.cos(course)], axis=-1
        )
        error = -0.3 * velocity + 8.0 * rng.normal(size=(60, 2))
        covariance = np.tile(64.0 * np.eye(2), (60, 1, 1)) if stated else None
        lag = lag_of(error, velocity, covariance)
        found.append((lag.tau_s - 0.3) / lag.se_s)
    assert_sum(float(np.sum(found)), 0.0, 400.0, "lag over its standard error")
    assert np.std(found) == pytest.approx(1.0, abs=0.2)


def test_hovering_has_no_lag() -> None:
    assert np.isnan(lag_of(np.ones((5, 2)), np.zeros((5, 2)))).all()
    assert np.isnan(lag_of(np.ones((1, 2)), np.ones((1, 2)))).all()


def test_those_who_never_did_are_in_the_median() -> None:
    """Kaplan and Meier by hand: 1/4 by 2, then (3/4)(1/2) left after 5, below a half."""
    values, seen = np.array([2.0, 3.0, 5.0, 9.0]), np.array([True, False, True, False])
    assert survival_quantile(values, seen) == 5.0
    assert survival_quantile(values, seen, 0.2) == 2.0
    assert survival_quantile(values, np.zeros(4, np.bool_)) == float("inf")
    assert survival_quantile(values, np.ones(4, np.bool_)) == 3.0
    assert np.isnan(survival_quantile(values[:0], seen[:0]))

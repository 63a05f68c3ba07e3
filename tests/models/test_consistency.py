from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter
from support.significance import assert_chance

from plotfeed.models.track_metrics import lag_parts, nees, survival_quantile
from plotfeed.models.verdicts import FigureSamples

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
    one = np.zeros(N, np.int64)
    found = FigureSamples(values, np.full(N, float(dimensions)), one).interval(1e-4)
    assert found.low < 1.0 < found.high


def test_nees_is_nan_where_a_covariance_is_none() -> None:
    covariance = np.array([[[1.0, 2.0], [2.0, 1.0]], [[np.nan, 0], [0, 1.0]], np.eye(2)])
    values = nees(np.ones((3, 2)), covariance)
    assert np.isnan(values[:2]).all()
    assert values[2] == pytest.approx(2.0)


def correlated(rng: np.random.Generator, shape: tuple[int, ...], along: float) -> np.ndarray:
    """Normal numbers whose first axis is time, with that correlation from one to the next."""
    drawn, own = rng.standard_normal(shape), (1 - along**2) ** 0.5
    drawn[0] /= own
    return np.asarray(lfilter([own], [1.0, -along], drawn, axis=0))


RUNS, STEPS = 300, 300


@pytest.mark.parametrize("along", [0.0, 0.8, 0.95])
def test_lag_lies_within_its_interval_however_errors_hang_together(along: float) -> None:
    """|z| > 1.96 in 5 of 100, and at most in 8 where few samples are left of 0.95."""
    rng, outside = np.random.default_rng(1), 0
    one = np.zeros(STEPS, np.int64)
    for _ in range(RUNS):
        course = np.cumsum(rng.normal(0.0, 0.3, STEPS))
        velocity = 12.0 * np.stack([np.sin(course), np.cos(course)], axis=-1)
        errors = -0.3 * velocity + 8.0 * correlated(rng, (STEPS, 2), along)
        found = FigureSamples(*lag_parts(errors, velocity), one).interval()
        outside += not found.low <= 0.3 <= found.high
    assert outside <= stats.binom.ppf(1 - 1e-4, RUNS, 0.05)


@pytest.mark.parametrize("along", [0.0, 0.8, 0.95])
def test_nees_of_the_honest_holds_one_in_its_interval(along: float) -> None:
    rng, outside = np.random.default_rng(2), 0
    series = np.repeat(np.arange(5), STEPS)
    for _ in range(RUNS):
        errors = correlated(rng, (STEPS, 5, 2), along)
        values = (errors**2).sum(axis=2).T.ravel()
        found = FigureSamples(values, np.full(len(values), 2.0), series).interval()
        outside += not found.low <= 1.0 <= found.high
    assert outside <= stats.binom.ppf(1 - 1e-4, RUNS, 0.07)


def test_an_error_of_azimuth_is_no_lag() -> None:
    """One degree at 2 km, flown around: 35 m across, which is 0.48 s alone."""
    rng = np.random.default_rng(1)
    angle = np.linspace(0.0, 2.0, 200)
    place = 2000.0 * np.stack([np.sin(angle), np.cos(angle)], axis=-1)
    place[:, 1] += np.linspace(0, 900, 200)
    velocity = np.gradient(place, axis=0)
    turn = np.stack([place[:, 1], -place[:, 0]], axis=-1)
    errors = np.radians(1.0) * turn + rng.standard_normal((200, 2))
    one = np.zeros(200, np.int64)
    alone = FigureSamples(*lag_parts(errors, velocity), one).interval()
    beside = FigureSamples(*lag_parts(errors, velocity, None, turn[:, :, None]), one).interval()
    assert abs(alone.value) > 0.5
    assert beside.low < 0.0 < beside.high
    assert abs(beside.value) < 0.1


def test_hovering_has_no_lag() -> None:
    for n, velocity in ((5, 0.0), (0, 1.0)):
        parts, wholes = lag_parts(np.ones((n, 2)), np.full((n, 2), velocity))
        assert np.isnan(FigureSamples(parts, wholes, np.zeros(n, np.int64)).value)


def test_those_who_never_did_are_in_the_median() -> None:
    """Kaplan and Meier by hand: 1/4 by 2, then (3/4)(1/2) left after 5, below a half."""
    values, seen = np.array([2.0, 3.0, 5.0, 9.0]), np.array([True, False, True, False])
    assert survival_quantile(values, seen) == 5.0
    assert survival_quantile(values, seen, 0.2) == 2.0
    assert survival_quantile(values, np.zeros(4, np.bool_)) == float("inf")
    assert survival_quantile(values, np.ones(4, np.bool_)) == 3.0
    assert np.isnan(survival_quantile(values[:0], seen[:0]))

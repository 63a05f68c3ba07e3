from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import make_smoothing_spline

from plotfeed.models.smoothing import smooth


@given(st.integers(5, 40), st.floats(0.01, 10), st.floats(0.01, 10), st.integers(0, 2**32 - 1))
def test_it_is_the_smoothing_spline_of_lambda_sigma2_over_q(
    n: int, sigma_m: float, density: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    t_s = np.cumsum(rng.uniform(0.2, 2.0, n))
    position_m = rng.normal(size=(n, 2)) * 5
    smooth_m, velocity_m_s = smooth(t_s, position_m, (sigma_m, 2 * sigma_m), density)
    for k, sigma in enumerate((sigma_m, 2 * sigma_m)):
        spline = make_smoothing_spline(t_s, position_m[:, k], lam=sigma**2 / density)
        np.testing.assert_allclose(smooth_m[:, k], spline(t_s), atol=1e-6)
        np.testing.assert_allclose(velocity_m_s[:, k], spline.derivative()(t_s), atol=1e-5)


@pytest.mark.parametrize("n", [2, 3, 4, 5, 30])
def test_straight_flight_is_left_as_it_is(n: int) -> None:
    t_s = np.cumsum(np.arange(n) % 3 + 0.5)
    velocity = np.array([3.0, -4.0, 0.5])
    position_m, velocity_m_s = smooth(t_s, t_s[:, None] * velocity, (3.0, 3.0, 1.0))
    np.testing.assert_allclose(position_m, t_s[:, None] * velocity, atol=1e-9)
    np.testing.assert_allclose(velocity_m_s, np.tile(velocity, (n, 1)), atol=1e-9)


def test_one_sample_stays_and_stands_still() -> None:
    position_m, velocity_m_s = smooth([5.0], [[1.0, 2.0]], (1.0, 1.0))
    assert position_m.tolist() == [[1.0, 2.0]]
    assert velocity_m_s.tolist() == [[0.0, 0.0]]


@pytest.mark.parametrize("t_s", [[0.0, 1.0, 1.0], [0.0, 2.0, 1.0], [0.0, np.nan, 1.0]])
def test_times_that_do_not_increase_are_refused(t_s: list[float]) -> None:
    with pytest.raises(ValueError, match="increasing"):
        smooth(t_s, np.zeros((3, 1)), (1.0,))


def test_a_smaller_error_follows_the_measurements_closer() -> None:
    t_s = np.arange(50.0)
    measured = np.random.default_rng(1).normal(size=(50, 1)) * 3
    misfits = [
        np.abs(smooth(t_s, measured, (s,))[0] - measured).max() for s in (0.01, 0.1, 1.0, 10.0)
    ]
    assert misfits == sorted(misfits)
    assert misfits[0] < 0.02


def test_velocity_error_agrees_with_the_noise_that_it_was_told() -> None:
    """Simulated white acceleration and noise: smoothing recovers what the model allows."""
    rng = np.random.default_rng(7)
    density, sigma_m, dt_s, n = 1.0, 3.0, 0.1, 20_000
    velocity = np.cumsum(rng.normal(size=n) * np.sqrt(density * dt_s))
    position = np.cumsum(velocity) * dt_s
    t_s = np.arange(n) * dt_s
    _, fitted = smooth(t_s, (position + rng.normal(size=n) * sigma_m)[:, None], (sigma_m,), density)
    inner = slice(200, -200)
    rms_m_s = np.sqrt(np.mean((fitted[inner, 0] - velocity[inner]) ** 2))
    # Steady state of the optimal smoother: var v = q^(3/4) r^(1/4) / (2 sqrt 2), r = sigma^2 dt.
    expected = np.sqrt(density**0.75 * (sigma_m**2 * dt_s) ** 0.25 / (2 * np.sqrt(2)))
    assert rms_m_s == pytest.approx(expected, rel=0.1)

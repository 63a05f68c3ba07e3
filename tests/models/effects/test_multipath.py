"""Two rays over flat ground: against the sum of two waves, at its limits, and in every radio."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.models.propagation import two_ray_factor

heights = st.floats(0.1, 500.0)
ranges = st.floats(10.0, 20_000.0)
wavelengths = st.floats(0.01, 3.0)
reflections = st.floats(-1.0, 1.0)


@given(heights, heights, ranges, wavelengths, reflections)
def test_the_factor_is_that_of_two_waves_that_meet(h1, h2, ground, wavelength, rho):
    detour = np.hypot(ground, h1 + h2) - np.hypot(ground, h1 - h2)
    waves = 1 + rho * np.exp(2j * np.pi * detour / wavelength)
    factor = two_ray_factor(h1, h2, ground, wavelength, rho)
    rounding = 2 * np.pi / wavelength * np.hypot(ground, h1 + h2) * 1e-15
    assert factor == pytest.approx(abs(waves) ** 2, rel=1e-9, abs=1e-13 + 10 * rounding)


def test_far_away_power_falls_with_the_fourth_power_of_distance_beyond_free_space():
    """Grazing a perfect mirror, F is the phase itself: F^2 goes as one over the square."""
    h1, h2, wavelength = 2.0, 3.0, 0.5
    ground = np.array([1e5, 1e6, 1e7, 1e8])
    closed = (4 * np.pi * h1 * h2 / (wavelength * ground)) ** 2
    np.testing.assert_allclose(two_ray_factor(h1, h2, ground, wavelength, -1.0), closed, rtol=1e-5)
    np.testing.assert_allclose(
        two_ray_factor(h1, h2, ground[2:], wavelength, -1.0), closed[2:], rtol=1e-9
    )


def test_on_the_ground_and_at_no_distance_there_is_a_number():
    assert two_ray_factor(0.0, 50.0, 100.0, 0.03, -0.9) == pytest.approx(0.01, rel=1e-12)
    assert two_ray_factor(-3.0, 50.0, 100.0, 0.03, -0.9) == pytest.approx(0.01, rel=1e-12)
    assert np.isfinite(two_ray_factor(0.0, 0.0, 0.0, 0.03, -0.9))
    assert np.isfinite(two_ray_factor(2.0, 2.0, 0.0, 0.03, -0.9))

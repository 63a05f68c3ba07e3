"""Measurement errors: scale, limits, statistics, and the fold over the zenith."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.models import accuracy
from plotfeed.models.frames import aer_to_enu


def test_range_error_is_equation_13():
    assert accuracy.sigma_range_m(50.0, 10.0) == pytest.approx(10 / 16.3, rel=1e-15)


def test_angle_error_is_bartons():
    assert accuracy.sigma_angle_deg(50.0, 2.0) == pytest.approx(2 / 16, rel=1e-15)


def test_rate_error_is_the_bound_of_a_steady_tone():
    assert accuracy.sigma_rate_m_s(50.0, 0.25) == pytest.approx(0.25 / 18.1380, rel=1e-5)


@pytest.mark.parametrize("sigma", [accuracy.sigma_range_m, accuracy.sigma_angle_deg])
def test_error_falls_with_the_square_root_of_the_signal(sigma):
    snr = 10 ** (np.arange(-60, 61, 20) / 10)
    np.testing.assert_allclose(sigma(snr, 3.0)[1:] * 10, sigma(snr, 3.0)[:-1], rtol=1e-14)
    assert sigma(np.ones((4, 1)), np.ones(3)).shape == (4, 3)


@pytest.mark.parametrize("sigma", [accuracy.sigma_range_m, accuracy.sigma_angle_deg])
def test_limits_of_the_signal(sigma):
    np.testing.assert_array_equal(
        sigma([0.0, np.inf, -1.0, np.nan], 3.0), [np.inf, 0, np.nan, np.nan]
    )


def test_floor_stands_where_the_signal_is_infinite():
    assert accuracy.with_floor(accuracy.sigma_range_m(np.inf, 10.0), 1.5) == 1.5
    np.testing.assert_array_equal(
        accuracy.with_floor([3.0, np.inf, 0.0], [4.0, 1.0, 0.0]), [5, np.inf, 0]
    )


@given(st.floats(-720, 720), st.floats(-269, 269))
def test_folding_keeps_the_direction(azimuth, elevation):
    folded_azimuth, folded_elevation = accuracy.fold_over_zenith(azimuth, elevation)
    assert 0 <= folded_azimuth < 360
    assert -90 <= folded_elevation <= 90
    np.testing.assert_allclose(
        aer_to_enu(folded_azimuth, folded_elevation, 1.0),
        aer_to_enu(azimuth, elevation, 1.0),
        rtol=0,
        atol=1e-13,
    )


@pytest.mark.parametrize(
    ("noisy", "folded"),
    [
        ((10.0, 91.0), (190.0, 89.0)),
        ((350.0, -91.0), (170.0, -89.0)),
        ((360.0, 90.0), (0.0, 90.0)),
        ((-1.0, 30.0), (359.0, 30.0)),
    ],
)
def test_folding_over_the_zenith(noisy, folded):
    np.testing.assert_array_equal(accuracy.fold_over_zenith(*noisy), folded)


def test_folding_leaves_the_undefined_undefined():
    azimuth, elevation = accuracy.fold_over_zenith([np.nan, 5.0], [10.0, np.nan])
    np.testing.assert_array_equal(azimuth, [np.nan, 5.0])
    np.testing.assert_array_equal(elevation, [10.0, np.nan])

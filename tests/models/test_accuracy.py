"""Measurement errors: scale, limits, statistics, and the fold over the zenith."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.significance import Array, assert_standard_normal

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


# Constants of the errors, against signals: apertures and channels with noise, measured at best.


SAMPLES = 64
SNR = 1000.0  # Of all samples of an aperture together: 30 dB
CELL_TO_3_DB = 0.886  # Width at 3 dB of what a uniform aperture resolves, over one over its length


def noise(rng: np.random.Generator, *shape: int) -> Array:
    """Complex and Gaussian, of power 1."""
    return np.asarray(rng.standard_normal((*shape, 2)).view(np.complex128)[..., 0] / np.sqrt(2))


def errors_over_an_aperture(trials: int, rng: np.random.Generator) -> Array:
    """Of the most likely slope of a phase along it, in turns over its length.

    A tone in time, a wave along an antenna and an echo across a band are all this.
    """
    k, true = np.arange(SAMPLES), rng.uniform(-0.5, 0.5, trials)
    signal = np.exp(2j * np.pi * true[:, None] * k / SAMPLES)
    signal = np.sqrt(SNR / SAMPLES) * signal + noise(rng, trials, SAMPLES)
    tried = np.linspace(-1, 1, 401)
    power = np.abs(signal @ np.exp(-2j * np.pi * np.outer(k, tried) / SAMPLES)) ** 2
    row, top = np.arange(trials), power.argmax(axis=1)
    low, mid, high = power[row, top - 1], power[row, top], power[row, top + 1]
    finer = (low - high) / (2 * (low - 2 * mid + high))
    return np.asarray(tried[top] + finer * (tried[1] - tried[0]) - true)


@pytest.mark.parametrize(
    ("sigma", "width"),
    [
        (accuracy.sigma_rate_m_s, 1.0),
        (accuracy.sigma_angle_deg, CELL_TO_3_DB),
        (accuracy.sigma_range_m, CELL_TO_3_DB),
    ],
)
def test_errors_are_those_of_the_best_estimate_of_signals(
    sigma: Callable[[float, float], Array], width: float
) -> None:
    """Rates by whole Doppler cells, angles and ranges by their width at 3 dB; seed 91."""
    errors = errors_over_an_aperture(2000, np.random.default_rng(91))
    assert_standard_normal(errors / sigma(SNR, width), "seed 91")


@pytest.mark.parametrize(("snr", "samples"), [(100.0, 16), (1.0, 1000), (0.2, 5000)])
def test_phases_between_two_channels_err_by_the_noise_of_both(snr: float, samples: int) -> None:
    """A signal as noise, the same in both; strong, as strong as noise, and weaker; seed 92."""
    rng, errors = np.random.default_rng(92), []
    for _ in range(20):
        common = np.sqrt(snr) * noise(rng, 50, samples)
        one, other = (common + noise(rng, 50, samples) for _ in range(2))
        errors.append(np.angle((one * other.conj()).sum(axis=1)))
    sigma = 1 / np.sqrt(accuracy.paired_snr(snr) * samples)
    assert_standard_normal(np.concatenate(errors) / sigma, "seed 92")


def test_a_pair_of_channels_keeps_strong_signals_and_squares_weak_ones() -> None:
    assert accuracy.paired_snr(1e9) == pytest.approx(1e9, rel=1e-9)
    assert accuracy.paired_snr(1e-9) == pytest.approx(2e-18, rel=1e-8)
    np.testing.assert_array_equal(
        accuracy.paired_snr([0.0, np.inf, -1.0, np.nan]), [0, np.inf, np.nan, np.nan]
    )


def test_the_ratio_of_either_channel_is_found_again() -> None:
    snr = 10.0 ** np.arange(-12, 13)
    np.testing.assert_allclose(accuracy.snr_of_pair(accuracy.paired_snr(snr)), snr, rtol=1e-14)

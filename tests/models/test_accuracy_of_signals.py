"""Constants of the errors, against signals: apertures and channels with noise, measured at best."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from support.significance import Array, assert_standard_normal

from plotfeed.models import accuracy

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

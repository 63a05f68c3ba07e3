"""The signal-to-noise ratio and amplitude of the plots that leave as bytes."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from support.radar_equations import BOLTZMANN_J_K, detected_power_cdf, mean_snr
from support.significance import assert_law

from plotfeed.testing import FeedTable, fly, held, radar, scene

# Mean signal-to-noise ratios from 50 dB to 12 dB, about the threshold.
RANGES_M = (2000.0, 7000.0, 11_000.0, 16_000.0, 18_000.0)
RADARS = {
    "few reference cells": radar(pfa=1e-4, n_reference=4),
    "the paper's": radar(pfa=1e-6, n_reference=16),
    "noise as good as known": radar(pfa=1e-6, n_reference=1000),
}
NAMES = pytest.mark.parametrize("name", RADARS)


@cache
def plots_of(name: str) -> FeedTable:
    drones = [
        held(f"{ring}-{i}", 12 * i + ring, 4.0, range_m - 1)
        for ring, range_m in enumerate(RANGES_M)
        for i in range(30)
    ]
    return fly(scene([RADARS[name]], drones, seed=41), 120).plots()


@NAMES
@pytest.mark.parametrize("ring", range(len(RANGES_M)))
def test_power_of_detections_has_the_exact_conditional_law(name: str, ring: int) -> None:
    """Kolmogorov and Smirnov against the closed form of a fluctuating echo that was detected."""
    sensor, plots = RADARS[name], plots_of(name)
    power = 10 ** (plots.rows(np.char.startswith(plots.drone, f"{ring}-")).snr_db / 10)
    snr = float(mean_snr(sensor, RANGES_M[ring] - 1))
    assert_law(power, lambda x: detected_power_cdf(sensor, x, snr))


@NAMES
def test_power_of_false_alarms_has_the_law_of_noise_that_was_detected(name: str) -> None:
    sensor, plots = RADARS[name], plots_of(name)
    alarms = plots.rows(plots.drone == "")
    assert_law(10 ** (alarms.snr_db / 10), lambda x: detected_power_cdf(sensor, x, 0.0))


@NAMES
def test_amplitude_is_noise_power_and_signal(name: str) -> None:
    """Noise of the bandwidth of a range cell, half the speed of light over its length."""
    plots = plots_of(name)
    bandwidth_hz = 299_792_458.0 / (2 * radar()["range_resolution_m"])
    noise_w = BOLTZMANN_J_K * 290 * 10**0.5 * bandwidth_hz
    noise_dbm = 10 * np.log10(noise_w) + 30
    np.testing.assert_allclose(plots.amplitude_dbm - plots.snr_db, noise_dbm, rtol=0, atol=1e-9)


@NAMES
def test_amplitude_in_category_048_is_whole_decibels_that_saturate(name: str) -> None:
    plots = plots_of(name)
    expected = np.clip(np.rint(plots.amplitude_dbm), -128, 127)
    np.testing.assert_array_equal(plots.pam_dbm, expected)

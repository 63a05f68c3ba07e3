"""The active radar by the keys of a scene: what the oracle has of it, and a detection's power.

That is the law of an echo that fluctuates and crossed a cell-averaging threshold.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammainc, gammaincc

from plotfeed.feeds.lab import oracle
from plotfeed.feeds.lab.oracle import BOLTZMANN_J_K, LIGHT_M_S, Floats

__all__ = ["BOLTZMANN_J_K", "LIGHT_M_S"]


def mean_snr(sensor: dict[str, Any], range_m: ArrayLike, rcs_m2: ArrayLike = 0.01) -> Floats:
    """Equation 1, with one range for both ways; no effect beside it counts."""
    gains_db = sensor["gain_tx_dbi"] + sensor["gain_rx_dbi"] - sensor["loss_db"]
    power_w = sensor["power_w"] * sensor["integration_s"]
    law = power_w, gains_db, LIGHT_M_S / sensor["frequency_hz"], np.asarray(rcs_m2)
    echo = oracle.radar_equation(*law, np.square(range_m))
    return echo / oracle.thermal_w_hz(sensor["noise_figure_db"])


def multiplier(sensor: dict[str, Any]) -> float:
    """Equation 7: of the sum of the reference cells."""
    return oracle.cfar_ratio(sensor["pfa"], 1, sensor["n_reference"])


def pd(sensor: dict[str, Any], range_m: ArrayLike, rcs_m2: ArrayLike = 0.01) -> Floats:
    """Equation 6."""
    means = 1 + np.atleast_1d(mean_snr(sensor, range_m, rcs_m2))
    found = oracle.of_unequal(means.reshape(-1, 1), multiplier(sensor), sensor["n_reference"])
    return found.reshape(np.broadcast_shapes(np.shape(range_m), np.shape(rcs_m2)))


def detected_power_cdf(sensor: dict[str, Any], power: ArrayLike, snr: ArrayLike) -> Floats:
    """Probability that a detection's power, in mean noise powers, is at most that.

    The power is exponential of mean 1+S; given that it exceeds its threshold, the threshold is
    gamma distributed of order N and the excess is exponential again; convolved.
    """
    n, alpha, mean = sensor["n_reference"], multiplier(sensor), 1 + np.asarray(snr)
    power = np.asarray(power, dtype=np.float64)
    tilt = 1 + alpha / mean
    above = gammaincc(n, power * tilt / alpha)
    above = above + np.exp(n * np.log(tilt) - power / mean) * gammainc(n, power / alpha)
    return np.asarray(1 - above)


def detected_power_density(sensor: dict[str, Any], power: ArrayLike, snr: ArrayLike) -> Floats:
    """Derivative of the same."""
    n, alpha, mean = sensor["n_reference"], multiplier(sensor), 1 + np.asarray(snr)
    power = np.asarray(power, dtype=np.float64)
    tilt = n * np.log1p(alpha / mean)
    return np.asarray(np.exp(tilt - power / mean) * gammainc(n, power / alpha) / mean)


def sigma_range_m(sensor: dict[str, Any], power: ArrayLike) -> Floats:
    """Equation 13."""
    return np.asarray(sensor["range_resolution_m"] / (1.63 * np.sqrt(2 * np.asarray(power))))

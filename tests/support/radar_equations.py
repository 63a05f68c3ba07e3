"""The active radar's equations, worked out from the numbers of a scene and apart from the models.

They follow the paper's section 3.1.1 in its right form: radar equation, Swerling 1, cell-averaging
CFAR, and the law of a detection's power.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammainc, gammaincc

BOLTZMANN_J_K = 1.380649e-23
LIGHT_M_S = 299_792_458.0

Floats = NDArray[np.float64]


def linear(db: float) -> float:
    return float(10 ** (db / 10))


def mean_snr(sensor: dict[str, Any], range_m: ArrayLike, rcs_m2: ArrayLike = 0.01) -> Floats:
    """Equation 1, with one range for both ways."""
    wavelength_m = LIGHT_M_S / sensor["frequency_hz"]
    gains = linear(sensor["gain_tx_dbi"] + sensor["gain_rx_dbi"] - sensor["loss_db"])
    noise_w_hz = BOLTZMANN_J_K * 290.0 * linear(sensor["noise_figure_db"])
    echo_w = sensor["power_w"] * gains * wavelength_m**2 * np.asarray(rcs_m2)
    echo_w = echo_w / ((4 * np.pi) ** 3 * np.asarray(range_m) ** 4)
    return np.asarray(echo_w * sensor["integration_s"] / noise_w_hz)


def multiplier(sensor: dict[str, Any]) -> float:
    """Equation 7: of the sum of the reference cells."""
    return float(sensor["pfa"] ** (-1 / sensor["n_reference"]) - 1)


def pd(sensor: dict[str, Any], range_m: ArrayLike, rcs_m2: ArrayLike = 0.01) -> Floats:
    """Equation 6."""
    snr = mean_snr(sensor, range_m, rcs_m2)
    return np.asarray((1 + multiplier(sensor) / (1 + snr)) ** -sensor["n_reference"])


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


def sigma_angle_deg(beamwidth_deg: float, power: ArrayLike) -> Floats:
    """Equations 14 and 15 with Barton's constant."""
    return np.asarray(beamwidth_deg / (1.6 * np.sqrt(2 * np.asarray(power))))

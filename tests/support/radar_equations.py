"""Radars by the keys of a scene, as the oracle has them, and laws of detection in closed form.

A detection's power is that of an echo that fluctuates and crossed a cell-averaging threshold. The
MIMO radar's detector is drawn sample by sample besides.
"""

from __future__ import annotations

from fractions import Fraction
from math import prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chndtr, gammainc, gammaincc

from plotfeed.feeds.lab import oracle
from plotfeed.feeds.lab.oracle import BOLTZMANN_J_K, LIGHT_M_S, Floats
from plotfeed.models.numerics import as_floats

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


def joint_hit_gauss_markov(snr: ArrayLike, pfa: ArrayLike, rho: ArrayLike) -> Floats:
    """Chance that two looks both detect, of amplitudes correlated by rho; noise known; (...).

    The two powers are correlated exponentials of mean 1+S: exp(-u) (1 + Q(r b, b) - Q(b, r b)), Q
    of Marcum, u the threshold over that mean, r = rho S/(1+S), b^2 = 2u/(1 - r^2).
    """
    s = as_floats(snr)
    u, r = -np.log(as_floats(pfa)) / (1 + s), as_floats(rho) * s / (1 + s)
    b2 = 2 * u / (1 - r * r)
    both = chndtr(r * r * b2, 2, b2) - chndtr(b2, 2, r * r * b2)
    return as_floats(np.exp(-u) * (1 + both))


def mimo_snrs(sensor: dict[str, Any], enu_m: ArrayLike, rcs_m2: float = 0.01) -> Floats:
    """Equation 17 over equation 21, by transmitter, for a target seen from the receiver."""
    target = np.asarray(enu_m, dtype=np.float64)
    noise_w = oracle.thermal_w_hz(sensor["noise_figure_db"]) / sensor["integration_s"]
    echoes_w = []
    for each in sensor["transmitters"]:
        place = [each[k] for k in ("east_m", "north_m", "above_site_m")]
        gain_db = each.get("gain_tx_dbi", sensor["gain_tx_dbi"]) + sensor["gain_rx_dbi"]
        out_m, back_m = np.linalg.norm(target - place), np.linalg.norm(target)
        law = gain_db - sensor["loss_db"], LIGHT_M_S / sensor["frequency_hz"], rcs_m2
        echoes_w.append(oracle.radar_equation(each["power_w"], *law, out_m * back_m))
    return np.array(echoes_w) / noise_w


def unequal_pd(snrs: ArrayLike, over: float, n_samples: int) -> float:
    """Tail of the hypoexponential law averaged over the threshold; no two ratios may be equal.

    In rational numbers, where differences cost nothing. The sum of exponentials of means m exceeds
    y with probability sum of c exp(-y/m), with the c of partial fractions; over y, the multiplier
    times a gamma variable, each term averages to c (1 + multiplier/m)^-n.
    """
    means = [1 + Fraction(float(s)) for s in np.asarray(snrs)]
    terms = [
        prod(m / (m - other) for other in means if other is not m)
        * (m / (m + Fraction(over))) ** n_samples
        for m in means
    ]
    return float(sum(terms))


def raw_detections(
    snrs: ArrayLike, pfa: float, n_samples: int, trials: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Sums of looks above their thresholds, and these, of trials of the detector; each (hits,).

    Echo and noise are complex Gaussian samples, of the looks and of the reference cells.
    """

    def power(mean: float) -> Floats:
        samples = rng.standard_normal((2, trials)) * np.sqrt(mean / 2)
        return np.asarray((samples**2).sum(axis=0))

    total = np.zeros(trials)
    for snr in np.asarray(snrs, dtype=np.float64):
        total += power(1 + float(snr))
    threshold = np.zeros(trials)
    for _ in range(n_samples):
        threshold += power(1.0)
    threshold *= oracle.cfar_ratio(pfa, len(np.asarray(snrs)), n_samples)
    hit = total > threshold
    return total[hit], threshold[hit]

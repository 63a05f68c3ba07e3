"""The MIMO radar's equations, worked out from the numbers of a scene and apart from the models.

They follow the paper's section 3.1.2 in its right form, each transmitter with its own ratio: in
rational numbers, where differences cost nothing, or by drawing the detector's samples.
"""

from __future__ import annotations

from fractions import Fraction
from math import prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats
from support.radar_equations import BOLTZMANN_J_K, LIGHT_M_S, Floats, linear


def signal_snrs(sensor: dict[str, Any], enu_m: ArrayLike, rcs_m2: float = 0.01) -> Floats:
    """Equation 17 over equation 21, by transmitter, for a target seen from the receiver."""
    target = np.asarray(enu_m, dtype=np.float64)
    wavelength_m = LIGHT_M_S / sensor["frequency_hz"]
    noise_w_hz = BOLTZMANN_J_K * 290.0 * linear(sensor["noise_figure_db"])
    snrs = []
    for transmitter in sensor["transmitters"]:
        place = [transmitter[k] for k in ("east_m", "north_m", "above_site_m")]
        ranges_m2 = np.sum(target**2) * np.sum((target - place) ** 2)
        gain_tx_dbi = transmitter.get("gain_tx_dbi", sensor["gain_tx_dbi"])
        gains = linear(gain_tx_dbi + sensor["gain_rx_dbi"] - sensor["loss_db"])
        echo_w = transmitter["power_w"] * gains * wavelength_m**2 * rcs_m2
        snrs.append(echo_w / ((4 * np.pi) ** 3 * ranges_m2) * sensor["integration_s"] / noise_w_hz)
    return np.array(snrs)


def multiplier(pfa: float, n_looks: int, n_samples: int) -> float:
    """Of the sum of the reference samples: a ratio of gamma variables is an F variable."""
    return float(stats.f.isf(pfa, 2 * n_looks, 2 * n_samples) * n_looks / n_samples)


def pd(snrs: ArrayLike, over: float, n_samples: int) -> float:
    """Tail of the hypoexponential law averaged over the threshold; no two ratios may be equal.

    The sum of exponentials of means m exceeds y with probability sum of c exp(-y/m), with the c of
    partial fractions; over y, the multiplier times a gamma variable, each term averages to
    c (1 + multiplier/m)^-n. `over` is the multiplier.
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
    threshold *= multiplier(pfa, len(np.asarray(snrs)), n_samples)
    hit = total > threshold
    return total[hit], threshold[hit]

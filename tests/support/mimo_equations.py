"""The MIMO radar by the keys of a scene, and its detector drawn sample by sample."""

from __future__ import annotations

from fractions import Fraction
from math import prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.feeds.lab import oracle
from plotfeed.feeds.lab.oracle import LIGHT_M_S, Floats


def signal_snrs(sensor: dict[str, Any], enu_m: ArrayLike, rcs_m2: float = 0.01) -> Floats:
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


def pd(snrs: ArrayLike, over: float, n_samples: int) -> float:
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

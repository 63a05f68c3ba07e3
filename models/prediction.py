"""What a radar's plots should come to, by closed forms and quadrature: to plan and to test by."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import exp1, gammaincinv

from plotfeed.models.active_radar import ActiveRadar
from plotfeed.models.detection import cfar_multiplier
from plotfeed.models.state import Floats

QUADRATURE_POINTS = 128


def inverse_detected_snr(snr: ArrayLike, pfa: float, n_reference: int) -> Floats:
    """Mean of 1/x over the detections of a Swerling 1 target of mean `snr`, x their power; (...).

    Error variances go as 1/x, so this is what turns the mean signal-to-noise ratio into the rms
    error of the plots. Given the threshold t, x is t plus an exponential of mean 1+S, so the mean
    of 1/x is exp(y) E1(y)/(1+S) with y = t/(1+S); t is alpha times a gamma variable of order N
    over (1 + alpha/(1+S)), over which Gauss and Legendre average.
    """
    mean = 1.0 + np.asarray(snr, dtype=np.float64)[..., None]
    alpha = cfar_multiplier(pfa, n_reference)
    nodes, weights = np.polynomial.legendre.leggauss(QUADRATURE_POINTS)
    gamma = gammaincinv(n_reference, (nodes + 1) / 2)
    y = alpha * gamma / (mean + alpha)
    return np.asarray(np.exp(y) * exp1(y) / mean @ (weights / 2))


def rms_errors(radar: ActiveRadar, snr: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Rms error of range (m), azimuth and elevation (degrees) of the plots at a mean SNR; (...)."""
    return radar.sigmas(1.0 / inverse_detected_snr(snr, radar.pfa, radar.n_reference))


def pd_at(radar: ActiveRadar, range_m: ArrayLike, rcs_m2: float) -> Floats:
    """Probability of detection at a range within cover; (...)."""
    ranges = np.asarray(range_m, dtype=np.float64)
    snr = radar.mean_snr(ranges, np.full(ranges.shape, rcs_m2))
    return radar.pd(snr)


def range_of_pd_m(radar: ActiveRadar, pd: float, rcs_m2: float) -> float:
    """The range at which Pd falls to that value, metres, up to the instrumented one.

    From ((1+S)/(1+S+alpha))^N = Pd, and S falling with the fourth power of range.
    """
    root = pd ** (1.0 / radar.n_reference)
    snr_needed = float(cfar_multiplier(radar.pfa, radar.n_reference)) * root / (1 - root) - 1
    snr_at_end = float(radar.mean_snr(np.array(radar.range_max_m), np.array(rcs_m2)))
    if snr_needed <= 0:
        return radar.range_max_m
    return float(min(radar.range_max_m * (snr_at_end / snr_needed) ** 0.25, radar.range_max_m))

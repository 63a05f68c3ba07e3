"""Thresholds, the probability of detection, hits, and the signal-to-noise ratio of a detection.

`snr` is the mean signal-to-noise ratio of one look, linear; `pfa` the probability of false alarm of
one resolution cell, in (0, 1]. Powers are in units of the mean noise power of one look. Targets
fluctuate as Swerling 1 (one look) or 2 (independently from look to look). NaN where an argument
lies outside its domain. A `miss_...` is one less the Pd, accurate where the Pd rounds to one.

The energy detector compares the sum of the powers of as many as 1e9 samples with a known noise
power. Signal and noise are Gaussian: the sum of `n_samples` is a gamma variable times 1+S, and its
Pd is `pd_noncoherent_swerling2`.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models import looks_chain, special
from plotfeed.models.accuracy import paired_snr
from plotfeed.models.gamma_tail import gamma_exceeded_with
from plotfeed.models.numerics import as_floats, nan_without_warnings, unit_interval
from plotfeed.models.state import Bools, Floats

_SMALLEST_SNR = 1e-12
"""What an energy says at least of the signal-to-noise ratio."""


def cfar_multiplier(pfa: ArrayLike, n_reference: ArrayLike) -> Floats:
    """Threshold of a cell-averaging CFAR over the *sum* of its reference cells (eq 6)."""
    if isinstance(pfa, float) and isinstance(n_reference, int):
        return _multiplier_of_one(pfa, n_reference)
    return _multiplier(pfa, n_reference)


@cache
def _multiplier_of_one(pfa: float, n_reference: int) -> Floats:
    """Threshold of a radar, which every look asks for."""
    return _multiplier(pfa, n_reference)


@nan_without_warnings
def _multiplier(pfa: ArrayLike, n_reference: ArrayLike) -> Floats:
    exponent = -np.log(_probability(pfa)) / as_floats(n_reference)
    return as_floats(np.expm1(exponent))  # eq 6 as printed loses digits when N is large


@nan_without_warnings
def pd_cfar_swerling1(snr: ArrayLike, pfa: ArrayLike, n_reference: ArrayLike) -> Floats:
    """Probability of detection, one look, cell-averaging CFAR (eq 7); holds the CFAR loss."""
    return as_floats(np.exp(-_cfar_exponent(snr, pfa, n_reference)))


@nan_without_warnings
def miss_cfar_swerling1(snr: ArrayLike, pfa: ArrayLike, n_reference: ArrayLike) -> Floats:
    """Complement of `pd_cfar_swerling1`."""
    return as_floats(-np.expm1(-_cfar_exponent(snr, pfa, n_reference)))


@nan_without_warnings
def threshold_noncoherent(pfa: ArrayLike, n_looks: ArrayLike) -> Floats:
    """Threshold on the sum of the looks' powers where the noise power is known (eq 22)."""
    return as_floats(special.gammainccinv(n_looks, _probability(pfa)))


@nan_without_warnings
def pd_noncoherent_swerling2(snr: ArrayLike, pfa: ArrayLike, n_looks: ArrayLike) -> Floats:
    """Probability of detection, sum of looks of equal SNR, noise known (eq 23, right form)."""
    threshold = threshold_noncoherent(pfa, n_looks)
    return as_floats(special.gammaincc(n_looks, threshold / (1 + _power(snr))))


@nan_without_warnings
def miss_noncoherent_swerling2(snr: ArrayLike, pfa: ArrayLike, n_looks: ArrayLike) -> Floats:
    """Complement of `pd_noncoherent_swerling2`."""
    threshold = threshold_noncoherent(pfa, n_looks)
    return as_floats(special.gammainc(n_looks, threshold / (1 + _power(snr))))


@nan_without_warnings
def threshold_noncoherent_cfar(
    pfa: ArrayLike, n_looks: ArrayLike, n_reference: ArrayLike
) -> Floats:
    """Threshold on the looks' sum over the sum of `n_reference` samples, those of all looks."""
    # The ratio of the sums is a ratio of two shares of one beta variable; each share from its own
    # inverse, for neither is good as one less the other.
    probability = _probability(pfa)
    test_share = special.betainccinv(n_looks, n_reference, probability)
    reference_share = special.betaincinv(n_reference, n_looks, probability)
    return as_floats(test_share / reference_share)


@nan_without_warnings
def pd_noncoherent_cfar(
    snr: ArrayLike, pfa: ArrayLike, n_looks: ArrayLike, n_reference: ArrayLike
) -> Floats:
    """Probability of detection of the sum of looks against the sum of reference samples.

    Exact, CFAR loss included, for looks of equal SNR; `n_reference` counts the samples of all the
    looks together.
    """
    test, reference = _cfar_shares(snr, pfa, n_looks, n_reference)
    by_test = special.betaincc(n_looks, n_reference, test)
    by_reference = special.betainc(n_reference, n_looks, reference)
    return as_floats(np.where(test < reference, by_test, by_reference))


@nan_without_warnings
def pd_noncoherent_unequal(snrs: ArrayLike, pfa: ArrayLike) -> Floats:
    """Probability of detection, sum of looks of any SNRs, noise known; (..., K) in, (...) out.

    The tail of the hypoexponential distribution, in place of eq 18's mean; `pfa` broadcasts
    against the leading axes.

    By uniformisation of the phase-type distribution, at the rate of the noise: exponential power
    of mean 1+S is a chain of unit exponentials that ends after each one with probability 1/(1+S),
    so the sum crosses y when the chain through all looks outlasts a Poisson number of mean y of
    them. Every term is positive: ties and extreme ratios cost no digits.
    """
    power = _power(snrs)
    ends, goes_on = 1 / (1 + power), 1 / (1 + 1 / power)
    threshold = threshold_noncoherent(pfa, power.shape[-1])
    phase = np.zeros_like(power)  # the probability of being at each look after n steps
    phase[..., 0] = 1.0
    finished = np.zeros(power.shape[:-1])
    pd = np.zeros(np.broadcast_shapes(finished.shape, threshold.shape))
    miss = np.zeros_like(pd)
    for n in range(_poisson_terms(threshold)):
        weight = np.exp(special.xlogy(n, threshold) - threshold - special.gammaln(n + 1))
        pd = pd + weight * phase.sum(axis=-1)
        miss = miss + weight * finished
        leaving = phase * ends
        phase = phase * goes_on
        phase[..., 1:] += leaving[..., :-1]
        finished = finished + leaving[..., -1]
    return np.where(miss < pd, 1 - miss, pd)  # the smaller one has all its digits


@nan_without_warnings
def pd_noncoherent_unequal_cfar(snrs: ArrayLike, pfa: ArrayLike, n_reference_total: int) -> Floats:
    """Probability of detection of the sum of looks of any SNRs against a sum of reference samples.

    Exact, CFAR loss included; (..., K) in, (...) out. `n_reference_total` counts the samples of all
    the looks together; `pfa` broadcasts against the leading axes.
    """
    power, ratio = _unequal_cfar(snrs, pfa, n_reference_total)
    # Rounding may carry a certainty above one.
    return np.minimum(looks_chain.outlasting(power, ratio, n_reference_total), 1.0)


@nan_without_warnings
def pd_logistic(
    snr_db: ArrayLike, sensitivity_db: ArrayLike, slope_per_db: ArrayLike = 1.0
) -> Floats:
    """Probability of detection by a listener of that sensitivity (eq 43, in dB throughout)."""
    margin_db = as_floats(snr_db) - as_floats(sensitivity_db)
    return as_floats(special.expit(margin_db * as_floats(slope_per_db)))


def draw_hits(pd: ArrayLike, rng: np.random.Generator) -> Bools:
    """Whether each is detected (eq 8); an undefined probability never hits."""
    probability = as_floats(pd)
    return np.asarray(rng.random(probability.shape) < probability)


@nan_without_warnings
def draw_detected_snr_swerling1(
    snr: ArrayLike, pfa: ArrayLike, n_reference: ArrayLike, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """The powers of cells that were detected, and the thresholds they crossed; broadcast shape.

    The exact joint law, given the hit, of a Swerling 1 cell of mean `snr` (0 for a false alarm)
    and of its cell-averaging threshold: a cell exceeds threshold t with probability
    exp(-t/(1+S)), which tilts the reference sum's gamma density into a narrower one, and the
    excess over the threshold has no memory.
    """
    mean = 1 + _power(snr)
    alpha = cfar_multiplier(pfa, n_reference)
    shape = np.broadcast(mean, alpha).shape
    order = n_reference if isinstance(n_reference, int) else as_floats(n_reference)
    reference_sum = rng.standard_gamma(order, shape) / (1 + alpha / mean)
    threshold = alpha * reference_sum
    return as_floats(threshold + mean * rng.standard_exponential(shape)), as_floats(threshold)


@nan_without_warnings
def inverse_detected_snr(snr: ArrayLike, pfa: float, n_reference: int) -> Floats:
    """Mean of 1/x over the detections of a Swerling 1 target of mean `snr`, x their power; (...).

    Error variances go as 1/x, so this is what turns the mean signal-to-noise ratio into the rms
    error of the plots. Given the threshold t, x is t plus an exponential of mean 1+S, so the mean
    of 1/x is exp(y) E1(y)/(1+S) with y = t/(1+S); t is alpha times a gamma variable of order N
    over (1 + alpha/(1+S)), over which Gauss and Legendre average.
    """
    mean = 1.0 + as_floats(snr)[..., None]
    alpha = cfar_multiplier(pfa, n_reference)
    nodes, weights = unit_interval()
    gamma = special.gammaincinv(n_reference, nodes)
    y = alpha * gamma / (mean + alpha)
    return np.asarray(np.exp(y) * special.exp1(y) / mean @ weights)


@nan_without_warnings
def draw_detected_power_noncoherent(
    snrs: ArrayLike, pfa: float, n_reference_total: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """The sums of the looks of cells that were detected, and the thresholds; (n, K) in, (n,) out.

    The exact joint law given the hit, of looks of mean `snrs` (0 for a false alarm) and of the sum
    of their reference samples.
    """
    power, ratio = _unequal_cfar(snrs, pfa, n_reference_total)
    power_sum, reference_sum = looks_chain.draw_outlasting(
        power, float(ratio), n_reference_total, rng
    )
    return power_sum, as_floats(ratio * reference_sum)


@nan_without_warnings
def inverse_detected_power_noncoherent(
    snrs: ArrayLike, pfa: ArrayLike, n_reference_total: int
) -> Floats:
    """Mean of 1/x over detections, x the sum of looks of mean `snrs`; (..., K) in, (...) out.

    A quadrature of the exact law, good to 1e-8: what turns mean signal-to-noise ratios into the
    rms error of the plots.
    """
    power, ratio = _unequal_cfar(snrs, pfa, n_reference_total)
    return looks_chain.mean_inverse(power, ratio, n_reference_total)


@nan_without_warnings
def draw_detected_energy(
    snr: ArrayLike, pfa: ArrayLike, n_samples: float, rng: np.random.Generator
) -> Floats:
    """Energies that crossed the threshold: the exact law given the hit; broadcast shape.

    S = 0 makes false alarms.
    """
    shape = np.broadcast_shapes(np.shape(snr), np.shape(pfa))
    return _energy_exceeded_by(1 - rng.random(shape), snr, pfa, n_samples)


@nan_without_warnings
def estimated_snr(energy: ArrayLike, n_samples: ArrayLike) -> Floats:
    """What an energy says of the signal-to-noise ratio: always above zero."""
    return as_floats(np.maximum(as_floats(energy) / as_floats(n_samples) - 1, _SMALLEST_SNR))


@nan_without_warnings
def inverse_paired_snr(snr: ArrayLike, pfa: float, n_samples: float) -> Floats:
    """Mean, over the detections, of one over the `paired_snr` of the estimated SNR.

    (...) in, (...) out. Variances of phases between two channels go as that. Gauss and Legendre
    average over the tail, whose dense end, just above the threshold, gets most of the points.
    """
    root, weights = unit_interval()
    mean_snr = as_floats(snr)[..., None]
    energy = _energy_exceeded_by(1 - root**3, mean_snr, pfa, n_samples)
    paired = paired_snr(estimated_snr(energy, n_samples))
    return as_floats(1 / paired @ (3 * root**2 * weights))


def _unequal_cfar(snrs: ArrayLike, pfa: ArrayLike, n_reference_total: int) -> tuple[Floats, Floats]:
    """The looks, and the threshold over the reference sum, which broadcasts against (...)."""
    power = _power(snrs)
    ratio = threshold_noncoherent_cfar(pfa, power.shape[-1], n_reference_total)
    return power, ratio


def _cfar_exponent(snr: ArrayLike, pfa: ArrayLike, n_reference: ArrayLike) -> Floats:
    """Minus the logarithm of eq 7."""
    alpha = cfar_multiplier(pfa, n_reference)
    n = as_floats(n_reference)
    return as_floats(n * np.log1p(alpha / (1 + _power(snr))))


def _cfar_shares(
    snr: ArrayLike, pfa: ArrayLike, n_looks: ArrayLike, n_reference: ArrayLike
) -> tuple[Floats, Floats]:
    """What the test and the reference sum have of both at the threshold, each over its own mean.

    They add to one; both, because only the smaller keeps its digits.
    """
    ratio = threshold_noncoherent_cfar(pfa, n_looks, n_reference) / (1 + _power(snr))
    return 1 / (1 + 1 / ratio), 1 / (1 + ratio)


def _poisson_terms(mean: Floats) -> int:
    """How many terms leave less than 1e-20 of any of these Poisson distributions."""
    largest = float(np.max(mean, initial=0.0, where=np.isfinite(mean)))
    return int(largest + 9.0 * largest**0.5 + 30.0)


def _power(snr: ArrayLike) -> Floats:
    """A linear ratio; NaN below zero."""
    ratio = as_floats(snr)
    return np.where(ratio >= 0, ratio, np.nan)


def _probability(pfa: ArrayLike) -> Floats:
    """A probability of false alarm; NaN outside (0, 1]."""
    probability = as_floats(pfa)
    return np.where((probability > 0) & (probability <= 1), probability, np.nan)


def _energy_exceeded_by(share: Floats, snr: ArrayLike, pfa: ArrayLike, n_samples: float) -> Floats:
    """The energy that this share of the detections exceeds; rounding may not undo a detection."""
    tail = pd_noncoherent_swerling2(snr, pfa, n_samples)
    energy = (1 + as_floats(snr)) * gamma_exceeded_with(share * tail, n_samples)
    return as_floats(np.maximum(energy, threshold_noncoherent(pfa, n_samples)))

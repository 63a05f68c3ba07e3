"""Thresholds, the probability of detection, hits, and the signal-to-noise ratio of a detection.

`snr` is the mean signal-to-noise ratio of one look, linear; `pfa` the probability of false alarm of
one resolution cell, in (0, 1]. Powers are in units of the mean noise power of one look. Targets
fluctuate as Swerling 1 (one look) or 2 (independently from look to look). NaN where an argument
lies outside its domain.

The energy detector compares the sum of the powers of as many as 1e9 samples with a known noise
power. Signal and noise are Gaussian: the sum of `n_samples` is a gamma variable times 1+S, and its
Pd is `pd_noncoherent_swerling2`.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache, lru_cache
from math import ceil, floor

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models import special
from plotfeed.models.accuracy import paired_snr
from plotfeed.models.numerics import as_floats, nan_without_warnings, unit_interval
from plotfeed.models.state import Bools, Floats, Ints

# What a gamma variable exceeds with a given probability, a hundred nanoseconds a value at most.
#
# The logarithm of that is a smooth function of the normal deviate that is exceeded with the same
# probability: nearly a straight line for large orders. It is tabulated as polynomials on pieces
# of the deviates, once for an order, through SciPy's values at Chebyshev's points. Relative to
# these the error is below 1e-13. Of orders above 1e5 its own are off by up to a tenth of a
# standard deviation where less than 4e-6 lies below.
# Deviates that are exceeded with a probability of 1 - 1e-16, which is 1, and with 5e-308.
LOWEST, HIGHEST = -8.25, 37.5
PIECES = 8  # Pieces in one standard deviation
DEGREE = 6


@nan_without_warnings
def gamma_exceeded_with(probability: Floats, order: float) -> Floats:
    """Values that a gamma variable of that order exceeds with those probabilities; (n,)."""
    place = (special.ndtri(probability) + LOWEST) * -PIECES
    coefficients = _log_pieces(float(order))
    tabulated = (place >= 0) & (place < len(coefficients))
    if not tabulated.all():
        value = as_floats(special.gammainccinv(order, probability))
        if tabulated.any():
            value[tabulated] = gamma_exceeded_with(probability[tabulated], order)
        return value
    piece = place.astype(np.intp)
    place -= piece
    of_piece = coefficients.take(piece, axis=0)
    log_share = of_piece[..., DEGREE] * place
    for k in range(DEGREE - 1, 0, -1):
        log_share += of_piece[..., k]
        log_share *= place
    log_share += of_piece[..., 0]
    return np.asarray(order * np.exp(log_share))


@lru_cache(maxsize=16)
def _log_pieces(order: float) -> Floats:
    """Coefficients of powers of the place in a piece, 0 to 1; (pieces, DEGREE + 1)."""
    at = (1 - np.cos(np.pi * (np.arange(DEGREE + 1) + 0.5) / (DEGREE + 1))) / 2
    starts = np.arange(round((HIGHEST - LOWEST) * PIECES))
    deviate = LOWEST + (starts[:, None] + at) / PIECES
    lower = deviate < 0
    value = np.where(
        lower,
        special.gammaincinv(order, special.ndtr(deviate)),
        special.gammainccinv(order, special.ndtr(-deviate)),
    )
    powers = np.vander(at, increasing=True)
    return np.ascontiguousarray(np.linalg.solve(powers, np.log(value / order).T).T)


# Sums of looks of any signal-to-noise ratios against a sum of reference samples, exactly.
#
# The reference samples, unit exponentials, are laid end to end: `multiplier` times as long, they
# are the threshold. The looks' powers, exponentials of mean 1+S, are laid beside them in their
# order. While a look lasts, what ends next is the look, with probability
# multiplier/(multiplier+1+S), or a reference sample: exponentials have no memory. The sum of the
# looks exceeds the threshold when the looks outlast all samples.
#
# This is the uniformised chain of the phase-type distribution with its sum over the number of
# steps, which is negative-binomial, done in closed form: nothing is truncated, and every
# probability is a sum of products of positive numbers, so that ties, extreme ratios and tiny
# probabilities keep their digits. The relative error is some (samples + looks) times that of
# float64.
#
# `snrs` is (..., K), looks on the last axis, at least zero; `multiplier` broadcasts against
# (...).
BLOCK_ELEMENTS = 1 << 15  # Numbers of a table that are worked on at once: 256 kB
KEPT_ELEMENTS = 1 << 22  # Size of the tables that are kept for a draw: 32 MB
CERTAIN = 1 - 1e-12  # What a probability is taken to be at least of, whatever rounding has done
_TAIL = 36.0  # Means of an exponential beyond which 2e-16 of it lies


def _chance(snrs: Floats, multiplier: Floats, n_samples: int, *, at_the_end: ArrayLike) -> Floats:
    """Chance of what has those after the last sample within each look, (K,), else none; (...).

    Carried back sample by sample to the start of the first look.
    """
    ends, goes_on = _odds(snrs, multiplier)
    chances = np.empty(ends.shape[1:], ends.dtype)
    n_looks, rows = len(ends), chances.size
    flat, ends, goes_on = (
        chances.reshape(-1),
        ends.reshape(n_looks, -1),
        goes_on.reshape(n_looks, -1),
    )
    for part in _blocks(rows, n_looks):
        of_part = ends[:, part], goes_on[:, part]
        chance = np.empty_like(of_part[0])
        chance.T[...] = at_the_end
        back = _Backwards(chance, *of_part)
        for _ in range(n_samples):
            back.step()
        flat[part] = chance[0]
    return chances


class _Outlasting:
    """How many samples each look outlasts, given that all looks outlast all of them."""

    def __init__(self, ends: Floats, goes_on: Floats, n_samples: int) -> None:
        self._ends = ends
        self._goes_on = goes_on
        self._n_samples = n_samples
        self._kept: Floats | None = None
        self._place = np.full(ends.shape[1], -1)

    def draw(self, look: int, level: Floats, samples_left: Ints) -> Ints:
        """How many of the samples left a look outlasts; (n,), by inversion from uniform levels.

        That of a strong look nearly always outlasts them all: as it does by itself with probability
        goes_on**samples_left, given the success it does at least with that.
        """
        outlasted = samples_left.copy()
        surely = level < self._goes_on[look] ** samples_left * CERTAIN
        doubtful = np.flatnonzero(~surely & (samples_left > 0))
        for part in _blocks(len(doubtful), self._n_samples + 1):
            rows = doubtful[part]
            outlasted[rows] = _inverted(
                level[rows],
                self._chances(look, rows, doubtful),
                self._goes_on[look, rows],
                samples_left[rows],
            )
        return outlasted

    def _chances(self, look: int, rows: Ints, doubtful: Ints) -> Floats:
        """Chances of success from a look on with 0, 1, ... samples left; (samples + 1, n).

        All looks of a row are worked out at once and kept, as far as there is room: whatever is in
        doubt later is so at the first look.
        """
        if self._kept is None:
            n_looks = len(self._ends) - 1
            some = doubtful[: KEPT_ELEMENTS // (n_looks * (self._n_samples + 1))]
            self._place[some] = np.arange(len(some))
            self._kept = np.empty((n_looks, self._n_samples + 1, len(some)))
            for part in _blocks(len(some), len(self._ends)):
                _fill(
                    self._kept[:, :, part], self._ends[:, some[part]], self._goes_on[:, some[part]]
                )
        place = self._place[rows]
        if (place >= 0).all():
            return np.asarray(self._kept[look][:, place])
        table = np.empty((1, self._n_samples + 1, len(rows)))
        _fill(table, self._ends[look:, rows], self._goes_on[look:, rows])
        return np.asarray(table[0])


def _fill(table: Floats, ends: Floats, goes_on: Floats) -> None:
    """Write chances of success from each look on, by samples left; (looks, samples + 1, n)."""
    chance = np.ones_like(ends)
    back = _Backwards(chance, ends, goes_on)
    table[:, 0] = 1.0
    for n in range(1, table.shape[1]):
        back.step()
        table[:, n] = chance[: len(table)]


def _inverted(level: Floats, chances: Floats, goes_on: Floats, samples_left: Ints) -> Ints:
    """How many of the samples left a look of those chances outlasts; (n,).

    Outlasting one more sample and then succeeding becomes less probable with each.
    """
    left = np.arange(len(chances))[:, None]
    at_least = chances / goes_on**left  # with so many left, over what no longer depends on it
    above = level * np.take_along_axis(at_least, samples_left[None], 0)[0]
    return np.asarray(((at_least > above) & (left < samples_left)).sum(axis=0))


def _odds(snrs: Floats, multiplier: Floats) -> tuple[Floats, Floats]:
    """Odds of the look ending first, and of the sample; (K, ...), looks first."""
    shape = np.broadcast_shapes(snrs.shape[:-1], multiplier.shape)
    looks_first = np.moveaxis(np.broadcast_to(snrs, (*shape, snrs.shape[-1])), -1, 0)
    mean = np.add(looks_first, 1, order="C")
    share = multiplier / mean
    return 1 / (1 + 1 / share), 1 / (1 + share)


class _Backwards:
    """Chances within each look, (K, n), that are turned to those of one sample before, in place."""

    def __init__(self, chance: Floats, ends: Floats, goes_on: Floats) -> None:
        self._chance = chance
        self._goes_on = goes_on
        self._looks = [(chance[i], ends[i], chance[i + 1]) for i in range(len(chance) - 2, -1, -1)]
        self._product = np.empty(chance.shape[1:], chance.dtype)

    def step(self) -> None:
        """One sample back."""
        product = self._product
        np.multiply(self._chance, self._goes_on, out=self._chance)
        for own, ends, following in self._looks:
            np.multiply(ends, following, out=product)
            np.add(own, product, out=own)


def _blocks(rows: int, each: int) -> Iterator[slice]:
    """Parts of rows, of which each takes so many numbers, that stay near the processor."""
    block = max(1, BLOCK_ELEMENTS // each)
    return (slice(start, start + block) for start in range(0, rows, block))


_SMALLEST_SNR = 1e-12  # What an energy says at least of the signal-to-noise ratio


def cfar_multiplier(pfa: ArrayLike, n_reference: ArrayLike) -> Floats:
    """Threshold of a cell-averaging CFAR over the *sum* of its reference cells (eq 6)."""
    if isinstance(pfa, float) and isinstance(n_reference, int):
        return _multiplier_of_one(pfa, n_reference)
    return _multiplier(pfa, n_reference)


@nan_without_warnings
def _multiplier(pfa: ArrayLike, n_reference: ArrayLike) -> Floats:
    exponent = -np.log(_probability(pfa)) / as_floats(n_reference)
    return as_floats(np.expm1(exponent))  # eq 6 as printed loses digits when N is large


_multiplier_of_one = cache(_multiplier)  # Of a radar, which every look asks for


@nan_without_warnings
def pd_cfar_swerling1(snr: ArrayLike, pfa: ArrayLike, n_reference: ArrayLike) -> Floats:
    """Probability of detection, one look, cell-averaging CFAR (eq 7); holds the CFAR loss."""
    n = as_floats(n_reference)
    return as_floats(np.exp(-n * np.log1p(cfar_multiplier(pfa, n_reference) / (1 + _power(snr)))))


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
def pd_noncoherent_unequal_cfar(snrs: ArrayLike, pfa: ArrayLike, n_reference_total: int) -> Floats:
    """Probability of detection of the sum of looks of any SNRs against a sum of reference samples.

    Exact, CFAR loss included; (..., K) in, (...) out. `n_reference_total` counts the samples of all
    the looks together; `pfa` broadcasts against the leading axes.
    """
    power, ratio = _unequal_cfar(snrs, pfa, n_reference_total)
    # Rounding may carry a certainty above one.
    return np.minimum(_chance(power, ratio, n_reference_total, at_the_end=1.0), 1.0)


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
    of their reference samples. Look by look: how many samples it outlasts given the success, and
    then the times. Whatever ends first, the time until then is exponential of mean
    (1+S)/(multiplier+1+S), in units of the samples, so that times are gamma distributed by the
    number of ends. Without memory, the look that lasts at the end is from there on as long as a new
    one.
    """
    power, ratio = _unequal_cfar(snrs, pfa, n_reference_total)
    n = len(power)
    ends, goes_on = _odds(power, ratio)
    outlasting_them = _Outlasting(ends, goes_on, n_reference_total)
    samples_left = np.full(n, n_reference_total)
    reference_sum, beyond = np.zeros(n), np.zeros(n)
    for i, mean in enumerate(1 + power.T):
        outlasted = samples_left
        if i < len(ends) - 1:
            outlasted = outlasting_them.draw(i, rng.random((n,)), samples_left)
        own_end = outlasted < samples_left
        reference_sum += goes_on[i] * rng.standard_gamma(outlasted + own_end, (n,))
        samples_left = samples_left - outlasted
        rest = mean * rng.standard_exponential((n,))
        beyond += np.where(samples_left == 0, rest, 0.0)
    threshold = ratio * reference_sum
    return threshold + beyond, threshold


@nan_without_warnings
def inverse_detected_power_noncoherent(
    snrs: ArrayLike, pfa: ArrayLike, n_reference_total: int
) -> Floats:
    """Mean of 1/x over detections, x the sum of looks of mean `snrs`; (..., K) in, (...) out.

    What turns mean signal-to-noise ratios, which are finite, into the rms error of the plots. At x,
    the sum has the density of the last look lasting there, over 1+S. For a reference sum g and
    x = y g, the mean of 1/x is the integral of that density over the logarithm of y, from the
    threshold's ratio on; its average over g is a chance of the chain. Gauss and Legendre integrate,
    to less than 1e-8.
    """
    power, ratio = _unequal_cfar(snrs, pfa, n_reference_total)
    n_looks = power.shape[-1]
    in_last_look = np.zeros(n_looks)
    in_last_look[-1] = 1.0
    # The tail falls exponentially where samples are many, as y to minus their number where few.
    largest = (1 + power.max(axis=-1)) * (n_looks + _TAIL) / n_reference_total
    low = np.log(ratio)
    width = np.log(np.maximum(largest, ratio)) + _TAIL / n_reference_total - low
    nodes, weights = unit_interval()
    integral = np.zeros(width.shape)
    for node, weight in zip(nodes, weights, strict=True):
        y = np.exp(low + width * node)
        lasting = _chance(power, y, n_reference_total, at_the_end=in_last_look)
        integral += weight * width * lasting
    chance = _chance(power, ratio, n_reference_total, at_the_end=1.0)
    return np.asarray(integral / (1 + power[..., -1]) / chance)


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


# Pfa below which a Poisson draw is nearer to the binomial than 1 - Pfa in float64 allows.
POISSON_BELOW_PFA = 1e-8
_ROUNDING = 4e-15  # By which a quotient may exceed a whole number that it is


def cells_across(cover: float, width: float) -> float:
    """How many cells of that width cover holds; a beam wider than all of it is one."""
    return max(cover / width, 1.0)


def whole_cells(cells: float, pfa: float) -> tuple[int, float]:
    """Whole cells, and their Pfa, that alarm as often on average as those: the next number up."""
    whole = ceil(cells * (1 - _ROUNDING))
    return (whole, pfa * min(cells / whole, 1.0)) if whole else (0, pfa)


def draw_count(cells: int, pfa: float, rng: np.random.Generator) -> int:
    """How many false alarms: binomial, for any number of cells and however small a Pfa."""
    rare = pfa < POISSON_BELOW_PFA
    return int(rng.poisson(cells * pfa) if rare else rng.binomial(cells, pfa))


def cells_between(total_cells: int, start_fraction: float, end_fraction: float) -> int:
    """Cells of a sector of a scan, of its share [start, end) of the cover.

    Sectors that meet share no cell and leave none out: those of a scan sum to its cells exactly.
    """
    return _cells_before(total_cells, end_fraction) - _cells_before(total_cells, start_fraction)


def _cells_before(total_cells: int, fraction: float) -> int:
    """The nearest whole number of cells.

    A hair off one half, where equal sectors put their borders: two roundings of the same border
    must not come out on different sides.
    """
    return floor(total_cells * fraction + 0.500001)

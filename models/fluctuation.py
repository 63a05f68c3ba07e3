"""Detection of targets that fluctuate as Swerling 0 to 4, by one series of positive terms.

The power of n looks at a target whose strength is a gamma variable of order kappa is a mixture of
gamma variables of orders n + k, by weights w_k that are negative binomial: orders infinity, 1, n,
2 and 2 n are cases 0 to 4 (infinity: Poisson's weights). No term is taken from another, so that
nothing is lost for weak echoes and many looks, where the closed forms of DiFranco and Rubin lose
all digits. Other orders are as good. Detection compares the sum of the looks' powers with that of
`n_reference` samples of noise, as in `detection`.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plotfeed.models import special
from plotfeed.models.detection import (
    draw_detected_snr_swerling1,
    inverse_detected_snr,
    pd_cfar_swerling1,
    threshold_noncoherent_cfar,
)
from plotfeed.models.numerics import as_floats, nan_without_warnings, unit_interval
from plotfeed.models.state import Bools, Floats

STEADY = np.inf  # The order of a target that does not fluctuate, Swerling 0
LONG_TAIL = 60.0  # Terms beyond the last that matters
SURE = 12.0  # Standard deviations beyond which nothing is left
NODES = 96
CORRECTIONS = 6
AT_ONCE = 1 << 18  # Weights that are held at once


def order_of(case: int, n_looks: int) -> float:
    """The order of the gamma law by which a target of Swerling's case fluctuates over looks."""
    return (STEADY, 1.0, float(n_looks), 2.0, 2.0 * n_looks)[case]


class _Terms(NamedTuple):
    """Chances that sums of orders n + k cross the threshold, k = 0, 1, ...: beyond the last, 1."""

    hit: Floats
    share: float
    """Of the reference samples in all power, at the threshold."""


@lru_cache(maxsize=256)
def _terms_of_cfar(pfa: float, n_looks: int, n_reference: int) -> _Terms:
    ratio = float(threshold_noncoherent_cfar(pfa, n_looks, n_reference))
    share = float(special.betaincinv(n_reference, n_looks, pfa))
    most = ratio * (n_reference + SURE * n_reference**0.5 + LONG_TAIL) + LONG_TAIL
    orders = n_looks + np.arange(int(most) + 1)
    return _Terms(special.betainc(n_reference, orders, share), share)


def _log_weights(total: Floats, order: float, k: Floats) -> Floats:
    """Logarithms of the weights at numbers k, (K,) or (n, K), of ratios summed over looks, (n,)."""
    total = total[:, None]
    if order == STEADY:
        return np.asarray(special.xlogy(k, total) - total - special.gammaln(k + 1))
    mean = total / order
    with np.errstate(divide="ignore"):
        kept = np.where(k > 0, -k * np.log1p(1 / mean), 0.0)
    counted = special.gammaln(order + k) - special.gammaln(order) - special.gammaln(k + 1)
    return np.asarray(counted + kept - order * np.log1p(mean))


def _beyond(total: Floats, order: float, last: int) -> Floats:
    """Weights beyond the last, summed."""
    if order == STEADY:
        return np.asarray(special.pdtrc(last, total))
    mean = total / order
    return np.asarray(special.betainc(last + 1, order, 1 / (1 + 1 / mean)))


def _is_beyond(total: Floats, order: float, terms: _Terms) -> NDArray[np.bool_]:
    """Whether numbers are beyond the last term, for certain: of strong echoes that are steady.

    Poisson's law leaves e^-(m - k - k ln(m/k)) below k of a mean m: at four times it, 1e-60.
    """
    return np.asarray((order == STEADY) & (total > 4 * len(terms.hit)))


def _pd(total: Floats, order: float, terms: _Terms) -> Floats:
    """Probability of detection, (n,): 1 of those that are beyond the terms."""
    k = np.arange(len(terms.hit), dtype=np.float64)
    pd = np.ones(len(total))
    within = np.flatnonzero(~_is_beyond(total, order, terms))
    step = max(AT_ONCE // len(k), 1)
    for a in range(0, len(within), step):
        rows = within[a : a + step]
        pd[rows] = np.exp(_log_weights(total[rows], order, k)) @ terms.hit
    pd[within] += _beyond(total[within], order, len(k) - 1)
    return np.minimum(pd, 1.0)


def _total(snr: ArrayLike, n_looks: int) -> Floats:
    ratio = as_floats(snr) * n_looks
    return np.where(ratio >= 0, ratio, np.nan)


@nan_without_warnings
def pd_fluctuating_cfar(
    snr: ArrayLike, pfa: float, n_looks: int, n_reference: int, order: float
) -> Floats:
    """Probability of detection of a sum of looks against a sum of reference samples; (...)."""
    total = _total(snr, n_looks)
    terms = _terms_of_cfar(pfa, n_looks, n_reference)
    return _pd(total.ravel(), order, terms).reshape(total.shape)


def _detected(cfar: FluctuatingCfar, snr: Floats, order: float, u: Floats) -> tuple[Floats, Floats]:
    """Sums and thresholds of detections by uniform numbers, (3, n).

    The exact joint law given the hit: the number k by its weight and chance, the share of the
    reference samples in all power below that at the threshold, and all power, a gamma variable.
    """
    _, n_looks, n_reference = cfar
    terms = _terms_of_cfar(*cfar)
    total = _total(snr, n_looks)
    k = _numbers(total, order, terms, u[0])
    chance = special.betainc(n_reference, n_looks + k, terms.share)
    reference = special.betaincinv(n_reference, n_looks + k, np.maximum(u[1], 1e-300) * chance)
    power = special.gammaincinv(n_looks + k + n_reference, u[2])
    ratio = 1 / terms.share - 1
    threshold = ratio * reference * power
    return np.maximum((1 - reference) * power, threshold), threshold


def _poisson(mean: Floats, u: Floats) -> Floats:
    """Poisson numbers of means beyond a hundred, by uniform ones; (n,).

    The nearest of Cornish and Fisher's expansion, put right by the distribution function.
    """
    z = special.ndtri(np.maximum(u, 1e-300))
    k = np.maximum(np.floor(mean + z * np.sqrt(mean) + (z * z - 1) / 6), 0.0)
    for _ in range(CORRECTIONS):
        step = (special.pdtr(k, mean) < u).astype(np.float64) - (special.pdtr(k - 1, mean) >= u)
        if not step.any():
            return np.asarray(k)
        k = np.maximum(k + step, 0.0)
    return np.asarray(np.ceil(special.pdtrik(u, mean)))


def _numbers(total: Floats, order: float, terms: _Terms, u: Floats) -> Floats:
    """Numbers k given the hit, by uniform ones; (n,)."""
    beyond_all = _is_beyond(total, order, terms)
    if beyond_all.any():
        found = _poisson(total, u)
        within = np.flatnonzero(~beyond_all)
        found[within] = _numbers(total[within], order, terms, u[within])
        return np.asarray(found)
    k = np.arange(len(terms.hit), dtype=np.float64)
    found = np.empty(len(total))
    step = max(AT_ONCE // len(k), 1)
    for a in range(0, len(total), step):
        part = total[a : a + step]
        cumulated = np.cumsum(np.exp(_log_weights(part, order, k)) * terms.hit, axis=1)
        beyond = _beyond(part, order, len(k) - 1)
        wanted = u[a : a + step] * (cumulated[:, -1] + beyond)
        found[a : a + step] = (cumulated < wanted[:, None]).sum(axis=1)
        far = np.flatnonzero(wanted > cumulated[:, -1])
        if len(far):
            # There every echo crosses the threshold: the law of k alone, from the last on.
            below = 1 - (cumulated[far, -1] + beyond[far] - wanted[far])
            mean = part[far] / order
            if order == STEADY:
                numbers = special.pdtrik(below, part[far])
            else:
                numbers = special.nbdtrik(below, order, 1 / (1 + mean))
            found[a : a + step][far] = np.maximum(np.ceil(numbers), len(k))
    return found


@nan_without_warnings
def inverse_detected_fluctuating(
    snr: ArrayLike, pfa: float, n_looks: int, n_reference: int, order: float
) -> Floats:
    """Mean of 1/x over detections of power x, the sum of all looks; (...).

    Of order n + k, 1/x is 1/(n + k - 1) times the chance of one order less. Beyond the last term
    the weights are smooth, and are integrated.
    """
    terms = _terms_of_cfar(pfa, n_looks, n_reference)
    total = _total(snr, n_looks).ravel()
    k = np.arange(len(terms.hit), dtype=np.float64)
    fewer = n_looks - 1 + k
    inverse = special.betainc(n_reference, np.maximum(fewer, 1), terms.share) / np.maximum(fewer, 1)
    if n_looks == 1:
        inverse[0] = pfa * float(inverse_detected_snr(0.0, pfa, n_reference))
    found = np.empty(len(total))
    step = max(AT_ONCE // len(k), 1)
    for a in range(0, len(total), step):
        part = total[a : a + step]
        found[a : a + step] = np.exp(_log_weights(part, order, k)) @ inverse
    pd = _pd(total, order, terms)
    far = np.flatnonzero(_beyond(total, order, len(k) - 1) > 0)
    if len(far):
        found[far] += _inverse_beyond(total[far], order, n_looks, len(k) - 0.5)
    return np.asarray(found / pd).reshape(np.shape(snr))


def _inverse_beyond(total: Floats, order: float, n_looks: int, first: float) -> Floats:
    """Weights over n + k - 1, integrated from a number on; (n,)."""
    nodes, weights = unit_interval(NODES)
    if order == STEADY:
        low = np.maximum(first, total - SURE * np.sqrt(total))
        high = np.maximum(total + SURE * np.sqrt(total), first + LONG_TAIL)
    else:
        low = np.full(len(total), first)
        high = low + total * (1 + 40 / order)
    span = np.log(high / low)[:, None]
    k = low[:, None] * np.exp(span * nodes)
    density = np.exp(_log_weights(total, order, k))
    return np.asarray((density * k / (n_looks + k - 1)) * span @ weights)


class FluctuatingCfar(NamedTuple):
    """A detector of targets each of which fluctuates by an order of its own.

    Of one look orders may be None: all are of Swerling's case 1, for which there are closed forms.
    """

    pfa: float
    n_looks: int
    n_reference: int

    def pd(self, snr: Floats, order: Floats | None) -> Floats:
        """Probability of detection; (...) each."""
        if order is None:
            return pd_cfar_swerling1(snr, self.pfa, self.n_reference)
        pd = np.empty(snr.shape)
        for one, rows in _by_order(order):
            pd[rows] = pd_fluctuating_cfar(snr[rows], *self, one)
        return pd

    @nan_without_warnings
    def draw_detected(
        self, snr: Floats, order: Floats | None, rng: np.random.Generator
    ) -> tuple[Floats, Floats]:
        """Sums of the looks of detections, and thresholds, (n,); no draw depends on other rows."""
        if order is None:
            return draw_detected_snr_swerling1(snr, self.pfa, self.n_reference, rng)
        u = rng.random((3, len(snr)))
        power, threshold = np.empty(len(snr)), np.empty(len(snr))
        for one, rows in _by_order(order):
            power[rows], threshold[rows] = _detected(self, snr[rows], one, u[:, rows])
        return power, threshold

    def inverse_detected(self, snr: Floats, order: Floats | None) -> Floats:
        """Mean of 1/x over detections, x the sum of all looks; (...) each."""
        if order is None:
            return inverse_detected_snr(snr, self.pfa, self.n_reference)
        inverse = np.empty(snr.shape)
        for one, rows in _by_order(order):
            inverse[rows] = inverse_detected_fluctuating(snr[rows], *self, one)
        return inverse


def _by_order(order: Floats) -> Iterator[tuple[float, Bools]]:
    for one in np.unique(order).tolist():
        yield one, order == one

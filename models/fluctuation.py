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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plotfeed.models import special
from plotfeed.models.chance import of_rows
from plotfeed.models.detection import (
    draw_detected_power_noncoherent,
    draw_detected_snr_swerling1,
    inverse_detected_power_noncoherent,
    inverse_detected_snr,
    pd_cfar_swerling1,
    pd_noncoherent_unequal_cfar,
    threshold_noncoherent_cfar,
)
from plotfeed.models.numerics import nan_without_warnings, unit_interval
from plotfeed.models.state import Floats, rows_where

STEADY = np.inf  # The order of a target that does not fluctuate, Swerling 0
# In place of an order: each look's echo fluctuates by itself, about a mean of its own.
OF_EACH = np.nan
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


def _detected(
    total: Floats, order: float, law: tuple[float, int, int], u: Floats
) -> tuple[Floats, Floats]:
    """Sums and thresholds of detections of such totals, (n,), by uniform numbers, (3, n).

    The exact joint law given the hit: the number k by its weight and chance, the share of the
    reference samples in all power below that at the threshold, and all power, a gamma variable.
    """
    (_, n_looks, n_reference), terms = law, _terms_of_cfar(*law)
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


def _inverse(total: Floats, order: float, law: tuple[float, int, int]) -> Floats:
    """Mean of 1/x over detections of power x, the sum of all looks, of such totals; (n,).

    Of order n + k, 1/x is 1/(n + k - 1) times the chance of one order less. Beyond the last term
    the weights are smooth, and are integrated.
    """
    (pfa, n_looks, n_reference), terms = law, _terms_of_cfar(*law)
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
    return np.asarray(found / pd)


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


# Below, one addition after the other is what NumPy's sum along a row does, many times as fast.
FEW_SIGNALS = 8


def mean_over_signals(snrs: Floats) -> Floats:
    """The mean ratio of each look (eq 18); (..., K) in, (...) out."""
    n_signals = snrs.shape[-1]
    if n_signals == 1:
        return snrs[..., 0]
    if n_signals >= FEW_SIGNALS:
        return np.asarray(snrs.mean(axis=-1))
    total = snrs[..., 0] + snrs[..., 1]
    for k in range(2, n_signals):
        total += snrs[..., k]
    return np.asarray(total / n_signals)


class FluctuatingCfar(NamedTuple):
    """A detector of the sum of K looks, (..., K), at targets each of an order of its own, (...).

    Without orders, None, all are of the `usual` one: 1 for one look, Swerling's case 1, for which
    there are closed forms, or `OF_EACH`. Of a target of a stated order the sum of the ratios
    decides, which is exact for one that is the same to all looks.
    """

    pfa: float
    n_looks: int
    n_reference: int
    usual: float = 1.0

    @nan_without_warnings
    def pd(self, snrs: Floats, order: Floats | None) -> Floats:
        """Probability of detection (eqs 6 and 7, or 22 and 23); (...)."""
        if order is None and self.usual == 1.0:
            return pd_cfar_swerling1(snrs[..., 0], self.pfa, self.n_reference)
        pd = np.empty(snrs.shape[:-1])
        for one, rows in _by_order(order):
            if np.isnan(one):
                pd[rows] = pd_noncoherent_unequal_cfar(snrs[rows], self.pfa, self.n_reference)
            else:
                pd[rows] = _pd(self._total(snrs[rows]), one, _terms_of_cfar(*self[:3]))
        return pd

    @nan_without_warnings
    def draw_detected(
        self, snrs: Floats, order: Floats | None, rng: np.random.Generator
    ) -> tuple[Floats, Floats]:
        """Sums of the looks of detections, and thresholds, (n,); no draw depends on other rows."""
        if order is None and self.usual == 1.0:
            return draw_detected_snr_swerling1(snrs[:, 0], self.pfa, self.n_reference, rng)
        power, threshold = np.empty((2, len(snrs)))
        is_stated = np.zeros(len(snrs), np.bool_) if order is None else ~np.isnan(order)
        if not is_stated.all():
            rows, law = rows_where(~is_stated), (self.pfa, self.n_reference)
            power[rows], threshold[rows] = draw_detected_power_noncoherent(
                snrs[rows], *law, of_rows(rng, rows)
            )
        u = np.empty((3, len(snrs)))
        if is_stated.any():
            u[:, is_stated] = of_rows(rng, rows_where(is_stated)).random((3, is_stated.sum()))
        for one, rows in _by_order(order):
            if not np.isnan(one):
                total = self._total(snrs[rows])
                power[rows], threshold[rows] = _detected(total, one, self[:3], u[:, rows])
        return power, threshold

    @nan_without_warnings
    def inverse_detected(self, snrs: Floats, order: Floats | None) -> Floats:
        """Mean of 1/x over detections, x the sum of all looks; (...)."""
        if order is None and self.usual == 1.0:
            return inverse_detected_snr(snrs[..., 0], self.pfa, self.n_reference)
        inverse = np.empty(snrs.shape[:-1])
        for one, rows in _by_order(order):
            if np.isnan(one):
                law = self.pfa, self.n_reference
                inverse[rows] = inverse_detected_power_noncoherent(snrs[rows], *law)
            else:
                inverse[rows] = _inverse(self._total(snrs[rows]), one, self[:3])
        return inverse

    def _total(self, snrs: Floats) -> Floats:
        ratio = mean_over_signals(snrs) * self.n_looks
        return np.where(ratio >= 0, ratio, np.nan)


def _by_order(order: Floats | None) -> Iterator[tuple[float, Any]]:
    """Orders, and where each is; without any, `OF_EACH` everywhere."""
    if order is None:
        yield OF_EACH, ...
        return
    for one in np.unique(order).tolist():
        yield one, np.isnan(order) if np.isnan(one) else order == one

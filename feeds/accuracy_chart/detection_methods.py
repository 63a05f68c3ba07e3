"""Methods of detection that are only compared: tables, float32, as printed, and signals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, gammaincc, gammainccinv

from plotfeed.feeds.accuracy_chart.case import Rng
from plotfeed.models import detection, looks_chain
from plotfeed.models.state import Bools, Floats

TABLE_DB = np.linspace(-60.0, 120.0, 1441)
"""Eight nodes a decibel."""
Singles = NDArray[np.float32]
Hits = Callable[[Rng], Bools]


def table(pd_of_db: Callable[[Floats], Floats]) -> Callable[[Floats], Floats]:
    """Pd by linear interpolation over the ratio in dB; made once, (n,) in and out."""
    nodes = pd_of_db(TABLE_DB)
    return lambda snr_db: np.asarray(np.interp(snr_db, TABLE_DB, nodes))


def single_cfar_swerling1(snr: Singles, pfa: float, n_reference: int) -> Singles:
    """Equation 7 in float32."""
    alpha = np.float32(np.expm1(-np.log(pfa) / n_reference))
    mean = 1 + snr
    return np.asarray((mean / (mean + alpha)) ** np.float32(n_reference))


def single_sum_cfar(snrs: Singles, pfa: float, n_reference_total: int) -> Singles:
    """The chain of looks and samples in float32."""
    ratio = detection.threshold_noncoherent_cfar(pfa, snrs.shape[-1], n_reference_total)
    chain: Any = looks_chain.outlasting
    return np.asarray(chain(snrs, np.float32(ratio), n_reference_total))


def single_energy(snr: Singles, pfa: float, n_samples: int) -> Singles:
    """The energy detector in float32."""
    threshold = np.float32(gammainccinv(n_samples, pfa))
    return np.asarray(gammaincc(np.float32(n_samples), threshold / (1 + snr)))


def single_logistic(snr_db: Singles, sensitivity_db: float, slope_per_db: float) -> Singles:
    """Equation 43 in float32."""
    return np.asarray(expit(np.float32(slope_per_db) * (snr_db - np.float32(sensitivity_db))))


def printed_cfar_swerling1(snr: Floats, pfa: float, n_reference: int) -> Floats:
    """Equations 6 and 7, as printed."""
    alpha = pfa ** (-1 / n_reference) - 1
    return np.asarray((1 + alpha / (1 + snr)) ** -n_reference)


def printed_sum(snrs: Floats, pfa: float) -> Floats:
    """Equations 18, 22 and 23 as printed: the mean ratio, its half, and known noise."""
    n_looks = snrs.shape[-1]
    threshold = gammainccinv(n_looks, pfa)
    return np.asarray(gammaincc(n_looks, threshold / (1 + snrs.mean(axis=-1) / 2)))


@np.errstate(over="ignore")
def printed_logistic(snr_db: Floats, sensitivity_db: float) -> Floats:
    """Equation 43 as printed, by ratio and sensitivity in dB."""
    return np.asarray(1 / (1 + np.exp(-snr_db - sensitivity_db)))


def signal_cfar(snrs: Floats, pfa: float, n_reference_total: int, rng: Rng) -> Bools:
    """Hits of looks made as signals: complex Gaussian cells, target and reference; (n, K) to (n,).

    Right in law: it is what the closed forms are the integrals of.
    """
    n, n_looks = snrs.shape
    ratio = detection.threshold_noncoherent_cfar(pfa, n_looks, n_reference_total)
    target = (1 + snrs) * (rng.standard_normal((n, n_looks, 2)) ** 2).sum(axis=-1)
    reference = (rng.standard_normal((n, n_reference_total, 2)) ** 2).sum(axis=(1, 2))
    return np.asarray(target.sum(axis=-1) > ratio * reference)


def signal_energy(snr: Floats, pfa: float, n_samples: int, rng: Rng) -> Bools:
    """Hits of an energy detector whose samples are drawn one by one; (n,)."""
    threshold = gammainccinv(n_samples, pfa)
    energy = [(rng.standard_normal(2 * n_samples) ** 2).sum() / 2 for _ in range(len(snr))]
    return np.asarray((1 + snr) * np.array(energy) > threshold)


def counted(hits: Hits, trials: int) -> Callable[[Rng], Floats]:
    """Pd by counting so many trials of hits; (n,)."""

    def pd(rng: Rng) -> Floats:
        total = hits(rng).astype(np.float64)
        for _ in range(trials - 1):
            total += hits(rng)
        return total / trials

    return pd

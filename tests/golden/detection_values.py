"""Chances of detection and thresholds in 60 digits, for make_reference.py.

Powers of a Swerling 2 echo and of noise are exponential, with means 1 + S and 1. A sum of K of
them is beyond y exactly when fewer than K points of a Poisson process lie before it; one such sum
is beyond t times another of M exactly when M points of a coin with chance 1 / (1 + t) came up
before K of the other kind.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

from mpmath import mp

Row = dict[str, Any]
F = mp.mpf


def linear(decibels: Any) -> Any:
    """A ratio of powers."""
    return F(10) ** (F(decibels) / 10)


def beyond(looks: int, y: Any) -> Any:
    """The chance that a sum of so many exponential powers of mean 1 is beyond y."""
    return mp.exp(-y) * mp.fsum(y**k / mp.factorial(k) for k in range(looks))


def outlasting(looks: int, samples: int, ratio: Any) -> Any:
    """The chance that a sum of looks is beyond that many times a sum of samples."""
    end = ratio / (1 + ratio)
    return (1 - end) ** samples * mp.fsum(
        mp.binomial(samples + k - 1, k) * end**k for k in range(looks)
    )


@cache
def threshold(looks: int, pfa: str) -> Any:
    """Where the sum of so many looks at noise is with a chance of Pfa, by halving."""
    return _halved(lambda y: beyond(looks, y), F(pfa), mp.mpf(5) * looks + 200)


@cache
def ratio_of(looks: int, samples: int, pfa: str) -> Any:
    """The same for a sum of samples."""
    return _halved(lambda t: outlasting(looks, samples, t), F(pfa), mp.mpf(10) ** 5)


def _halved(falling: Any, level: Any, high: Any) -> Any:
    low = F(0)
    for _ in range(230):
        middle = (low + high) / 2
        low, high = (middle, high) if falling(middle) > level else (low, middle)
    return middle


def looks() -> Iterator[Row]:
    """One look at Swerling 1 against a sum of N reference cells."""
    for pfa, n, snr_db in itertools.product(("1e-2", "1e-6", "1e-12"), (1, 16, 128), (-20, 3, 50)):
        yield _look(pfa, n, snr_db)
    for snr_db in range(-6, 42, 4):
        yield _look("1e-4", 10, snr_db)


def _look(pfa: str, n: int, snr_db: int) -> Row:
    alpha = mp.exp(mp.log(1 / F(pfa)) / n) - 1
    mean = 1 + linear(snr_db)
    # Over the law of that sum: the mean of exp(-alpha z / mean), z of shape n.
    pd = (mean / (mean + alpha)) ** n
    return {"pfa": pfa, "n_ref": n, "snr_db": snr_db, "alpha": alpha, "pd": pd}


def thresholds() -> Iterator[Row]:
    """Of sums of looks in known noise."""
    for n, pfa in itertools.product((1, 2, 3, 5, 8), ("1e-2", "1e-6", "1e-13")):
        y = threshold(n, pfa)
        yield {"n_integrated": n, "pfa": pfa, "yb_sum": y, "yb_mean": y / n}


def energies() -> Iterator[Row]:
    """Sums of equal looks in known noise."""
    cases = list(itertools.product((1, 3, 8), ("1e-4", "1e-9"), (-15, 0, 6, 12, 18, 45)))
    for n, pfa, snr_db in cases:
        y, snr = threshold(n, pfa), linear(snr_db)
        yield {"n_integrated": n, "pfa": pfa, "snr_db": snr_db, "pd": beyond(n, y / (1 + snr))}


def sums() -> Iterator[Row]:
    """Sums of equal looks against sums of reference samples."""
    designs = ((1, 16, "1e-6"), (2, 20, "1e-3"), (3, 48, "1e-4"), (8, 64, "1e-9"))
    for (n, samples, pfa), snr_db in itertools.product(designs, (-15, 0, 6, 12, 18, 45)):
        t = ratio_of(n, samples, pfa)
        pd = outlasting(n, samples, t / (1 + linear(snr_db)))
        design = {"n_integrated": n, "n_ref_samples": samples, "pfa": pfa}
        yield design | {"snr_db": snr_db, "threshold_ratio": t, "pd": pd}


def unequal() -> Iterator[Row]:
    """Three looks of other ratios each, by partial fractions; and with their mean for each."""
    looks_db = (
        *((3, 11, 19), (-10, 0, 30), (12, "12.000001", "11.999998")),
        *((-90, 5, -60), (40, 41, "-2.5")),
    )
    for pfa, snrs_db in itertools.product(("1e-4", "1e-8"), looks_db):
        snrs = [linear(each) for each in snrs_db]
        y = threshold(3, pfa)
        named = {f"snr{i}_db": each for i, each in enumerate(snrs_db, 1)}
        mean = beyond(3, y / (1 + mp.fsum(snrs) / 3))
        yield {"pfa": pfa, **named, "pd_exact": _partial(snrs, y), "pd_mean_snr_eq18": mean}


def _partial(snrs: Sequence[Any], y: Any) -> Any:
    total = F(0)
    for i, one in enumerate(snrs):
        weight = F(1)
        for j, other in enumerate(snrs):
            weight *= 1 if i == j else (1 + one) / (one - other)
        total += weight * mp.exp(-y / (1 + one))
    return total


def fluctuations() -> Iterator[Row]:
    """sqrt(E[1/x | x > T]) of an exponential power x, by the integral over its law."""
    for pfa, snr_db in itertools.product(("1e-4", "1e-6", "1e-8"), (6, 14, 22, 40)):
        mean, t = 1 + linear(snr_db), -mp.log(F(pfa))
        # x = T + mean u, u of mean 1
        edges = [0, t / mean / 8, t / mean, 1 + t / mean, 8, 30, 150]
        kept = sorted({F(edge) for edge in edges})
        inverse = mp.quad(lambda u, t=t, mean=mean: mp.exp(-u) / (t + mean * u), kept)
        rms = mp.sqrt(inverse)
        ratio = rms * mp.sqrt(linear(snr_db))
        told = {"rms_inv_sqrt_inst_snr": rms, "ratio_to_inv_sqrt_mean_snr": ratio}
        yield {"pfa": pfa, "mean_snr_db": snr_db} | told

"""Tests of significance. A right programme fails each of them for one seed in 10,000."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

FALSE_ALARM_RATE = 1e-4

Array = NDArray[Any]


def assert_chance(p_value: float, of: str = "") -> None:
    """What was seen is not too improbable to have come by chance."""
    assert p_value > FALSE_ALARM_RATE, f"{of}: p = {p_value:.2g}"


def assert_sum(total: float, mean: float, variance: float, of: str = "") -> None:
    """A sum of many independent draws has that mean, by its known variance; two-sided z-test."""
    z = (total - mean) / np.sqrt(variance)
    assert_chance(float(2 * stats.norm.sf(abs(z))), f"{of} z = {z:+.2f}")


def assert_mean(values: Array, expected: Array | float, of: str = "") -> None:
    """Many independent draws, each less its own expectation, average to zero; z-test."""
    excess = values - expected
    n = len(excess)
    assert n >= 1000
    assert_sum(float(excess.sum()), 0.0, n * float(excess.var(ddof=1)), of)


def assert_law(values: Array, cdf: str | Callable[[Array], Array], of: str = "") -> None:
    """Values are drawn from that distribution; Kolmogorov and Smirnov."""
    assert len(values) >= 150
    assert_chance(float(stats.kstest(values, cdf).pvalue), of)


def assert_standard_normal(values: Array, of: str = "") -> None:
    """Shape by Kolmogorov and Smirnov, sum of squares by chi-square, mean by z."""
    assert_law(values, "norm", f"{of} law")
    square = float(values @ values)
    chi2 = stats.chi2(len(values))
    assert_chance(2 * min(float(chi2.cdf(square)), float(chi2.sf(square))), f"{of} variance")
    assert_sum(float(values.sum()), 0.0, len(values), f"{of} mean")


def assert_uncorrelated(a: Array, b: Array, of: str = "") -> None:
    assert len(a) >= 1000
    assert_chance(float(stats.pearsonr(a, b).pvalue), of)


def assert_counts(counts: Array, law: Any, of: str = "") -> None:
    """Whole numbers are drawn from a discrete law; chi-square over classes of 10 or more."""
    low, high = int(law.ppf(10 / len(counts))), int(law.isf(10 / len(counts))) - 1
    edges = np.arange(low, high + 1)  # classes: up to low, each in between, above high
    expected = len(counts) * np.diff([0.0, *law.cdf(edges), 1.0])
    seen = np.bincount(np.clip(counts - low, 0, len(edges)), minlength=len(edges) + 1)
    assert expected.min() > 4
    assert len(expected) >= 3
    assert_chance(float(stats.chisquare(seen, expected).pvalue), of)

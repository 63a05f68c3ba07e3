"""The energy detector: signal-level Monte Carlo, quadrature at 1e7 samples, the law given a hit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate
from scipy.special import gammaincc
from support.significance import assert_law, assert_mean, assert_sum

from plotfeed.models import detection
from plotfeed.models.detection import (
    miss_noncoherent_swerling2,
    pd_noncoherent_swerling2,
    threshold_noncoherent,
)


def samples(snr: float, n_samples: int, trials: int, rng: np.random.Generator) -> np.ndarray:
    """Energies of Gaussian signal and noise, complex sample by sample; mean noise power 1."""
    sigma = np.sqrt((1 + snr) / 2)
    i, q = sigma * rng.standard_normal((2, trials, n_samples))
    return (i**2 + q**2).sum(axis=1)


@pytest.mark.parametrize(("n_samples", "snr_db"), [(1, 12.0), (8, 3.0), (100, -6.0)])
def test_pd_is_that_of_gaussian_samples(n_samples: int, snr_db: float) -> None:
    """Seed 51."""
    snr, pfa, trials = 10 ** (snr_db / 10), 1e-3, 40_000
    found = samples(snr, n_samples, trials, np.random.default_rng(51))
    hits = (found > threshold_noncoherent(pfa, n_samples)).sum()
    pd = float(pd_noncoherent_swerling2(snr, pfa, n_samples))
    assert 0.1 < pd < 0.9
    assert_sum(hits, pd * trials, pd * (1 - pd) * trials, f"{n_samples} samples")


@pytest.mark.parametrize("n_samples", [1e3, 1e5, 1e7, 1e8])
@pytest.mark.parametrize("pfa", [1e-1, 1e-6, 1e-12])
@pytest.mark.parametrize("strength", [0.0, 1.0, 5.0, 9.0])
def test_pd_and_miss_keep_their_digits_for_many_samples(
    n_samples: float, pfa: float, strength: float
) -> None:
    """Against a quadrature of the gamma density in Stirling's form, in units of its spread."""
    snr = strength / np.sqrt(n_samples)
    bound = float(threshold_noncoherent(pfa, n_samples)) / (1 + snr)
    above, below = tails(bound, n_samples)
    assert float(pd_noncoherent_swerling2(snr, pfa, n_samples)) == pytest.approx(above, rel=1e-9)
    assert float(miss_noncoherent_swerling2(snr, pfa, n_samples)) == pytest.approx(below, rel=1e-9)
    if strength == 0:
        assert above == pytest.approx(pfa, rel=1e-9)


def tails(bound: float, n: float) -> tuple[float, float]:
    """Probabilities that a gamma variable of order n is above and below a bound."""
    stirling = 1 / (12 * n) - 1 / (360 * n**3)

    def density(z: float) -> float:
        t = z / np.sqrt(n)  # x = n (1 + t); log1p(t) - t without the cancellation
        exponent = n * (np.log1p(t) - t) if abs(t) > 1e-2 else -n * series(t)
        return float(np.exp(exponent - np.log1p(t) - stirling) / np.sqrt(2 * np.pi))

    edge = (bound - n) / np.sqrt(n)
    reach = {"epsabs": 0.0, "epsrel": 1e-11, "limit": 400}
    above = integrate.quad(density, edge, max(edge, 0) + 14, **reach)[0]
    low = max(min(edge, 0) - 14, -np.sqrt(n) * (1 - 1e-9))
    return above, integrate.quad(density, low, edge, **reach)[0]


def series(t: float) -> float:
    """t - log1p(t), |t| at most 0.01."""
    return float(sum((-1) ** k * t**k / k for k in range(2, 14)))


@pytest.mark.parametrize("n_samples", [1, 3, 200, 10**5, 10**7])
@pytest.mark.parametrize("strength", [0.0, 3.0, 30.0])
def test_energies_of_detections_have_the_exact_law(n_samples: int, strength: float) -> None:
    """Kolmogorov and Smirnov against the truncated gamma distribution; seed 52."""
    snr, pfa = strength / np.sqrt(n_samples), 1e-4
    rng = np.random.default_rng(52)
    drawn = detection.draw_detected_energy(np.full(5000, snr), pfa, n_samples, rng)
    pd = pd_noncoherent_swerling2(snr, pfa, n_samples)
    assert drawn.min() >= threshold_noncoherent(pfa, n_samples)
    assert_law(drawn, lambda x: 1 - gammaincc(n_samples, x / (1 + snr)) / pd, "seed 52")


@pytest.mark.parametrize("n_samples", [1, 3, 200, 10**5, 10**7])
@pytest.mark.parametrize("strength", [0.0, 3.0, 30.0, 1000.0])
def test_mean_inverse_of_the_estimate_of_a_pair_is_that_of_draws(
    n_samples: int, strength: float
) -> None:
    """Seed 54."""
    snr, pfa = strength / np.sqrt(n_samples), 1e-4
    rng = np.random.default_rng(54)
    drawn = detection.draw_detected_energy(np.full(40_000, snr), pfa, n_samples, rng)
    estimate = detection.estimated_snr(drawn, n_samples)
    inverse = 1 / estimate + 1 / (2 * estimate**2)
    assert_mean(inverse, float(detection.inverse_paired_snr(snr, pfa, n_samples)), "seed 54")


@pytest.mark.parametrize("snr_db", [10.0, 30.0, 60.0])
def test_mean_inverse_of_one_strong_sample_by_quadrature(snr_db: float) -> None:
    """The worst case: most detections are far above a threshold where the inverse is largest."""
    mean, bound = 1 + 10 ** (snr_db / 10), -np.log(1e-6)

    def integrand(log_excess: float) -> float:
        excess = np.exp(log_excess)
        estimate = bound + excess - 1
        inverse = 1 / estimate + 1 / (2 * estimate**2)
        return float(excess * np.exp(-excess / mean) / mean * inverse)

    expected = integrate.quad(integrand, -30, np.log(60 * mean), limit=400)[0]
    found = detection.inverse_paired_snr(mean - 1, 1e-6, 1)
    assert float(found) == pytest.approx(expected, rel=2e-3)


@given(
    st.floats(-100, 120).map(lambda db: 10 ** (db / 10)),
    st.floats(-15, -1).map(lambda e: 10.0**e),
    st.integers(1, 10**8),
    st.integers(0, 2**32),
)
def test_detections_always_show_some_signal(
    snr: float, pfa: float, n_samples: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    drawn = detection.draw_detected_energy(np.full(20, snr), pfa, n_samples, rng)
    estimate = detection.estimated_snr(drawn, n_samples)
    assert np.isfinite(estimate).all()
    assert (estimate > 0).all()
    inverse = float(detection.inverse_paired_snr(snr, pfa, n_samples))
    assert 0 < inverse < np.inf

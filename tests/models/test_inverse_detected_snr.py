"""The mean of 1/x over detections of power x, which scales the variance of a radar's errors.

Against reference values, a quadrature done apart, and cells and thresholds drawn one by one.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy import integrate
from support.given_files import reference
from support.radar_equations import detected_power_density
from support.significance import assert_mean

from plotfeed.models.detection import inverse_detected_snr


def test_agrees_with_the_reference_where_the_noise_is_known() -> None:
    """With N reference cells the threshold scatters by 1/sqrt(N), which adds a few parts in N."""
    table = reference("fluctuating_rms_given_detection.csv")
    snr = 10 ** (table["mean_snr_db"] / 10)
    for pfa in np.unique(table["pfa"]):
        rows = table["pfa"] == pfa
        rms = np.sqrt(inverse_detected_snr(snr[rows], float(pfa), 10**9))
        np.testing.assert_allclose(rms, table["rms_inv_sqrt_inst_snr"][rows], rtol=1e-8)


@pytest.mark.parametrize("snr_db", [-10, 0, 10, 20, 40, 60])
@pytest.mark.parametrize("n_reference", [1, 4, 16, 64])
def test_is_the_integral_over_the_density_of_detected_powers(
    n_reference: int, snr_db: float
) -> None:
    """To 1e-4: an average over 128 thresholds, the worst at one reference cell."""
    snr = 10 ** (snr_db / 10)
    sensor = {"pfa": 1e-4, "n_reference": n_reference}

    def integrand(log_x: float) -> float:
        return float(detected_power_density(sensor, np.exp(log_x), snr))

    edges = np.linspace(-12, np.log((1 + snr) * 1e3 + 1e6), 21)
    integral = sum(
        integrate.quad(integrand, low, high, epsabs=0, epsrel=1e-10, limit=400)[0]
        for low, high in pairwise(edges)
    )
    assert float(inverse_detected_snr(snr, 1e-4, n_reference)) == pytest.approx(integral, rel=1e-4)


@pytest.mark.parametrize(("snr_db", "n_reference"), [(3.0, 4), (10.0, 16), (20.0, 16)])
def test_is_the_mean_over_cells_that_crossed_their_own_thresholds(
    snr_db: float, n_reference: int
) -> None:
    """Swerling 1 cells and their reference cells drawn one by one."""
    rng = np.random.default_rng(71)
    snr, pfa, n = 10 ** (snr_db / 10), 1e-2, 300_000
    alpha = pfa ** (-1 / n_reference) - 1
    power = (1 + snr) * rng.standard_exponential(n)
    threshold = alpha * rng.standard_exponential((n, n_reference)).sum(axis=1)
    detected = power[power > threshold]
    assert_mean(1 / detected, float(inverse_detected_snr(snr, pfa, n_reference)))

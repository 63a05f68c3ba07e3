"""Tabulated quantiles of gamma variables: against SciPy's inverse, and back through the tail."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import gammainc, gammaincc, gammainccinv, gammaincinv

from plotfeed.models.detection import gamma_exceeded_with

RNG = np.random.default_rng(61)
PROBABILITIES = np.concatenate(
    [
        RNG.uniform(0, 1, 20_000),
        10 ** RNG.uniform(-30, 0, 20_000),
        10 ** RNG.uniform(-300, 0, 2_000),
        1 - 10 ** RNG.uniform(-15, 0, 20_000),
    ]
)


@pytest.mark.parametrize("order", [1, 2, 3, 8, 30, 199, 201, 1000, 10**5])
def test_it_is_the_inverse_of_the_tail_to_1e_13(order: int) -> None:
    found = gamma_exceeded_with(PROBABILITIES, order)
    exact = np.where(
        PROBABILITIES < 0.5,
        gammainccinv(order, PROBABILITIES),
        gammaincinv(order, 1 - PROBABILITIES),
    )
    np.testing.assert_allclose(found, exact, rtol=1e-13)


@pytest.mark.parametrize("order", [1, 100, 10**5, 10**7, 10**8])
def test_the_way_back_gives_the_probability(order: int) -> None:
    """Where SciPy's way back is right: of high orders it loses the lowest 4e-6."""
    found = gamma_exceeded_with(PROBABILITIES, order)
    usual = (PROBABILITIES > 1e-14) & (PROBABILITIES < 1 - 1e-5)
    digits = 1e-9 if order > 1000 else 1e-12
    low = PROBABILITIES < 0.5
    back = np.where(low, gammaincc(order, found), gammainc(order, found))
    whole = np.where(low, PROBABILITIES, 1 - PROBABILITIES)
    np.testing.assert_allclose(back[usual], whole[usual], rtol=digits)


def test_ends_and_what_is_no_probability() -> None:
    probabilities = np.array([0.0, 1e-320, 0.5, 1.0, np.nan, -0.1])
    found = gamma_exceeded_with(probabilities, 1.0)
    assert found[0] == np.inf
    assert 700 < found[1] < 740
    assert found[2] == pytest.approx(np.log(2), rel=1e-14)
    assert found[3] == 0.0
    assert np.isnan(found[4:]).all()


def test_no_value_depends_on_its_company() -> None:
    together = gamma_exceeded_with(PROBABILITIES[:999], 1000)
    alone = np.concatenate([gamma_exceeded_with(p[None], 1000) for p in PROBABILITIES[:999]])
    np.testing.assert_array_equal(together, alone)

"""Swerling 0 to 4 by one series, beside values of sixty digits, closed forms and plain draws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import pdtr
from support.effect_values import values_of
from support.fluctuating_echoes import joint_hit_gauss_markov
from support.significance import assert_law, assert_sum

from plotfeed.models.detection import (
    inverse_detected_snr,
    pd_cfar_swerling1,
    pd_noncoherent_cfar,
    pd_noncoherent_swerling2,
    threshold_noncoherent_cfar,
)
from plotfeed.models.fluctuation import (
    FluctuatingCfar,
    _poisson,
    inverse_detected_fluctuating,
    miss_fluctuating,
    order_of,
    pd_fluctuating,
    pd_fluctuating_cfar,
)

CASES = range(5)


def test_known_noise_is_as_in_sixty_digits() -> None:
    for name, equation in (("pd_swerling", pd_fluctuating), ("pd_miss_swerling", miss_fluctuating)):
        for args, value in values_of(name):
            case, n = int(args["case"]), int(args["n_looks"])
            snr = 10 ** (float(args["snr_db"]) / 10)
            found = equation(snr, float(args["pfa"]), n, order_of(case, n))
            assert found == pytest.approx(value, rel=1e-12), args


def test_a_cfar_is_as_in_sixty_digits() -> None:
    for args, value in values_of("pd_swerling_cfar"):
        case, n = int(args["case"]), int(args["n_looks"])
        snr = 10 ** (float(args["snr_db"]) / 10)
        m, pfa = int(args["n_reference"]), float(args["pfa"])
        found = pd_fluctuating_cfar(snr, pfa, n, m, order_of(case, n))
        assert found == pytest.approx(value, rel=1e-12), args


@pytest.mark.parametrize("snr", [0.0, 1e-6, 1e-3, 1.0, 30.0, 1e3, 1e6, 1e9])
def test_faint_and_strong_echoes_of_many_looks_cost_no_digits(snr: float) -> None:
    """Where the closed form of DiFranco and Rubin is NaN, and terms by the thousand are left."""
    n, pfa = 100, 1e-6
    case2 = pd_fluctuating(snr, pfa, n, order_of(2, n))
    assert case2 == pytest.approx(pd_noncoherent_swerling2(snr, pfa, n), rel=1e-12)
    one = pd_fluctuating_cfar(snr, pfa, 1, 16, 1.0)
    assert one == pytest.approx(pd_cfar_swerling1(snr, pfa, 16), rel=1e-12)
    eight = pd_fluctuating_cfar(snr, pfa, 8, 24, 8.0)
    assert eight == pytest.approx(pd_noncoherent_cfar(snr, pfa, 8, 24), rel=1e-12)
    by_case = [float(pd_fluctuating(snr, pfa, n, order_of(case, n))) for case in CASES]
    assert np.all(np.isfinite(by_case))
    assert pfa * (1 - 1e-12) <= min(by_case) <= max(by_case) <= 1.0
    misses = [float(miss_fluctuating(snr, pfa, n, order_of(case, n))) for case in CASES]
    np.testing.assert_allclose(np.add(by_case, misses), 1.0, rtol=1e-12)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(("n_looks", "snr"), [(1, 4.0), (1, 40.0), (1, 4e4), (4, 6.0)])
def test_what_was_detected_is_drawn_as_a_receiver_would_find_it(
    case: int, n_looks: int, snr: float
) -> None:
    """Strengths, echoes and reference samples drawn plainly, and those that hit kept."""
    rng = np.random.default_rng(100 * case + n_looks)
    n, m, pfa, order = 40_000, 16, 1e-3, order_of(case, n_looks)
    strength = np.full(n, snr)
    if case in (1, 3):
        strength = snr * rng.standard_gamma(order, n) / order
    looks = np.repeat(strength[:, None], n_looks, axis=1)
    if case in (2, 4):
        each = case // 2
        looks = snr * rng.standard_gamma(each, (n, n_looks)) / each
    noise = rng.standard_normal((2, n, n_looks)) / np.sqrt(2)
    power = ((np.sqrt(looks) + noise[0]) ** 2 + noise[1] ** 2).sum(axis=1)
    cfar = FluctuatingCfar(pfa, n_looks, m)
    threshold = float(threshold_noncoherent_cfar(pfa, n_looks, m)) * rng.standard_gamma(m, n)
    hit = power > threshold
    pd = float(cfar.pd(np.array([snr]), np.array([order]))[0])
    assert_sum(hit.sum(), n * pd, n * pd * (1 - pd) + 1e-9, "hits")
    few = min(int(hit.sum()), 3000)
    drawn, thresholds = cfar.draw_detected(np.full(few, snr), np.full(few, order), rng)
    assert (drawn >= thresholds).all()
    plain = np.sort(power[hit])
    assert_law(np.searchsorted(plain, drawn) / len(plain), "uniform", "power")
    plain = np.sort(threshold[hit])
    assert_law(np.searchsorted(plain, thresholds) / len(plain), "uniform", "threshold")
    inverse = cfar.inverse_detected(np.array([snr]), np.array([order]))[0]
    spread = (1 / power[hit]).std() / np.sqrt(hit.sum())
    assert abs((1 / power[hit]).mean() - inverse) < 5 * spread + 1e-3 * inverse


def test_the_mean_inverse_of_one_look_is_that_of_swerling_1() -> None:
    snr = np.array([0.1, 1.0, 10.0, 1e3, 1e5])
    found = inverse_detected_fluctuating(snr, 1e-6, 1, 16, 1.0)
    np.testing.assert_allclose(found, inverse_detected_snr(snr, 1e-6, 16), rtol=1e-4)


def test_no_draw_of_a_target_depends_on_how_others_fluctuate() -> None:
    cfar, snr = FluctuatingCfar(1e-6, 1, 16), np.full(6, 20.0)
    together = cfar.draw_detected(
        snr, np.array([1.0, np.inf, 2.0, 1.0, 2.0, np.inf]), np.random.default_rng(3)
    )
    alike = cfar.draw_detected(snr, np.ones(6), np.random.default_rng(3))
    for a, b in zip(together, alike, strict=True):
        np.testing.assert_array_equal(a[[0, 3]], b[[0, 3]])


def test_two_hits_at_one_amplitude_are_as_likely_as_integrated() -> None:
    for args, value in values_of("joint_hit_gauss_markov"):
        snr = 10 ** (float(args["snr_db"]) / 10)
        found = joint_hit_gauss_markov(snr, float(args["pfa"]), float(args["rho"]))
        assert found == pytest.approx(value, rel=1e-10)
    pd = 1e-6 ** (1 / (1 + snr))
    after = [joint_hit_gauss_markov(snr, 1e-6, rho) / pd for rho in (0.0, 0.5, 0.9, 0.99)]
    np.testing.assert_allclose(after, [0.517, 0.574, 0.757, 0.845], atol=5e-4)


def test_poisson_numbers_are_those_of_the_inverse_to_the_last_one() -> None:
    mean = np.repeat([950.0, 1e4, 1e6], 400)
    u = np.tile(
        np.concatenate([np.linspace(1e-6, 1 - 1e-6, 396), [1e-16, 1e-9, 0.5, 1 - 1e-14]]), 3
    )
    found = _poisson(mean, u)
    assert (pdtr(found, mean) >= u).all()
    assert (pdtr(found - 1, mean) < u).all()

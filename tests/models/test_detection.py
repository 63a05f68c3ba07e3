"""Detection against values of 60 digits, rational arithmetic, integrals and plain properties.

Detectors drawn sample by sample stand beside what is drawn given a hit; these tests fail a right
programme for one seed in 10,000. False alarms are at the end: how many, and how sectors share them.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, stats
from scipy.special import gammainc, gammaincc, gammainccinv, gammaincinv, pdtr
from support.given_files import reference, values_of
from support.radar_equations import joint_hit_gauss_markov, unequal_pd
from support.significance import assert_chance, assert_sum

from plotfeed.feeds.lab import oracle
from plotfeed.models import detection
from plotfeed.models.fluctuation import FluctuatingCfar, _poisson, order_of
from plotfeed.models.numerics import unit_interval

pfas = st.floats(-15, -0.1).map(lambda exponent: 10.0**exponent)
far_dbs = st.floats(-100, 100)
several = st.lists(far_dbs, min_size=1, max_size=6)
cells = st.integers(1, 40)
cfar_pfas = st.floats(-15, -1).map(lambda exponent: 10.0**exponent)


def linear(decibels):
    return 10 ** (np.asarray(decibels, dtype=np.float64) / 10)


def pd_equal(snr, pfa, n_looks, n_reference):
    """Looks that are alike, by the detector of those that are not."""
    return detection.pd_noncoherent_unequal_cfar(np.full(int(n_looks), snr), pfa, int(n_reference))


# Table, its columns that are arguments, what is asked, the column that it is, relative error.
REFERENCE = [
    ("pd_cacfar_sw1", "pfa n_ref", detection.cfar_multiplier, "alpha", 1e-14),
    ("pd_cacfar_sw1", "snr_db pfa n_ref", detection.pd_cfar_swerling1, "pd", 1e-13),
    ("nci_threshold", "pfa n_integrated", detection.threshold_noncoherent, "yb_sum", 5e-14),
    ("nci_pd_sw2", "snr_db pfa n_integrated", detection.pd_noncoherent_swerling2, "pd", 1e-13),
    ("nci_cacfar_pd_sw2", "pfa n_integrated n_ref_samples", detection.threshold_noncoherent_cfar,
     "threshold_ratio", 1e-13),
    ("nci_cacfar_pd_sw2", "snr_db pfa n_integrated n_ref_samples", np.vectorize(pd_equal), "pd",
     1e-12),
    ("logistic", "snr_minus_sens_db", lambda margin_db: detection.pd_logistic(margin_db, 0.0), "pd",
     1e-14),
]  # fmt: skip


@pytest.mark.parametrize(("name", "columns", "equation", "told", "digits"), REFERENCE)
def test_equations_agree_with_the_reference(name, columns, equation, told, digits):
    table = reference(f"{name}.csv")
    case = [linear(table[c]) if c == "snr_db" else table[c] for c in columns.split()]
    np.testing.assert_allclose(equation(*case), table[told], rtol=digits)


def test_the_mean_of_three_looks_is_what_the_paper_prints() -> None:
    """Equation 18, where looks differ: as the reference has it, and not what the sum comes to."""
    table = reference("nci_pd_unequal_snr.csv")
    snrs = linear(np.stack([table[f"snr{i}_db"] for i in (1, 2, 3)], axis=-1))
    mean_form = detection.pd_noncoherent_swerling2(snrs.mean(axis=-1), table["pfa"], 3)
    np.testing.assert_allclose(mean_form, table["pd_mean_snr_eq18"], rtol=1e-12)
    known_noise = detection.pd_noncoherent_unequal_cfar(snrs, table["pfa"], 20_000)
    np.testing.assert_allclose(known_noise, table["pd_exact"], rtol=60 / 20_000)


def test_a_listeners_slope_and_middle():
    assert detection.pd_logistic(32.0, 32.0) == 0.5
    assert detection.pd_logistic(34.0, 32.0, 3.0) == detection.pd_logistic(6.0, 0.0)
    assert detection.pd_logistic(-1e4, 0.0) == 0.0
    assert detection.pd_logistic(1e4, 0.0) == 1.0


PDS = [
    lambda snr, pfa: detection.pd_cfar_swerling1(snr, pfa, 16),
    lambda snr, pfa: detection.pd_noncoherent_swerling2(snr, pfa, 3),
]


@pytest.mark.parametrize("pd", PDS)
@given(steps_db=st.tuples(st.floats(-40, 60), st.floats(0.01, 60)), pfa=pfas)
def test_pd_grows_with_snr_from_pfa_to_one(pd, steps_db, pfa):
    weak, strong = pd(linear(np.cumsum(steps_db)), pfa)
    assert strong > weak or weak > 0.5
    assert pd(0.0, pfa) == pytest.approx(pfa, rel=1e-11)
    np.testing.assert_array_equal(pd([np.inf, np.nan, -0.1], pfa), [1, np.nan, np.nan])


@pytest.mark.parametrize("pfa", [0.0, -0.1, 1.1, np.nan, np.inf])
def test_no_pd_without_a_probability_of_false_alarm(pfa):
    found = [pd(10.0, pfa) for pd in PDS]
    found += [detection.cfar_multiplier(pfa, 16), detection.threshold_noncoherent(pfa, 3)]
    found += [*detection.pd_noncoherent_unequal_cfar([[1.0, 2.0]], pfa, 32)]
    assert np.isnan(found).all()


def test_shapes_broadcast():
    snr, pfa = np.ones((4, 1)), np.full(5, 1e-6)
    for pd in PDS:
        assert pd(snr, pfa).shape == (4, 5)
        assert pd(1.0, 1e-6).shape == ()
    assert detection.pd_logistic(snr, np.zeros(5)).shape == (4, 5)
    rng = np.random.default_rng(0)
    power, threshold = detection.draw_detected_snr_swerling1(snr, pfa, 16, rng)
    assert power.shape == threshold.shape == (4, 5)
    power, _ = detection.draw_detected_snr_swerling1([np.nan, np.inf], 1e-6, 16, rng)
    np.testing.assert_array_equal(power, [np.nan, np.inf])
    for of in (detection.pd_noncoherent_unequal_cfar, detection.inverse_detected_power_noncoherent):
        assert of(np.ones((4, 1, 3)), pfa, 48).shape == (4, 5)
        assert of(np.ones((0, 3)), 1e-6, 48).shape == (0,)
        each = [of([1e3, 1.0], one, 32) for one in (1e-6, 1e-3)]
        np.testing.assert_allclose(of([1e3, 1.0], [1e-6, 1e-3], 32), each, rtol=1e-12)
    drawn = detection.draw_detected_power_noncoherent(np.ones((0, 3)), 1e-6, 48, rng)
    assert [part.shape for part in drawn] == [(0,), (0,)]


def test_a_pd_of_a_trillionth_keeps_its_digits() -> None:
    looks, pfa, snr = 3, 1e-12, 1e-3
    threshold = detection.threshold_noncoherent(pfa, looks) / (1 + snr)
    exact = math.exp(-threshold) * (1 + threshold + threshold**2 / 2)  # order 3, by hand
    plain = 1 - gammainc(looks, threshold)
    ours = detection.pd_noncoherent_swerling2(snr, pfa, looks)
    assert abs(plain / exact - 1) > 1e-7
    assert ours == pytest.approx(exact, rel=1e-13)


def test_a_threshold_for_a_pfa_below_the_rounding_of_one() -> None:
    assert gammaincinv(3, 1 - 1e-17) == math.inf
    y = float(detection.threshold_noncoherent(1e-17, 3))
    assert math.exp(-y) * (1 + y + y**2 / 2) == pytest.approx(1e-17, rel=1e-13)


# Tabulated quantiles of gamma variables: against SciPy's inverse, and back through the tail.


RNG = np.random.default_rng(61)
PROBABILITIES = np.concatenate(
    [
        RNG.uniform(0, 1, 4_000),
        10 ** RNG.uniform(-30, 0, 4_000),
        10 ** RNG.uniform(-300, 0, 1_000),
        1 - 10 ** RNG.uniform(-15, 0, 4_000),
    ]
)


@pytest.mark.parametrize("order", [1, 2, 8, 199, 1000, 10**5, 10**7, 10**8])
def test_it_is_the_inverse_of_the_tail_to_1e_13(order: int) -> None:
    """SciPy's way back, by which high orders are held, loses the lowest 4e-6 of them."""
    found = detection.gamma_exceeded_with(PROBABILITIES, order)
    low = PROBABILITIES < 0.5
    if order <= 10**5:
        high = gammaincinv(order, 1 - PROBABILITIES)
        exact = np.where(low, gammainccinv(order, PROBABILITIES), high)
        np.testing.assert_allclose(found, exact, rtol=1e-13)
    usual = (PROBABILITIES > 1e-14) & (PROBABILITIES < 1 - 1e-5)
    back = np.where(low, gammaincc(order, found), gammainc(order, found))
    whole = np.where(low, PROBABILITIES, 1 - PROBABILITIES)
    np.testing.assert_allclose(back[usual], whole[usual], rtol=1e-9)


def test_ends_what_is_no_probability_and_what_depends_on_no_company() -> None:
    found = detection.gamma_exceeded_with(np.array([0.0, 1e-320, 0.5, 1.0, np.nan, -0.1]), 1.0)
    assert found[0] == np.inf
    assert 700 < found[1] < 740
    assert found[2] == pytest.approx(np.log(2), rel=1e-14)
    assert found[3] == 0.0
    assert np.isnan(found[4:]).all()
    some = PROBABILITIES[:300]
    alone = np.concatenate([detection.gamma_exceeded_with(p[None], 1000) for p in some])
    np.testing.assert_array_equal(detection.gamma_exceeded_with(some, 1000), alone)


# The mean of 1/x over detections of power x, which scales the variance of a radar's errors.


def test_mean_inverse_agrees_with_the_reference_where_the_noise_is_known() -> None:
    """With N reference cells the threshold scatters by 1/sqrt(N), which adds a few parts in N."""
    table = reference("fluctuating_rms_given_detection.csv")
    snr = linear(table["mean_snr_db"])
    for pfa in np.unique(table["pfa"]):
        rows = table["pfa"] == pfa
        rms = np.sqrt(detection.inverse_detected_snr(snr[rows], float(pfa), 10**9))
        np.testing.assert_allclose(rms, table["rms_inv_sqrt_inst_snr"][rows], rtol=1e-8)


def integrated(function, edges) -> float:
    reach = {"epsabs": 0.0, "epsrel": 1e-10, "limit": 400}
    return sum(integrate.quad(function, a, b, **reach)[0] for a, b in pairwise(edges))


# The energy detector: quadrature at 1e7 samples, the law given a hit.


@pytest.mark.parametrize("n_samples", [1e3, 1e7])
@pytest.mark.parametrize("pfa", [1e-1, 1e-12])
@pytest.mark.parametrize("strength", [0.0, 5.0])
def test_pd_keeps_its_digits_for_many_samples(
    n_samples: float, pfa: float, strength: float
) -> None:
    """Against a quadrature of the gamma density in Stirling's form, in units of its spread."""
    snr = strength / np.sqrt(n_samples)
    bound = float(detection.threshold_noncoherent(pfa, n_samples)) / (1 + snr)
    above = tail_above(bound, n_samples)
    found = float(detection.pd_noncoherent_swerling2(snr, pfa, n_samples))
    assert found == pytest.approx(above, rel=1e-9)
    if strength == 0:
        assert above == pytest.approx(pfa, rel=1e-9)


def tail_above(bound: float, n: float) -> float:
    """Probability that a gamma variable of order n is above a bound."""
    stirling = 1 / (12 * n) - 1 / (360 * n**3)

    def density(z: float) -> float:
        t = z / np.sqrt(n)  # x = n (1 + t); log1p(t) - t without the cancellation
        lost = sum((-1) ** k * t**k / k for k in range(2, 14))
        exponent = n * (np.log1p(t) - t) if abs(t) > 1e-2 else -n * lost
        return float(np.exp(exponent - np.log1p(t) - stirling) / np.sqrt(2 * np.pi))

    edge = (bound - n) / np.sqrt(n)
    return integrated(density, [edge, max(edge, 0) + 14])


@pytest.mark.parametrize(
    ("n_samples", "snr"), [(1, 10.0), (1, 1e6), (3, 0.0), (200, 0.2), (10**4, 0.01)]
)
def test_the_mean_inverse_of_a_pair_is_its_integral(n_samples: int, snr: float) -> None:
    """One strong sample is the worst: most are far above a threshold where it is largest."""
    pfa, mean = 1e-6, 1 + snr
    bound = float(detection.threshold_noncoherent(pfa, n_samples))
    law = stats.gamma(n_samples, scale=mean)

    def integrand(log_excess: float) -> float:
        excess = np.exp(log_excess)
        estimate = (bound + excess) / n_samples - 1
        return float(excess * law.pdf(bound + excess) * (1 / estimate + 1 / (2 * estimate**2)))

    most = np.log(60 * mean * max(n_samples, 1))
    expected = integrated(integrand, np.linspace(-30, most, 12)) / law.sf(bound)
    found = float(detection.inverse_paired_snr(snr, pfa, n_samples))
    assert found == pytest.approx(expected, rel=2e-3)


@given(
    st.floats(-100, 120).map(lambda db: 10 ** (db / 10)),
    cfar_pfas,
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
    assert 0 < float(detection.inverse_paired_snr(snr, pfa, n_samples)) < np.inf


# Looks of any ratios against a sum of reference samples: chances, powers, thresholds.


@settings(max_examples=40)
@given(snrs_db=st.sets(far_dbs, min_size=2, max_size=5), n=st.integers(1, 16), pfa=cfar_pfas)
def test_unequal_looks_agree_with_rational_arithmetic(snrs_db, n, pfa):
    """However far apart the looks are, or however close; in any order."""
    snrs = np.unique(linear(sorted(snrs_db)))
    n_samples = n * len(snrs)
    over = float(detection.threshold_noncoherent_cfar(pfa, len(snrs), n_samples))
    exact = unequal_pd(snrs, over, n_samples)
    of_oracle = oracle.of_unequal(1 + snrs[None], over, n_samples)
    np.testing.assert_allclose(of_oracle, exact, rtol=1e-12)
    both = detection.pd_noncoherent_unequal_cfar([snrs, snrs[::-1]], pfa, n_samples)
    np.testing.assert_allclose(both, exact, rtol=1e-11)


def test_mean_inverse_power_needs_no_more_points_and_minds_no_order(monkeypatch):
    def values(looks=((-100, 60, 100), (10,) * 8)):
        return [
            float(detection.inverse_detected_power_noncoherent(linear(v), pfa, 4 * len(v)))
            for v in looks
            for pfa in (1e-15, 0.1)
        ]

    coarse = values()
    np.testing.assert_allclose(coarse[:2], values([(100, -100, 60)]), rtol=1e-8)
    monkeypatch.setattr(detection, "unit_interval", lambda: unit_interval(300))
    np.testing.assert_allclose(coarse, values(), rtol=1e-8)


@given(snrs_db=several, n=cells, pfa=cfar_pfas, seed=st.integers(0, 1 << 32))
def test_draws_are_finite_and_above_their_thresholds(snrs_db, n, pfa, seed):
    looks = np.broadcast_to(linear(snrs_db), (20, len(snrs_db)))
    power, threshold = detection.draw_detected_power_noncoherent(
        looks, pfa, n * len(snrs_db), np.random.default_rng(seed)
    )
    assert np.isfinite(power).all()
    assert (threshold > 0).all()
    assert (power >= threshold).all()


def test_looks_beyond_all_measure_and_outside_the_domain():
    looks = [[np.inf, 0.0], [0.0, np.inf], [np.nan, 1.0], [1.0, -0.1]]
    pd = detection.pd_noncoherent_unequal_cfar(looks, 1e-6, 32)
    np.testing.assert_array_equal(pd, [1, 1, np.nan, np.nan])
    power, _ = detection.draw_detected_power_noncoherent(looks, 1e-6, 32, np.random.default_rng(0))
    np.testing.assert_array_equal(power, [np.inf, np.inf, np.nan, np.nan])


@pytest.mark.parametrize(("kept", "at_once"), [(0, 1 << 15), (2000, 1 << 15), (1 << 22, 1)])
def test_draws_do_not_depend_on_what_is_worked_out_at_once(monkeypatch, kept, at_once):
    """Neither on the tables that are kept nor on the parts in which they are filled."""
    snrs = 10 ** np.random.default_rng(22).uniform(-2, 2, (300, 4))

    def drawn():
        rng = np.random.default_rng(23)
        return detection.draw_detected_power_noncoherent(snrs, 1e-4, 24, rng)

    expected = drawn()
    monkeypatch.setattr(detection, "KEPT_ELEMENTS", kept)
    monkeypatch.setattr(detection, "BLOCK_ELEMENTS", at_once)
    np.testing.assert_array_equal(drawn(), expected)


# Swerling 0 to 4 by one series.


def test_swerlings_cases_are_as_in_sixty_digits() -> None:
    for args, value in values_of("pd_swerling_cfar"):
        case, n = int(args["case"]), int(args["n_looks"])
        cfar = FluctuatingCfar(float(args["pfa"]), n, int(args["n_reference"]))
        found = cfar.pd(linear([[float(args["snr_db"])]]), np.array([order_of(case, n)]))
        assert found[0] == pytest.approx(value, rel=1e-12), args


@pytest.mark.parametrize("snr", [0.0, 1e-6, 1.0, 30.0, 1e9])
def test_faint_and_strong_echoes_of_many_looks_cost_no_digits(snr: float) -> None:
    """Where the closed form of DiFranco and Rubin is NaN, and terms by the thousand are left."""
    pfa, at = 1e-6, np.array([snr])
    one = FluctuatingCfar(pfa, 1, 16).pd(at[:, None], np.ones(1))
    assert one == pytest.approx(detection.pd_cfar_swerling1(at, pfa, 16), rel=1e-12)
    eight = FluctuatingCfar(pfa, 8, 24).pd(at[:, None], np.full(1, 8.0))
    assert eight == pytest.approx(pd_equal(snr, pfa, 8, 24), rel=1e-12)
    orders = np.array([order_of(case, 100) for case in range(5)])
    by_case = FluctuatingCfar(pfa, 100, 200).pd(np.full((5, 1), snr), orders)
    assert pfa * (1 - 1e-11) <= min(by_case) <= max(by_case) <= 1.0


@pytest.mark.parametrize("case", range(5))
@pytest.mark.parametrize(("n_looks", "snr"), [(1, 4.0), (1, 4e4), (4, 6.0)])
def test_what_was_detected_is_drawn_as_a_receiver_would_find_it(
    case: int, n_looks: int, snr: float
) -> None:
    """Strengths, echoes and reference samples drawn plainly, and those that hit kept."""
    rng = np.random.default_rng(100 * case + n_looks)
    n, m, pfa, order = 20_000, 16, 1e-3, order_of(case, n_looks)
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
    over = float(detection.threshold_noncoherent_cfar(pfa, n_looks, m))
    threshold = over * rng.standard_gamma(m, n)
    hit = power > threshold
    pd = float(cfar.pd(np.array([[snr]]), np.array([order]))[0])
    assert_sum(hit.sum(), n * pd, n * pd * (1 - pd) + 1e-9, "hits")
    few = min(int(hit.sum()), 2000)
    drawn, thresholds = cfar.draw_detected(np.full((few, 1), snr), np.full(few, order), rng)
    assert (drawn >= thresholds).all()
    for plain, of_draws, of in ((power, drawn, "power"), (threshold, thresholds, "threshold")):
        assert_chance(float(stats.ks_2samp(of_draws, plain[hit]).pvalue), of)
    inverse = cfar.inverse_detected(np.array([[snr]]), np.array([order]))[0]
    spread = (1 / power[hit]).std() / np.sqrt(hit.sum())
    assert abs((1 / power[hit]).mean() - inverse) < 5 * spread + 1e-3 * inverse


def test_the_mean_inverse_of_one_look_is_that_of_swerling_1() -> None:
    cfar, snr = FluctuatingCfar(1e-6, 1, 16), np.array([[0.1, 1.0, 10.0, 1e3, 1e5]]).T
    stated, usual = (cfar.inverse_detected(snr, order) for order in (np.ones(5), None))
    np.testing.assert_allclose(stated, usual, rtol=1e-4)


def test_no_draw_of_a_target_depends_on_how_others_fluctuate() -> None:
    cfar, snr = FluctuatingCfar(1e-6, 1, 16), np.full((6, 1), 20.0)
    mixed = np.array([1.0, np.inf, 2.0, 1.0, 2.0, np.inf])
    together, alike = (
        cfar.draw_detected(snr, order, np.random.default_rng(3)) for order in (mixed, np.ones(6))
    )
    for a, b in zip(together, alike, strict=True):
        np.testing.assert_array_equal(a[[0, 3]], b[[0, 3]])


def test_two_hits_at_one_amplitude_are_as_likely_as_integrated() -> None:
    for args, value in values_of("joint_hit_gauss_markov"):
        found = joint_hit_gauss_markov(
            linear(float(args["snr_db"])), float(args["pfa"]), float(args["rho"])
        )
        assert found == pytest.approx(value, rel=1e-10)


def test_poisson_numbers_are_those_of_the_inverse_to_the_last_one() -> None:
    mean = np.repeat([950.0, 1e4, 1e6], 400)
    levels = np.concatenate([np.linspace(1e-6, 1 - 1e-6, 396), [1e-16, 1e-9, 0.5, 1 - 1e-14]])
    u = np.tile(levels, 3)
    found = _poisson(mean, u)
    assert (pdtr(found, mean) >= u).all()
    assert (pdtr(found - 1, mean) < u).all()


# False alarms: how many, at the stated rate however rare, and how sectors share them.


@pytest.mark.parametrize(
    ("count", "pfa"), [(7620, 1e-2), (10**12, 1e-9), (10**12, 1e-15), (5, 0.5)]
)
def test_counts_are_binomial_and_almost_never_is_not_never(count, pfa):
    rng, n = np.random.default_rng(3), 20_000
    found = np.array([detection.draw_count(count, pfa, rng) for _ in range(n)])
    mean = count * pfa
    assert_sum(float(found.sum()), n * mean, n * mean * (1 - pfa))
    some = -np.expm1(count * np.log1p(-pfa))
    assert_sum(float((found > 0).sum()), n * some, n * some * (1 - some) + 1e-9)
    if mean > 0.1:
        spread = n * (2 * (mean * (1 - pfa)) ** 2 + mean)
        assert_sum(float(((found - mean) ** 2).sum()), n * mean * (1 - pfa), spread)


def test_counts_where_there_are_no_cells_or_all_alarm():
    rng = np.random.default_rng(4)
    cases = ((0, 0.1), (100, 0.0), (100, 1.0))
    assert [detection.draw_count(count, pfa, rng) for count, pfa in cases] == [0, 0, 100]
    assert detection.cells_across(10.0, 30.0) == 1  # a beam wider than the cover
    assert detection.cells_across(110.0, 30.0) == pytest.approx(11 / 3, rel=1e-15)


@given(st.floats(1e-6, 1e12), st.floats(1e-15, 0.1))
def test_whole_cells_alarm_as_often_on_average(count, pfa):
    whole, each = detection.whole_cells(count, pfa)
    assert isinstance(whole, int)
    assert whole * each == pytest.approx(count * pfa, rel=1e-12)
    assert whole >= count * (1 - 1e-11)
    assert each <= pfa


@given(st.integers(0, 10**12), st.lists(st.floats(0, 1), max_size=40), st.integers(1, 720))
def test_sectors_share_a_scan_out_exactly_and_equal_ones_alike(total, borders, n):
    """Equal ones to a cell, though the borders that two sectors share are rounded differently."""
    parts = [
        detection.cells_between(total, a, b) for a, b in pairwise([0.0, *sorted(borders), 1.0])
    ]
    assert sum(parts) == total
    assert min(parts) >= 0
    few = total % 10**9
    equal = [
        detection.cells_between(few, i / n, 1.0 if i + 1 == n else (i + 1) * (1.0 / n))
        for i in range(n)
    ]
    assert sum(equal) == few
    assert max(equal) - min(equal) <= 1

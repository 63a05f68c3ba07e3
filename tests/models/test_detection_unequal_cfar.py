"""Looks of any SNRs against a sum of reference samples: chances, powers, thresholds.

Against rational arithmetic, numerical integration, and the detector drawn sample by sample; the
random tests fail a right programme for one seed in 10,000.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.integrate import quad
from scipy.special import exp1
from support import mimo_equations
from support.significance import assert_chance

from plotfeed.feeds.lab import oracle
from plotfeed.models import detection
from plotfeed.models.numerics import unit_interval

snr_dbs = st.floats(-100, 100)
pfas = st.floats(-15, -1).map(lambda exponent: 10.0**exponent)
cells = st.integers(1, 40)
several = st.lists(snr_dbs, min_size=1, max_size=6)


def linear(decibels):
    return 10 ** (np.asarray(decibels, dtype=np.float64) / 10)


@given(snr_db=st.floats(-60, 60), n_looks=st.integers(1, 8), n=cells, pfa=pfas)
def test_equal_looks_are_a_case_of_unequal_ones(snr_db, n_looks, n, pfa):
    design = (pfa, n_looks, n * n_looks)
    pd = detection.pd_noncoherent_unequal_cfar(np.full(n_looks, linear(snr_db)), pfa, n * n_looks)
    assert pd == pytest.approx(
        detection.pd_noncoherent_cfar(linear(snr_db), *design), rel=1e-12, abs=0
    )


@given(n_looks=st.integers(1, 32), n=st.integers(1, 16), pfa=pfas)
def test_noise_alone_alarms_at_the_stated_rate(n_looks, n, pfa):
    pd = detection.pd_noncoherent_unequal_cfar(np.zeros(n_looks), pfa, n * n_looks)
    assert pd == pytest.approx(pfa, rel=1e-11)


@settings(max_examples=60)
@given(snrs_db=st.sets(snr_dbs, min_size=2, max_size=5), n=st.integers(1, 16), pfa=pfas)
def test_unequal_looks_agree_with_rational_arithmetic(snrs_db, n, pfa):
    """However far apart the looks are, or however close."""
    snrs = np.unique(linear(sorted(snrs_db)))
    n_samples = n * len(snrs)
    over = float(detection.threshold_noncoherent_cfar(pfa, len(snrs), n_samples))
    exact = mimo_equations.pd(snrs, over, n_samples)
    of_oracle = oracle.of_unequal(1 + snrs[None], over, n_samples)
    np.testing.assert_allclose(of_oracle, exact, rtol=1e-12)
    assert detection.pd_noncoherent_unequal_cfar(snrs, pfa, n_samples) == pytest.approx(
        exact, rel=1e-12, abs=0
    )


@pytest.mark.parametrize("n_samples", [4000, 40_000])
def test_many_reference_samples_come_to_known_noise(n_samples):
    snrs = linear([14.0, 8.0, -20.0])
    known = detection.pd_noncoherent_unequal(snrs, 1e-6)
    assert detection.pd_noncoherent_unequal_cfar(snrs, 1e-6, n_samples) == pytest.approx(
        known, rel=60 / n_samples
    )


DRAWS = [
    ((13, 8, 3), 1e-4, 10, 200_000, 11),
    ((-100, 16), 1e-3, 4, 200_000, 12),  # the strong look last
    ((16, -100), 1e-3, 4, 200_000, 13),  # and first
    ((5, 5, 5, 0, -5), 1e-4, 8, 200_000, 14),
    ((-300, -300, -300), 1e-2, 2, 2_000_000, 15),  # false alarms
    ((3, 20), 1e-2, 1, 200_000, 16),  # a threshold that swings by orders of magnitude
]


@pytest.mark.parametrize(("snrs_db", "pfa", "n", "trials", "seed"), DRAWS)
def test_detected_powers_follow_the_raw_process(snrs_db, pfa, n, trials, seed):
    """Powers, thresholds and their ratios, as where trials without a hit are thrown away."""
    rng = np.random.default_rng(seed)
    snrs = linear(snrs_db)
    n_samples = n * len(snrs)
    raw_power, raw_threshold = mimo_equations.raw_detections(snrs, pfa, n_samples, trials, rng)
    assert len(raw_power) > 2000
    looks = np.broadcast_to(snrs, (100_000, len(snrs)))
    power, threshold = detection.draw_detected_power_noncoherent(looks, pfa, n_samples, rng)
    assert (power > threshold).all()
    for drawn, kept, of in (
        (power, raw_power, "power"),
        (threshold, raw_threshold, "threshold"),
        (power - threshold, raw_power - raw_threshold, "excess"),
        (power / threshold, raw_power / raw_threshold, "ratio"),
    ):
        assert_chance(float(stats.ks_2samp(drawn, kept).pvalue), of)


def test_draws_of_many_targets_are_each_their_own():
    """Targets of different ratios in one call, over several blocks of the tables."""
    snrs = np.tile(linear([[20.0, 3.0], [-100.0, 12.0]]), (40_000, 1))
    assert snrs.size * (32 + 1) > detection.BLOCK_ELEMENTS
    rng = np.random.default_rng(21)
    power, _ = detection.draw_detected_power_noncoherent(snrs, 1e-4, 32, rng)
    for kind in (0, 1):
        raw, _ = mimo_equations.raw_detections(snrs[kind], 1e-4, 32, 60_000, rng)
        assert_chance(float(stats.ks_2samp(power[kind::2], raw).pvalue))


@pytest.mark.parametrize(("snr", "n"), [(9.0, 1), (9.0, 16), (0.0, 2), (1e6, 16)])
def test_mean_inverse_power_of_one_look_agrees_with_an_integral(snr, n):
    """Given a threshold y, the mean of 1/x over x > y is exp(y/m) E1(y/m)/m."""
    over, mean = oracle.cfar_ratio(1e-6, 1, n), 1 + snr

    def integrand(log_reference):
        reference = np.exp(log_reference)
        density = reference * stats.gamma.pdf(reference, n)
        return density * exp1(over * reference / mean) / mean

    edges = pairwise(np.linspace(-40, 6, 24))
    total = sum(quad(integrand, *edge, epsabs=0, epsrel=1e-12)[0] for edge in edges)
    exact = total / float(detection.pd_cfar_swerling1(snr, 1e-6, n))
    got = detection.inverse_detected_power_noncoherent([snr], 1e-6, n)
    assert got == pytest.approx(exact, rel=1e-8)


def test_mean_inverse_power_needs_no_more_points(monkeypatch):
    boxes = [(v, n) for v in ((-100, 60, 100), (10,) * 8, (-100, 100)) for n in (1, 16)]

    def values():
        return [
            float(detection.inverse_detected_power_noncoherent(linear(v), pfa, n * len(v)))
            for v, n in boxes
            for pfa in (1e-15, 0.1)
        ]

    coarse = values()
    monkeypatch.setattr(detection, "unit_interval", lambda: unit_interval(400))
    np.testing.assert_allclose(coarse, values(), rtol=1e-8)


@given(snrs_db=several, n=cells, pfa=pfas)
def test_no_pd_passes_one(snrs_db, n, pfa):
    pd = detection.pd_noncoherent_unequal_cfar(linear(snrs_db), pfa, n * len(snrs_db))
    assert 0 <= pd <= 1


@given(snrs_db=several, n=cells, pfa=pfas, more_db=st.floats(0, 60), data=st.data())
def test_pd_grows_with_each_snr(snrs_db, n, pfa, more_db, data):
    which = data.draw(st.integers(0, len(snrs_db) - 1))
    louder = list(snrs_db)
    louder[which] += more_db
    pd = detection.pd_noncoherent_unequal_cfar(linear([snrs_db, louder]), pfa, n * len(snrs_db))
    assert pd[1] >= pd[0] * (1 - 1e-12)


@settings(max_examples=40)
@given(snrs_db=several, n=st.integers(1, 10), pfa=pfas)
def test_the_order_of_the_looks_does_not_matter(snrs_db, n, pfa):
    n_samples = n * len(snrs_db)
    forth, back = detection.pd_noncoherent_unequal_cfar(
        linear([snrs_db, snrs_db[::-1]]), pfa, n_samples
    )
    assert forth == pytest.approx(back, rel=1e-11)
    one, other = detection.inverse_detected_power_noncoherent(
        linear([snrs_db, snrs_db[::-1]]), pfa, n_samples
    )
    assert one == pytest.approx(other, rel=1e-8)


@given(snrs_db=several, n=cells, pfa=pfas, seed=st.integers(0, 1 << 32))
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
    for pfa in (0.0, -0.1, 1.1, np.nan):
        assert np.isnan(detection.pd_noncoherent_unequal_cfar([1.0, 2.0], pfa, 32)).all()


def test_shapes_broadcast():
    for function in (
        detection.pd_noncoherent_unequal_cfar,
        detection.inverse_detected_power_noncoherent,
    ):
        assert function(np.ones((4, 1, 3)), np.full(5, 1e-6), 48).shape == (4, 5)
        assert function(np.ones((0, 3)), 1e-6, 48).shape == (0,)
        assert function(np.ones(3), 1e-6, 48).shape == ()
        for snr in (1.0, 1e3):  # looks and probabilities of false alarm, as many of each
            each = [function([snr, 1.0], pfa, 32) for pfa in (1e-6, 1e-3)]
            np.testing.assert_allclose(function([snr, 1.0], [1e-6, 1e-3], 32), each, rtol=1e-12)
    rng = np.random.default_rng(0)
    for part in detection.draw_detected_power_noncoherent(np.ones((0, 3)), 1e-6, 48, rng):
        assert part.shape == (0,)


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

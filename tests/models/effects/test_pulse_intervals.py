"""Folds, eclipses, blind speeds and M of N, beside closed forms and plain draws."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from support.given_files import values_of

from plotfeed.models.effects.pulse_intervals import (
    CANCELLERS,
    PassingBeam,
    PulseIntervals,
    at_least,
    chosen,
    filter_factor,
    first_successes,
    folded_range_m,
)
from plotfeed.models.propagation import C_M_S

WAVELENGTH_M = 0.03


def intervals(**more: object) -> PulseIntervals:
    keys = {"prfs_hz": (5000.0,), "needed": 1, "interval_s": 1e-3, "pulse_s": 0.0}
    return PulseIntervals(**(keys | {"wavelength_m": WAVELENGTH_M} | more))  # type: ignore[arg-type]


@given(st.floats(0, 1e6), st.floats(10, 1e6))
def test_ranges_fold_below_what_is_unambiguous_by_whole_folds(
    range_m: float, prf_hz: float
) -> None:
    folds_at_m = C_M_S / (2 * prf_hz)
    told_m = float(folded_range_m(range_m, prf_hz))
    assert 0 <= told_m <= folds_at_m
    folds = (range_m - told_m) / folds_at_m
    assert folds == pytest.approx(round(folds), abs=1e-6 * max(folds, 1))


@pytest.mark.parametrize("canceller", CANCELLERS)
def test_cancellers_leave_the_power_of_noise(canceller: str) -> None:
    rate_m_s = WAVELENGTH_M * 5000.0 / 2 * (np.arange(10_000) + 0.5) / 10_000
    gain = filter_factor(rate_m_s, 5000.0, WAVELENGTH_M, canceller)
    assert gain.mean() == pytest.approx(1.0, rel=1e-12)


def test_close_to_a_blind_speed_no_digit_of_the_gain_is_lost() -> None:
    for args, value in values_of("canceller_gain"):
        prf_hz, off = float(args["prf_hz"]), float(args["off_m_s"])
        blind_m_s = WAVELENGTH_M * prf_hz / 2
        found = filter_factor(off, prf_hz, WAVELENGTH_M, args["kind"])
        assert found == pytest.approx(value, rel=1e-12)
        far = filter_factor(1024 * blind_m_s + off, prf_hz, WAVELENGTH_M, args["kind"])
        assert far == pytest.approx(value, rel=1e-4)


def test_staggered_frequencies_leave_no_speed_of_drones_blind() -> None:
    """Blind at 17, 19 and 23 m/s with notches of 2: nowhere all at once from 2 to 40 m/s."""
    blind_m_s = np.array([17.0, 19.0, 23.0])
    stagger = intervals(prfs_hz=tuple(2 * blind_m_s / WAVELENGTH_M), notch_m_s=2.0)
    rate_m_s = np.linspace(2.0, 40.0, 4000)
    far = np.full(len(rate_m_s), 100.0)
    factor = stagger.power_factor(far, rate_m_s, None)
    assert (factor.max(axis=1) >= 1 - np.exp(-1) - 1e-12).all()
    assert (factor.min(axis=0) < 1e-3).all()
    assert stagger.folds_at_m is None
    assert intervals().folds_at_m == pytest.approx(29_979.2458)


def test_so_many_of_equal_trials_are_binomial_and_of_others_and_the_first_as_counted() -> None:
    p = np.linspace(1e-9, 1 - 1e-9, 50)
    for n, needed in ((1, 1), (3, 2), (8, 3), (8, 8)):
        found = at_least(np.repeat(p[:, None], n, axis=1), needed)
        np.testing.assert_allclose(found, stats.binom.sf(needed - 1, n, p), rtol=1e-12)
        made = intervals(prfs_hz=(5000.0,) * n, needed=needed)
        expected = stats.binom.sf(needed - 1, n, 1e-6)
        assert made.false_alarm_probability(1e-6) == pytest.approx(expected, rel=1e-12)
    chances = np.array([0.9, 0.2, 0.5, 0.05])
    hits = np.array(list(product([False, True], repeat=4)))
    odds = np.where(hits, chances, 1 - chances).prod(axis=1)
    for needed in (1, 2, 3, 4):
        enough = hits.sum(axis=1) >= needed
        assert at_least(chances[None], needed) == pytest.approx(odds[enough].sum(), rel=1e-12)
        first, of_first = first_successes(chances[None], needed)[0], hits[enough].argmax(axis=1)
        expected = np.bincount(of_first, odds[enough], minlength=4) / odds[enough].sum()
        assert first == pytest.approx(expected, abs=1e-12)
    drawn = np.array([0.0, 0.299, 0.301, 0.999])
    assert chosen(np.tile([[0.3, 0.0, 0.7]], (4, 1)), drawn).tolist() == [0, 0, 2, 2]


def test_intervals_lie_about_the_time_at_which_the_beam_meets_a_target() -> None:
    """Wherever in one that time is, they are that far apart, and one of them holds it."""
    beam = PassingBeam(beamwidth_deg=2.0, step_deg=0.5)
    made = intervals(prfs_hz=(5000.0,) * 4, beam=beam)
    for into_ns in (0, 250_000, 999_999):
        off = made._offsets_deg(beam, np.array([into_ns]))[0]
        np.testing.assert_allclose(np.diff(off), 0.5)
        assert np.abs(off).min() <= 0.25 + 1e-12

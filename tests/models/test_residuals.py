"""Checks of residuals: each fault by its own name, and false verdicts as often as is said."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from support.significance import assert_chance

from plotfeed.models.residuals import (
    Candidates,
    Check,
    ErrorSums,
    LookOdds,
    LookSums,
    MeasuredQuantity,
    Residuals,
    always_valid,
    clutter_check,
    look_groups,
    plot_pairs,
    wrong_at,
)

BOTH = (MeasuredQuantity("range", "m"), MeasuredQuantity("azimuth", "deg"))


def made_up(
    rng: np.random.Generator,
    n: int = 60,
    *,
    bias: tuple[float, float] = (0.0, 0.0),
    late_s: float = 0.0,
    spread: float = 1.0,
    rho: float = 0.0,
    rate: np.ndarray | None = None,
) -> Residuals:
    """Errors of 5 m and 0.3 degrees of a drone that comes, turns and goes."""
    t_s = np.arange(float(n))
    if rate is None:
        turn = 2 * np.pi * t_s / n
        rate = np.stack([15.0 * np.cos(turn), 0.4 * np.sin(turn)], axis=1)
    sigma = np.tile([5.0, 0.3], (n, 1))
    noise = rng.standard_normal((n, 2))
    for i in range(1, n) if rho else ():
        noise[i] = rho * noise[i - 1] + math.sqrt(1 - rho**2) * noise[i]
    return Residuals(
        target=np.zeros(n, np.int64),
        t_s=t_s,
        error=np.array(bias) - late_s * rate + spread * sigma * noise,
        sigma=sigma,
        rate=rate,
        kurtosis=np.full((n, 2), 3.0),
    )


def error_checks(
    residuals: Residuals, quantities: tuple[MeasuredQuantity, ...] = BOTH
) -> list[Check]:
    """In two parts, as if they had been taken one after the other."""
    sums, half = ErrorSums(quantities), len(residuals) // 2
    sums.add(residuals.between(0, half))
    sums.add(residuals.between(half, len(residuals)))
    return sums.checks()


def checks(residuals: Residuals) -> dict[str, Check]:
    return {c.name: c for c in error_checks(residuals)}


def wrong(residuals: Residuals) -> set[str]:
    found = error_checks(residuals)
    return {c.name for c, w in zip(found, wrong_at(found, 0.01), strict=True) if w}


@pytest.mark.parametrize(
    ("planted", "named"),
    [
        ({"bias": (0.0, 2.0)}, {"azimuth"}),
        ({"bias": (40.0, 0.0)}, {"range"}),
        ({"late_s": 1.5}, {"time"}),
        ({"spread": 2.5}, {"range spread", "azimuth spread"}),
    ],
)
def test_a_fault_has_its_name_and_no_other(planted: dict[str, object], named: set[str]) -> None:
    rng = np.random.default_rng(1)
    found = [wrong(made_up(rng, **planted)) for _ in range(100)]  # type: ignore[arg-type]
    # The other checks fail together at 1 % at most: 8 of 100 by chance less than once in 10,000.
    assert sum(named <= each for each in found) >= 99
    assert sum(each == named for each in found) >= 92


def test_where_all_is_right_one_in_a_hundred_is_called_wrong_at_most() -> None:
    rng = np.random.default_rng(2)
    failed = sum(bool(wrong(made_up(rng))) for _ in range(1000))
    assert_chance(float(stats.binom.sf(failed - 1, 1000, 0.01)), f"{failed} of 1000")


def test_what_is_fitted_is_what_was_planted() -> None:
    rng = np.random.default_rng(3)
    found = [checks(made_up(rng, bias=(12.0, 0.5), late_s=0.7)) for _ in range(400)]
    for name, planted in (("range", 12.0), ("azimuth", 0.5), ("time", 0.7)):
        errors = np.array([(each[name].found - planted) / each[name].sigma for each in found])
        assert_chance(float(stats.kstest(errors, "norm").pvalue), name)


def test_errors_that_follow_each_other_are_not_taken_for_many() -> None:
    """Of 60 errors with a correlation of 0.6 there are 15; counted as 60, a quarter would fail."""
    rng = np.random.default_rng(4)
    found = [wrong(made_up(rng, n=240, rho=0.6)) & {"range", "azimuth", "time"} for _ in range(300)]
    failed = sum(map(bool, found))
    assert failed < 18  # 6 %; what is known of the correlation is an estimate


@pytest.mark.parametrize(
    ("rate", "why"),
    [
        (np.zeros((60, 2)), "hardly move"),
        (np.tile([0.0, 0.4], (60, 1)), "looks like a systematic error"),
    ],
)
def test_what_the_paths_cannot_tell_is_not_judged(rate: np.ndarray, why: str) -> None:
    found = {
        c.name: c for c in error_checks(made_up(np.random.default_rng(5), rate=rate, late_s=3.0))
    }
    assert math.isnan(found["time"].p)
    assert why in found["time"].why_not
    if rate.any():  # three seconds across are 1.2 degrees: something is wrong, one or the other
        assert found["azimuth or time"].p < 1e-6


def test_what_is_not_known_of_odds_is_no_fault_and_what_is_beyond_that_is() -> None:
    """Of 2,000 looks 8 % too few are found, of which 1 % is open: one run in 10,000 fails."""
    rng = np.random.default_rng(9)
    of = odds(rng, np.full(2000, 0.9), 0.92)
    open_to = (np.full(2000, off) for off in (0.0, 0.01, 0.2))
    sure, nearly, wide = (detection_check(of.but(off=each), 0.0).p for each in open_to)
    assert sure < nearly < 1e-4
    assert wide > 0.5
    assert detection_check(of.but(off=None), 0.0).p == sure


def test_few_plots_are_not_judged() -> None:
    found = error_checks(made_up(np.random.default_rng(6), n=7))
    assert len(found) == 5
    assert all(math.isnan(c.p) and "8 are needed" in c.why_not for c in found)
    assert not any(wrong_at(found, 0.01))


def odds(rng: np.random.Generator, pd: np.ndarray, factor: float = 1.0) -> LookOdds:
    n = len(pd)
    return LookOdds(
        target=np.zeros(n, np.int64),
        t_s=np.arange(float(n)),
        pd=pd,
        hit=rng.random(n) < factor * pd,
    )


def detection_check(looks: LookOdds, false_per_look: float) -> Check:
    sums = LookSums()
    sums.add(looks, np.linspace(100.0, 9000.0, len(looks)), false_per_look)
    return sums.check()


def test_detections_fail_as_often_as_is_said_and_where_they_are_fewer() -> None:
    rng = np.random.default_rng(7)
    pd = rng.uniform(0.8, 0.999, 60)
    p = np.array([detection_check(odds(rng, pd), 0.0).p for _ in range(400)])
    assert_chance(float(stats.binom.sf((p < 0.01).sum() - 1, 400, 0.01)), "too often")
    fewer = [detection_check(odds(rng, pd, 0.6), 0.0).p for _ in range(100)]
    assert sum(each < 1e-3 for each in fewer) >= 95
    certain = detection_check(odds(rng, np.ones(10)), 0.0)
    assert math.isnan(certain.p)
    assert detection_check(odds(rng, np.ones(10), 0.5), 0.0).p == 0.0


def test_false_alarms_are_counted_by_poisson() -> None:
    assert clutter_check(10, 10.0, 5.0, 0.0).p > 0.5
    assert clutter_check(40, 10.0, 5.0, 0.0).p < 1e-9
    assert clutter_check(0, 10.0, 5.0, 0.0).p < 1e-3
    assert clutter_check(0, 0.0, 5.0, 0.0).p == 1.0


def test_who_looks_time_and_again_is_wrong_no_more_often() -> None:
    """Robbins' bound beside the plain one, at each of 300 looks at a sum that grows."""
    rng = np.random.default_rng(8)
    sums = rng.standard_normal((2000, 300)).cumsum(axis=1)
    n = np.arange(1, 301)
    z = sums / np.sqrt(n)
    bound = np.array([_bound(int(k), 0.01) for k in n])
    ever = int((np.abs(z) >= bound).any(axis=1).sum())
    assert_chance(float(stats.binom.sf(ever - 1, 2000, 0.01)), f"{ever} of 2000")
    plain = int((np.abs(z) >= stats.norm.isf(0.005)).any(axis=1).sum())
    assert plain > 100  # what it is for


def _bound(n: int, rate: float) -> float:
    """The least z that the check calls wrong, found by asking it."""
    low, high = 0.0, 30.0
    for _ in range(40):
        z = (low + high) / 2
        check = Check(
            name="x", expected=0.0, found=1.0, sigma=1.0, p=2 * float(stats.norm.sf(z)), of=n
        )
        low, high = (low, z) if always_valid(check, rate) else (z, high)
    return high


# Pairs of plots and looks: found wherever the plots are off, and not made of clutter.


REACH = np.array([8.0, 500.0])


def candidates(
    rng: np.random.Generator,
    looks: int = 120,
    *,
    off: tuple[float, float] = (0.0, 0.0),
    spread: float = 1.0,
    pd: float = 0.9,
    clutter: float = 0.2,
) -> tuple[Candidates, int]:
    """Plots of looks, errors of 0.1 degrees and 5 m, and clutter about each; how many are real."""
    hit = np.flatnonzero(rng.random(looks) < pd)
    real = np.array(off) + spread * np.array([0.1, 5.0]) * rng.standard_normal((len(hit), 2))
    around = np.repeat(np.arange(looks), rng.poisson(clutter, looks))
    false = rng.uniform(-1, 1, (len(around), 2)) * [8.0, 500.0]
    error = np.concatenate([real, false])
    return (
        Candidates(
            plot=np.arange(len(error)),
            look=np.concatenate([hit, around]),
            error=error,
            sigma=np.tile([0.1, 5.0], (len(error), 1)),
        ),
        len(hit),
    )


@pytest.mark.parametrize("clutter", [0.0, 0.2, 2.0])
@pytest.mark.parametrize("off", [(0.0, 0.0), (2.0, 0.0), (0.0, 120.0), (-3.0, -60.0)])
def test_plots_are_found_however_far_they_are_off(off: tuple[float, float], clutter: float) -> None:
    found, real = candidates(np.random.default_rng(1), off=off, clutter=clutter)
    pairs = plot_pairs(found, REACH, 120)
    assert (pairs.chosen < real).sum() >= real - 1  # five standard deviations, seldom more
    assert (pairs.chosen >= real).sum() <= 3
    assert (np.abs(pairs.centre - off) <= [0.2, 10.0]).all()


def test_a_gate_is_as_wide_as_errors_are_and_no_wider_for_clutter() -> None:
    rng = np.random.default_rng(2)
    wide, real = candidates(rng, spread=2.5)
    pairs = plot_pairs(wide, REACH, 120)
    assert (pairs.chosen < real).sum() >= real - 1
    assert (pairs.gate > 9).all()
    dense, _ = candidates(rng, pd=0.2, clutter=20.0)
    assert (plot_pairs(dense, REACH, 120).gate == 5.0).all()


def test_what_is_false_in_gates_is_counted_beside_them() -> None:
    rng = np.random.default_rng(3)
    found, _ = candidates(rng, looks=4000, pd=0.5, clutter=5.0)
    pairs = plot_pairs(found, REACH, 4000)
    expected = 5.0 * (1.0 / 16.0) * (50.0 / 1000.0)  # the gate's share of the area
    assert abs(pairs.false_per_look / expected - 1) < 0.15


def test_no_plot_and_no_look_is_taken_twice() -> None:
    both = Candidates(
        plot=np.array([0, 0, 1, 1]),
        look=np.array([0, 1, 0, 1]),
        error=np.array([[0.0, 0.0], [0.1, 5.0], [0.2, 0.0], [0.0, 1.0]]),
        sigma=np.tile([0.1, 5.0], (4, 1)),
    )
    pairs = plot_pairs(both, REACH, 2)
    assert pairs.chosen.tolist() == [0, 3]


def test_plots_of_a_coarse_channel_are_looked_for_as_far_as_their_own_errors_go() -> None:
    """Errors of 300 m beside many of 5 m, of which the usual one is."""
    rng = np.random.default_rng(5)
    sigma = np.repeat([[0.1, 5.0], [0.1, 300.0]], [300, 100], axis=0)
    found = Candidates(
        plot=np.arange(400),
        look=np.arange(400),
        error=sigma * rng.standard_normal((400, 2)),
        sigma=sigma,
    )
    assert len(plot_pairs(found, REACH, 400).chosen) == 400


def test_looks_form_groups_within_the_widths_that_plots_do_not_tell_apart() -> None:
    azimuth_deg = np.array([359.9, 0.3, 1.0, 90.0, 0.2])
    range_m = np.array([100.0, 103.0, 106.0, 100.0, 500.0])
    group = look_groups([(azimuth_deg / 1.0, 360.0), (range_m / 10.0, 0.0)])
    assert group[0] == group[1] == group[2]  # over north, the ends by what is between
    assert len({*group.tolist()}) == 3
    assert look_groups([(np.zeros(1), 0.0)]).tolist() == [0]

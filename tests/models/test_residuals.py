"""Residuals, and verdicts on limits with the risks that they state."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import brentq
from scipy.signal import lfilter
from support.significance import assert_chance, assert_sum

from plotfeed.models.residuals import (
    Check,
    ErrorSums,
    LookOdds,
    LookSums,
    MeasuredQuantity,
    Residuals,
    always_valid,
    clutter_check,
    wrong_at,
)
from plotfeed.models.verdicts import (
    RISK,
    FigureSamples,
    Interval,
    breaking_level,
    decided,
    look_risk,
    mean_interval,
    ratio_interval,
    seeds_interval,
)

BOTH = (MeasuredQuantity("range", "m"), MeasuredQuantity("azimuth", "deg"))


def made_up(
    rng: np.random.Generator,
    n: int = 60,
    *,
    late_s: float = 0.0,
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
        error=sigma * noise - late_s * rate,
        sigma=sigma,
        rate=rate,
        kurtosis=np.full((n, 2), 3.0),
    )


def error_checks(
    residuals: Residuals, quantities: tuple[MeasuredQuantity, ...] = BOTH
) -> list[Check]:
    """In two parts, as if they had been taken one after the other."""
    sums, half = ErrorSums(quantities), len(residuals) // 2
    for part in (residuals.between(0, half), residuals.between(half, len(residuals))):
        sums.add(part)
    return sums.checks()


def wrong(residuals: Residuals) -> set[str]:
    found = error_checks(residuals)
    return {c.name for c, w in zip(found, wrong_at(found, 0.01), strict=True) if w}


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
    sure, nearly, wide = (detection_check(of.but(off=each)).p for each in open_to)
    assert sure < nearly < 1e-4
    assert wide > 0.5
    assert detection_check(of.but(off=None)).p == sure


def odds(rng: np.random.Generator, pd: np.ndarray, factor: float = 1.0) -> LookOdds:
    n = len(pd)
    return LookOdds(
        target=np.zeros(n, np.int64),
        t_s=np.arange(float(n)),
        pd=pd,
        hit=rng.random(n) < factor * pd,
    )


def detection_check(looks: LookOdds) -> Check:
    sums = LookSums()
    sums.add(looks, np.linspace(100.0, 9000.0, len(looks)))
    return sums.check()


def test_detections_fail_as_often_as_is_said_and_where_they_are_fewer() -> None:
    rng = np.random.default_rng(7)
    pd = rng.uniform(0.8, 0.999, 60)
    p = np.array([detection_check(odds(rng, pd)).p for _ in range(400)])
    assert_chance(float(stats.binom.sf((p < 0.01).sum() - 1, 400, 0.01)), "too often")
    fewer = [detection_check(odds(rng, pd, 0.6)).p for _ in range(100)]
    assert sum(each < 1e-3 for each in fewer) >= 95
    certain = detection_check(odds(rng, np.ones(10)))
    assert math.isnan(certain.p)
    assert detection_check(odds(rng, np.ones(10), 0.5)).p == 0.0


def test_false_alarms_are_counted_by_poisson() -> None:
    assert clutter_check(10, 10.0, 5.0).p > 0.5
    assert clutter_check(40, 10.0, 5.0).p < 1e-9
    assert clutter_check(0, 10.0, 5.0).p < 1e-3
    assert clutter_check(0, 0.0, 5.0).p == 1.0


def test_who_looks_time_and_again_is_wrong_no_more_often() -> None:
    """Robbins' bound beside the plain one, at each of 300 looks at a sum that grows."""
    rng = np.random.default_rng(8)
    sums = rng.standard_normal((2000, 300)).cumsum(axis=1)
    z = sums / np.sqrt(np.arange(1, 301))
    bound = [
        brentq(lambda z, n=n: 1 - 2 * always_valid(check_of(z, n), 0.01), 0.0, 30.0)
        for n in range(1, 301)
    ]
    ever = int((np.abs(z) >= bound).any(axis=1).sum())
    assert_chance(float(stats.binom.sf(ever - 1, 2000, 0.01)), f"{ever} of 2000")
    plain = int((np.abs(z) >= stats.norm.isf(0.005)).any(axis=1).sum())
    assert plain > 100  # what it is for


def check_of(z: float, n: int) -> Check:
    return Check(name="x", expected=0.0, found=1.0, sigma=1.0, p=2 * float(stats.norm.sf(z)), of=n)


# Verdicts on limits, with the risks that they state.


RUNS = 300
# Wrong verdicts of so many runs, where each is wrong with that risk.
MOST = int(stats.binom.ppf(1 - 1e-4, RUNS, RISK))


def figure(values: np.ndarray, **more: Any) -> FigureSamples:
    """Of one series, a whole each."""
    n = len(values)
    return FigureSamples(values, np.ones(n), np.zeros(n, np.int64), **more)


@pytest.mark.parametrize("along", [0.0, 0.8])
@pytest.mark.parametrize("of_truth", [0.95, 1.05])
def test_a_limit_near_the_truth_is_not_decided_wrongly(along: float, of_truth: float) -> None:
    """890 reports of one track: the limit of their 95 % 5 % above the truth, or 5 % below it."""
    rng, counts = np.random.default_rng(3), dict.fromkeys(("passed", "failed", "undecided"), 0)
    n, limit = 890, of_truth * (-2 * np.log(0.05)) ** 0.5
    for _ in range(RUNS):
        own = (1 - along**2) ** 0.5
        errors = lfilter([own], [1.0, -along], rng.standard_normal((n, 2)), axis=0)
        samples = figure(np.hypot(*errors.T), quantile=0.95)
        counts[decided(samples.interval(RISK), limit, None)] += 1
    right, wrong = ("failed", "passed") if of_truth < 1 else ("passed", "failed")
    assert counts[wrong] <= MOST
    assert counts[right] > 2 * counts[wrong]


def test_few_reports_say_nothing_of_one_in_ten_thousand() -> None:
    none = figure(np.zeros(890), is_share=True)
    found = none.interval(RISK)
    assert (found.value, found.low) == (0.0, 0.0)
    assert found.high > 890**-1
    assert decided(found, 1e-4, None) == "undecided"
    assert decided(found, 0.1, None) == "passed"
    many = figure(np.zeros(10**6), is_share=True)
    assert decided(many.interval(RISK), 1e-4, None) == "passed"


@pytest.mark.parametrize("share", [0.02, 0.3, 0.97])
def test_a_share_lies_within_its_bounds(share: float) -> None:
    rng, outside = np.random.default_rng(4), 0
    for _ in range(RUNS):
        hits = (rng.random(500) < share).astype(float)
        samples = figure(hits, is_share=True)
        found = samples.interval()
        outside += not found.low <= share <= found.high
    assert outside <= MOST


def test_what_hangs_together_for_too_long_is_undecided() -> None:
    chain = np.cumsum(np.random.default_rng(1).standard_normal(60))
    found, spread = figure(chain).interval(), float(chain.std())
    for limit in (found.value + 5 * spread, found.value - 5 * spread):
        assert decided(found, limit, None) == "undecided"
    few = figure(chain[:3]).interval()
    assert (few.low, few.high) == (-np.inf, np.inf)
    assert decided(Interval(np.nan, np.nan, np.nan), 1.0, None) == "not testable"
    assert figure(np.full(50, 4.0), power=0.5).interval() == (2.0, 2.0, 2.0)
    none = figure(np.zeros(0))
    assert np.isnan([none.value, *none.interval()]).all()


def test_five_looks_at_seeds_are_wrong_as_seldom_as_one() -> None:
    """The truth is at the limit, so that any verdict is wrong: on either side in 5 of 100."""
    rng, wrong = np.random.default_rng(5), {"passed": 0, "failed": 0}
    for _ in range(RUNS):
        values = rng.normal(10.0, 2.0, 25)
        looks = (decided(seeds_interval(values[:n], look_risk(5)), 10.0, None)
                 for n in (5, 10, 15, 20, 25))  # fmt: skip
        verdict = next((each for each in looks if each != "undecided"), "undecided")
        if verdict in wrong:
            wrong[verdict] += 1
    assert max(wrong.values()) <= MOST
    assert seeds_interval(values[:1]).low == -np.inf


def test_runs_that_are_alike_by_chance_do_not_decide() -> None:
    """Two reports of 10,000 too far off where one is asked, 890 a run; a swap in one run of ten."""
    rng, far, swaps = np.random.default_rng(8), 0, 0
    for _ in range(RUNS):
        shares = rng.binomial(890, 2e-4, 8) / 890
        found = seeds_interval(shares, RISK / 2, np.full(8, 890.0))
        far += decided(found, 1e-4, None) == "passed"
        found = seeds_interval(rng.poisson(0.1, 12) * 1.0, RISK / 2, are_counts=True)
        swaps += decided(found, 0.05, None) == "passed"
    assert max(far, swaps) <= MOST
    assert figure(np.zeros(890), is_share=True).trials == 89.0
    assert np.isnan(figure(np.zeros(890)).trials)
    assert decided(seeds_interval(np.zeros(60), are_counts=True), 0.1, None) == "passed"


def test_what_is_infinite_in_some_runs_is_so_on_average() -> None:
    """The time to see most drones, where most were never seen in one run of ten."""
    values = np.array([[2.0] * 10, [2.0] * 9 + [np.inf]])
    assert decided(seeds_interval(values[1]), 10.0, None) == "failed"
    assert mean_interval(values[1]).value == np.inf
    found = breaking_level(np.array([0.0, 1.0]), values, 10.0, rises=True)
    assert found.value == pytest.approx(0.0, abs=1e-6)
    assert decided(seeds_interval(np.array([2.0] * 9 + [np.nan])), 10.0, None) == "passed"


LEVELS = np.arange(0.0, 2001.0, 250.0)


@pytest.mark.parametrize("falls", [False, True])
def test_the_breaking_level_lies_within_its_interval(falls: bool) -> None:
    """GOSPA rises by 20 m a second of latency from 10 m on: 30 m at one second, with either sign.

    Of 40 studies of 12 seeds, of which the same are at all levels.
    """
    rng, outside = np.random.default_rng(6), 0
    for _ in range(40):
        noise = rng.normal(0.0, 2.0, 12) + rng.normal(0.0, 1.0, (len(LEVELS), 12))
        values = 10.0 + 0.02 * LEVELS[:, None] + noise
        limit = 30.0
        if falls:
            values, limit = -values, -30.0
        found = breaking_level(LEVELS, values, limit, rises=not falls)
        assert found.low <= found.value <= found.high
        outside += not found.low <= 1000.0 <= found.high
    assert outside <= stats.binom.ppf(1 - 1e-4, 40, 0.1)


def test_levels_that_get_worse_downwards_break_downwards() -> None:
    share = np.array([1.0, 0.7, 0.4])
    values = np.tile([[10.0], [20.0], [40.0]], (1, 5))
    assert breaking_level(share, values, 30.0, rises=True).value == pytest.approx(0.55)
    assert breaking_level(share, values, 50.0, rises=True).value == np.inf
    assert breaking_level(share, values, 5.0, rises=True).value == -np.inf


# The bootstrap over runs: by closed forms, and how often its interval holds what is true.


def test_the_interval_holds_the_mean_nearly_as_often_as_it_says() -> None:
    rng, held = np.random.default_rng(2), 0
    experiments, runs = 300, 40
    for _ in range(experiments):
        found = mean_interval(rng.exponential(3.0, runs))
        held += found.low <= 3.0 <= found.high
    share = 0.93  # of 40 skewed values the percentile interval is a little too short
    assert_sum(held, share * experiments, share * (1 - share) * experiments, "coverage")


def test_a_ratio_is_of_sums_and_runs_without_a_value_are_left_out() -> None:
    found = ratio_interval([1.0, np.nan, 3.0], [10.0, 5.0, 10.0])
    assert found.value == 0.2
    assert 0.1 <= found.low <= 0.2 <= found.high <= 0.3
    assert mean_interval([7.0] * 5) == (7.0, 7.0, 7.0)
    one = mean_interval([7.0, np.nan])
    assert one.value == 7.0
    assert np.isnan([one.low, one.high]).all()
    assert np.isnan(ratio_interval([], [])).all()
    assert np.isnan(ratio_interval([0.0], [0.0])).all()

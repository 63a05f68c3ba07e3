"""The bootstrap over runs: by closed forms, and how often its interval holds what is true."""

from __future__ import annotations

import numpy as np
from support.significance import assert_sum

from plotfeed.models.verdicts import mean_interval, ratio_interval


def test_the_interval_of_a_mean_is_that_of_a_normal_law_where_runs_are_many() -> None:
    values = np.random.default_rng(1).normal(5.0, 2.0, 1000)
    found = mean_interval(values)
    half = 1.96 * values.std() / np.sqrt(len(values))
    assert found.value == values.mean()
    np.testing.assert_allclose([found.value - found.low, found.high - found.value], half, rtol=0.1)


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


def test_the_same_runs_have_the_same_interval() -> None:
    values = np.random.default_rng(3).normal(size=30)
    assert mean_interval(values) == mean_interval(values)

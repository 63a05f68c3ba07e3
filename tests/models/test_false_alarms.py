"""False alarms: how many, at the stated rate however rare, and where."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from support.shared_files import reference

from plotfeed.models import false_alarms


def test_binomial_agrees_with_the_reference():
    table = reference("false_alarm_binomial.csv")
    case = (table["cells"], table["pfa"])
    some = false_alarms.probability_at_least_one(*case)
    np.testing.assert_allclose(some, table["p_at_least_one"], rtol=1e-13)


def test_probabilities_at_their_ends_and_shape():
    assert false_alarms.probability_at_least_one(100, 1.0) == 1
    assert false_alarms.probability_at_least_one(0, 1e-3) == 0
    assert np.isnan(false_alarms.probability_at_least_one(10, 1.5))
    assert false_alarms.probability_at_least_one(np.ones((4, 1)), np.zeros(3)).shape == (4, 3)


@pytest.mark.parametrize(
    ("cells", "pfa"),
    [
        (32_000, 1e-4),
        (7620, 1e-2),
        (10**12, 1e-12),
        (10**12, 1e-9),
        (10**12, 1e-7),
        (10**15, 1e-15),
        (5, 0.5),
    ],
)
def test_counts_are_binomial(cells, pfa):
    rng = np.random.default_rng(3)
    counts = np.array([false_alarms.draw_count(cells, pfa, rng) for _ in range(40_000)])
    law = stats.binom(cells, pfa) if pfa > 1e-8 else stats.poisson(cells * pfa)
    inner = np.unique(law.ppf(np.linspace(0, 1, 12)[1:-1]))
    share = np.diff(np.concatenate([[0.0], law.cdf(inner), [1.0]]))
    edges = np.concatenate([[-np.inf], inner + 0.5, [np.inf]])
    observed = np.histogram(counts, edges)[0]
    possible = share > 0
    assert observed[~possible].sum() == 0
    expected = share[possible] * len(counts)
    assert stats.chisquare(observed[possible], expected, sum_check=False).pvalue > 1e-4


def test_almost_never_is_not_never():
    rng = np.random.default_rng(9)
    counts = np.array([false_alarms.draw_count(10**12, 1e-15, rng) for _ in range(200_000)])
    some = false_alarms.probability_at_least_one(1e12, 1e-15)
    assert stats.binomtest(int((counts > 0).sum()), 200_000, float(some)).pvalue > 1e-3


def test_counts_where_there_are_no_cells_or_all_alarm():
    rng = np.random.default_rng(4)
    assert false_alarms.draw_count(0, 0.1, rng) == 0
    assert false_alarms.draw_count(100, 0.0, rng) == 0
    assert false_alarms.draw_count(100, 1.0, rng) == 100
    assert isinstance(false_alarms.draw_count(100, 0.1, rng), int)


@given(st.integers(0, 10**12), st.lists(st.floats(0, 1), max_size=40))
def test_sectors_share_a_scan_out_exactly(total, borders):
    edges = [0.0, *sorted(borders), 1.0]
    parts = [false_alarms.cells_between(total, a, b) for a, b in pairwise(edges)]
    assert sum(parts) == total
    assert min(parts) >= 0


@given(st.integers(0, 10**9), st.integers(1, 720))
def test_equal_sectors_are_equal_to_a_cell_and_meet_despite_rounding(total, n):
    parts = [
        false_alarms.cells_between(total, i / n, 1.0 if i + 1 == n else (i + 1) * (1.0 / n))
        for i in range(n)
    ]
    assert sum(parts) == total
    assert max(parts) - min(parts) <= 1

"""Figures of what is counted are those of their definitions."""

from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from support.links import link
from support.significance import assert_chance

from plotfeed.feeds.lab.gathering import lacking_of
from plotfeed.feeds.lab.links import Order, found_times, orders_of
from plotfeed.feeds.link.delays import CELLS, DelayLaw
from plotfeed.models.residuals import CELL_M, MAX_CELLS, LookTally, pd_by_range
from plotfeed.models.tail_chances import p_of_distance
from plotfeed.models.verdicts import share_interval
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import tables_of

MS = 1_000_000
times = st.lists(st.integers(-(10**13), 10**13), max_size=40)


@given(times)
def test_quantiles_are_those_of_all_times(all_ns: list[int]) -> None:
    found = found_times(np.array(all_ns, np.int64))
    told_ms = [found.p50_ms, found.p90_ms, found.p99_ms, found.max_ms]
    if not all_ns:
        assert np.isnan([*told_ms, found.mean_ms]).all()
        return
    ranks = np.maximum(np.ceil(np.array([0.5, 0.9, 0.99, 1.0]) * len(all_ns)), 1).astype(int) - 1
    assert told_ms == (np.sort(all_ns)[ranks] / 1e6).tolist()
    assert found.mean_ms == pytest.approx(np.mean(all_ns) / 1e6, rel=1e-9, abs=1e-3)


def drawn_ns(keys: dict[str, object], n: int, seed: int = 4) -> np.ndarray:
    u = np.random.default_rng(seed).random(n)
    return np.rint(DelayLaw.of(link(**keys)).quantile_ms(u) * 1e6).astype(np.int64)


def distance_of(keys: dict[str, object], delays_ns: np.ndarray) -> float:
    return DelayLaw.of(link(**keys)).distance(delays_ns)


@pytest.mark.parametrize(
    "more", [{"jitter_ms": 10.0}, {"jitter_ms": 1.0, "distribution": "uniform"}]
)
def test_the_distance_is_that_of_kolmogorov_within_the_resolution(more: dict[str, object]) -> None:
    keys = {"latency_ms": 100.0} | more
    delays_ns = drawn_ns(keys, 500)
    exact = stats.kstest(delays_ns / 1e6, DelayLaw.of(link(**keys)).cdf).statistic
    assert distance_of(keys, delays_ns) == pytest.approx(exact, abs=2 / CELLS + 1 / 500)


def test_a_law_without_a_spread_has_no_distance() -> None:
    for keys in ({"latency_ms": 3.0}, {"distribution": "table", "delays_ms": [3.0]}):
        assert np.isnan(distance_of(keys, np.full(100, 3 * MS)))


@pytest.mark.parametrize(("n", "within"), [(8, 1.0), (30, 0.1), (1000, 0.05)])
def test_probabilities_of_distances_are_those_of_the_exact_law(n: int, within: float) -> None:
    for p in (0.9, 0.5, 0.1, 0.01, 1e-4):
        distance = float(stats.kstwo.isf(p, n))
        assert p_of_distance(distance, n) == pytest.approx(p, rel=within)
    assert np.isnan(p_of_distance(0.3, 7))


def test_intervals_of_shares_hold_them_as_often_as_they_say() -> None:
    rng = np.random.default_rng(2)
    for p in (0.02, 0.5, 0.97):
        ends = [share_interval(int(k), 200) for k in rng.binomial(200, p, 2000)]
        held = np.mean([low <= p <= high for low, high in ends])
        assert 0.92 < held < 0.98
    assert share_interval(0, 10)[0] == 0.0
    assert share_interval(10, 10)[1] == pytest.approx(1.0)
    assert np.isnan(share_interval(0, 0)).all()


def order_of(*rows: tuple[int, int, int, int], links: int = 1) -> list[Order]:
    """Of messages by number, time of sending, fate and link, told in whatever order."""
    number, sent_ns, fate, row = (np.array(c, np.int64) for c in zip(*rows, strict=True))
    empty = tables_of(()).messages
    sent = empty.but(number=number, due_utc_ns=number, sent_utc_ns=sent_ns, fate=fate, entry=row)
    return orders_of(sent.picked(np.arange(len(rows)), NEEDED_FOR_ORDER), links)


NEEDED_FOR_ORDER = ("entry", "number", "due_utc_ns", "sent_utc_ns", "fate")


FATES = [pb.SENT, pb.LOST, pb.LOST, pb.OUTAGE, pb.QUEUE_FULL, pb.STALE, pb.FATE_UNSPECIFIED]


@given(
    st.lists(st.tuples(st.sampled_from(FATES), st.integers(0, 30)), min_size=1, max_size=80),
    st.randoms(use_true_random=False),
)
def test_bursts_and_overtaking_are_by_their_definition(
    what: list[tuple[int, int]], told: random.Random
) -> None:
    rows = [(number, sent_ns, int(fate), 0) for number, (fate, sent_ns) in enumerate(what)]
    told.shuffle(rows)
    (found,) = order_of(*rows)

    letters = "".join(
        "x" if fate == pb.LOST else "?" if fate in (pb.OUTAGE, pb.FATE_UNSPECIFIED) else "."
        for fate, _ in what
    )
    exact = sorted(len(run) for run in _whole_bursts(letters))
    assert sorted(found.bursts.elements()) == exact
    all_runs = [run for part in letters.split(".") for run in part.split("?") if run]
    assert found.cut_bursts == len(all_runs) - len(exact)
    left = [sent_ns for fate, sent_ns in what if fate == pb.SENT]
    assert found.left == len(left)
    assert found.overtook == sum(t < max(left[:i], default=0) for i, t in enumerate(left))


def _whole_bursts(letters: str) -> list[str]:
    """Between two messages that passed."""
    return [run for run in letters.split(".")[1:-1] if run and "?" not in run]


def test_a_burst_does_not_go_on_under_another_setting_nor_where_messages_are_missing() -> None:
    fates = [pb.SENT, pb.LOST, pb.LOST, pb.LOST, pb.SENT, pb.LOST, pb.SENT]
    rows = [(n, n, int(fate), int(n > 2)) for n, fate in enumerate(fates)]
    before, after = order_of(*rows, links=2)
    assert (before.bursts, after.bursts) == ({}, {1: 1})
    assert (before.cut_bursts, after.cut_bursts) == (1, 1)
    lost, sent = int(pb.LOST), int(pb.SENT)
    (found,) = order_of((0, 0, sent, 0), (1, 0, lost, 0), (3, 0, lost, 0), (4, 9, sent, 0))
    assert (found.bursts, found.cut_bursts) == ({}, 2)


def test_detection_by_range_adds_up_and_is_within_chance_at_any_range_in_little_memory() -> None:
    rng = np.random.default_rng(8)
    range_m, pd = rng.uniform(300, 9000, 5000), rng.random(5000)
    tally = LookTally(CELL_M, MAX_CELLS)
    assert pd_by_range(tally) == []
    tally.add(range_m, pd, rng.random(5000) < pd)
    tally.add([np.nan, 5.0, np.inf, -1.0], [0.5, 1.5, 0.5, 0.5], [False] * 4)
    bins = pd_by_range(tally)
    assert sum(at.looks for at in bins) == 5000
    assert 8 <= len(bins) <= 13
    for at in bins:
        inside = (range_m >= at.from_m) & (range_m < at.to_m)
        assert at.looks == inside.sum()
        assert at.expected == pytest.approx(pd[inside].mean())
        assert at.low <= at.found <= at.high
        assert_chance(at.p, f"{at.from_m} m")
    tally.add([1e300], [0.5], [False])
    assert tally.cells().nbytes < 2_000_000
    assert sum(at.looks for at in pd_by_range(tally)) == 5001


@given(st.permutations(range(200, 260)), st.sets(st.integers(201, 258)))
def test_sectors_that_are_lacking_are_those_between(numbers: list[int], missing: set[int]) -> None:
    there = np.array([number for number in numbers if number not in missing])
    lacking = lacking_of(there)
    assert [number for run in lacking for number in run] == sorted(missing)
    many = np.arange(0, 10_000, 2)
    assert len(lacking_of(many)) == 1000  # what is known of them is bounded

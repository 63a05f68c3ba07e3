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

from plotfeed.feeds.lab.gathering import lacking_of, truths_of
from plotfeed.feeds.lab.judge import EDGES, NAMES, FeedLooks, FeedTally, SensorFeed, pd_by_range
from plotfeed.feeds.lab.laws import CELLS, law_distance, p_of_distance, share_interval, z_score
from plotfeed.feeds.lab.links import Order, found_times, orders_of
from plotfeed.feeds.link.delays import DelayLaw
from plotfeed.models.residuals import CELL_M, MAX_CELLS, Check, LookTally
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import tables_of
from plotfeed.proto.measured_plots import MeasuredPlots

MS = 1_000_000
LAWS = {
    "normal": {"latency_ms": 100.0, "jitter_ms": 10.0},
    "clipped at 0": {"latency_ms": 5.0, "jitter_ms": 10.0},
    "uniform": {"latency_ms": 100.0, "jitter_ms": 1.0, "distribution": "uniform"},
    "pareto": {"latency_ms": 50.0, "jitter_ms": 10.0, "distribution": "pareto"},
    "paretonormal": {"latency_ms": 50.0, "jitter_ms": 10.0, "distribution": "paretonormal"},
    "table": {"distribution": "table", "delays_ms": [1.0, 2.0, 2.0, 2.0, 7.0, 40.0]},
}


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
    return law_distance(DelayLaw.of(link(**keys)), delays_ns)


@pytest.mark.parametrize("name", LAWS)
def test_delays_of_a_law_fit_it_and_those_of_another_do_not(name: str) -> None:
    n, keys = 40_000, LAWS[name]
    delays_ns = drawn_ns(keys, n)
    right = distance_of(keys, delays_ns)
    assert_chance(p_of_distance(right, n), name)
    wrong = distance_of(keys, delays_ns + delays_ns // 50 + 10_000)
    assert p_of_distance(wrong, n) < 1e-9


@pytest.mark.parametrize("name", ["normal", "uniform"])
def test_the_distance_is_that_of_kolmogorov_within_the_resolution(name: str) -> None:
    keys = LAWS[name]
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


def test_few_counts_have_no_z_score() -> None:
    assert np.isnan(z_score(3.0, 4.9))
    assert z_score(-6.0, 9.0) == -2.0


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


def test_a_burst_does_not_go_on_under_another_setting() -> None:
    fates = [pb.SENT, pb.LOST, pb.LOST, pb.LOST, pb.SENT, pb.LOST, pb.SENT]
    rows = [(n, n, int(fate), int(n > 2)) for n, fate in enumerate(fates)]
    before, after = order_of(*rows, links=2)
    assert (before.bursts, after.bursts) == ({}, {1: 1})
    assert (before.cut_bursts, after.cut_bursts) == (1, 1)


def test_a_burst_does_not_go_on_where_messages_are_missing_nor_in_another_session() -> None:
    lost, sent = int(pb.LOST), int(pb.SENT)
    (found,) = order_of((0, 0, sent, 0), (1, 0, lost, 0), (3, 0, lost, 0), (4, 9, sent, 0))
    assert (found.bursts, found.cut_bursts) == ({}, 2)


def test_detection_by_range_adds_up_and_is_within_chance() -> None:
    rng = np.random.default_rng(8)
    range_m, pd = rng.uniform(300, 9000, 5000), rng.random(5000)
    tally = LookTally(CELL_M, MAX_CELLS)
    for r, p, hit in zip(range_m, pd, rng.random(5000) < pd, strict=True):
        tally.add([r], [p], [hit])
    tally.add([np.nan, 5.0], [0.5, 1.5], [False, False])
    bins = pd_by_range(tally)
    assert sum(at.looks for at in bins) == 5000
    assert 8 <= len(bins) <= 13
    for at in bins:
        inside = (range_m >= at.from_m) & (range_m < at.to_m)
        assert at.looks == inside.sum()
        assert at.expected == pytest.approx(pd[inside].mean())
        assert at.low <= at.found <= at.high
        assert_chance(at.p, f"{at.from_m} m")


def test_looks_at_any_range_take_little_memory() -> None:
    tally = LookTally(CELL_M, MAX_CELLS)
    tally.add([0.0, 1e300, 3.0, np.inf, -1.0], [0.5] * 5, [False] * 5)
    assert tally.cells().nbytes < 2_000_000
    assert sum(at.looks for at in pd_by_range(tally)) == 3
    nothing = LookTally(CELL_M, MAX_CELLS)
    assert pd_by_range(nothing) == []


COLUMNS = ("range_m", "azimuth_deg", "elevation_deg")


def measured_of(values: np.ndarray, sigma: float | None) -> MeasuredPlots:
    stated = {} if sigma is None else {f"sigma_{name}": sigma for name in COLUMNS}
    rows = [dict(zip(COLUMNS, row.tolist(), strict=True)) | stated for row in values]
    return MeasuredPlots.of([{"t_utc_ns": 0, **row} for row in rows])


def take(tally: FeedTally, true: np.ndarray, measured: MeasuredPlots) -> None:
    """The plots of a drone that was truly there, of a sensor that nobody knows."""
    entry = pb.Ledger()
    for row in true:
        entry.plots.add(drone="d", **dict(zip(COLUMNS, row.tolist(), strict=True)))
    n, told = len(true), tables_of([entry.SerializeToString()])
    empty = np.zeros(0)
    looks = dict.fromkeys(FeedLooks.__annotations__, empty)
    sector = np.zeros(n, np.int64)
    truths = truths_of(told, np.ones(n, np.bool_), np.zeros(n, np.int64))
    numbers = dict.fromkeys(("sector", "channel", "target", "emitted_utc_ns"), sector[:0])
    feed = SensorFeed(
        FeedLooks.holding(looks | numbers).but(counts=np.zeros(0, np.bool_)), measured, sector,
        np.zeros(1, np.int64), [None], 1.0, [], truths,
    )  # fmt: skip
    tally.take(feed)


def errors_of(normalised: np.ndarray, sigma: float, stated: float) -> FeedTally:
    tally = FeedTally("asked")
    for part in np.array_split(normalised, 7):
        true = np.tile([1000.0, 359.99, 10.0], (len(part), 1))
        measured = true + part * sigma
        measured[:, 1] %= 360
        take(tally, true, measured_of(measured, stated))
    assert tally.joined == len(normalised)
    return tally


def by_name(tally: FeedTally) -> dict[str, Check]:
    return {check.name: check for check in tally.checks()}


def test_errors_are_told_in_units_of_what_is_stated() -> None:
    normalised = np.random.default_rng(9).standard_normal((6000, 3))
    for sigma, stated in ((0.5, 0.5), (0.5, 1.0)):
        tally = errors_of(normalised, sigma, stated)
        found = by_name(tally)
        for i, name in enumerate(("range", "azimuth", "elevation")):
            expected = normalised[:, i] * sigma / stated
            bias, spread = found[name], found[f"{name} spread"]
            histogram = tally.histograms[NAMES.index(name)]
            assert bias.of == spread.of == histogram.sum() == 6000
            assert bias.found == pytest.approx(expected.mean() * stated, rel=1e-6)
            assert spread.found == pytest.approx(expected.std(ddof=1), rel=1e-6)
            assert_chance(bias.p, name)
            assert bias.p == pytest.approx(2 * stats.norm.sf(abs(bias.z)))
            if sigma == stated:
                assert_chance(spread.p, name)
                counts = np.histogram(np.clip(expected, -5.99, 5.99), EDGES)[0]
                assert np.abs(counts - histogram).sum() <= 4
            else:
                assert spread.p < 1e-9
                assert spread.z < -20


def test_errors_without_a_stated_sigma_are_not_judged() -> None:
    tally = FeedTally("asked")
    true = np.tile([1000.0, 5.0, 0.0], (50, 1))
    measured = true + 2.0
    measured[:, 2] = np.nan
    take(tally, true, measured_of(measured, None))
    assert tally.joined == 50
    assert not tally.errors.count.any()
    assert not any(c.is_judged for name, c in by_name(tally).items() if "spread" in name)


@given(st.permutations(range(200, 260)), st.sets(st.integers(201, 258)))
def test_sectors_that_are_lacking_are_those_between(numbers: list[int], missing: set[int]) -> None:
    there = np.array([number for number in numbers if number not in missing])
    assert [number for run in lacking_of(np.stack([there, there])) for number in run] == sorted(
        missing
    )


def test_what_is_known_of_sectors_that_are_lacking_is_bounded() -> None:
    there = np.arange(0, 10_000, 2)
    assert len(lacking_of(np.stack([there, there]))) == 1000

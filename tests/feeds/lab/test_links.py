"""Links of ledgers whose truth is known: what is reported is what there is, right or wrong.

Figures of what is counted are those of their definitions.
"""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from support.ledgers import entries, json_of, told_of
from support.links import link
from support.significance import assert_chance

from plotfeed.feeds.lab.gathering import FeedReport, lacking_of
from plotfeed.feeds.lab.links import LinkFigures, Order, Setting, found_times, orders_of
from plotfeed.feeds.link import impairment
from plotfeed.feeds.link.delays import CELLS, DelayLaw
from plotfeed.feeds.link.losses import LossChain
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.models.residuals import CELL_M, MAX_CELLS, LookTally, pd_by_range
from plotfeed.models.tail_chances import p_of_distance
from plotfeed.models.verdicts import share_interval
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import tables_of

MS = 1_000_000
COUNT = 8000


def lossy(kind: str, **keys: float) -> dict[str, Any]:
    return {"loss": {"kind": kind, **keys}}


JITTERED = {"latency_ms": 100.0, "jitter_ms": 10.0}
LINKS: dict[str, dict[str, Any]] = {
    "normal": JITTERED,
    "correlated": JITTERED | {"delay_correlation": 0.8},
    "clipped": {"latency_ms": 5.0, "jitter_ms": 10.0},
    "uniform": {"latency_ms": 40.0, "jitter_ms": 30.0, "distribution": "uniform"},
    "pareto": {"latency_ms": 50.0, "jitter_ms": 10.0, "distribution": "pareto"},
    "paretonormal": {"latency_ms": 50.0, "jitter_ms": 10.0, "distribution": "paretonormal"},
    "table": {"distribution": "table", "delays_ms": [5.0, 6.0, 6.5, 9.0, 30.0]},
    "random loss": lossy("random", probability=0.05),
    "correlated loss": lossy("random", probability=0.1, correlation=0.4),
    "bursts": JITTERED | lossy("gilbert-elliott", mean_loss=0.1, mean_burst=5.0),
    "leaking bursts": lossy("gilbert-elliott", p=0.02, r=0.2, bad_loss=0.8, good_loss=0.01),
    "four states": lossy("four-state", p13=0.02, p31=0.3, p32=0.1, p23=0.5),
    "copies": JITTERED | {"duplicate": 0.1, "corrupt": 0.05},
}
# Links that do one thing and say another, by what is called wrong of them.
WRONG: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "delay": ({"latency_ms": 101.0, "jitter_ms": 10.0}, JITTERED),
    "delay, by its jitter": ({"latency_ms": 100.0, "jitter_ms": 12.0}, JITTERED),
    "loss": (lossy("random", probability=0.07), lossy("random", probability=0.05)),
    "bursts of losses": (
        lossy("gilbert-elliott", mean_loss=0.1, mean_burst=7.0),
        lossy("gilbert-elliott", mean_loss=0.1, mean_burst=4.0),
    ),
    "duplicates": ({"duplicate": 0.14}, {"duplicate": 0.1}),
    "flipped bits": ({"corrupt": 0.14}, {"corrupt": 0.1}),
    "order": (JITTERED, JITTERED | {"in_order": True}),
}
NOT_PLAIN: dict[str, dict[str, Any]] = {
    "kept in order": JITTERED | {"in_order": True},
    "rate limited": JITTERED | {"rate_kbit_s": 20.0},
    "reordered on purpose": JITTERED | {"reorder": {"probability": 0.2}},
    "stalls": {"latency_ms": 5.0, "on_loss": "stall"} | lossy("random", probability=0.1),
    "down": JITTERED | {"down": True},
    "all the same": {"latency_ms": 5.0},
}
# What says that it is a link and is none, and why.
NONE = {
    "{": "expected JSON",
    "[" * 100_000: "expected JSON",
    "[1]": "expected an object",
    '{"latency_s": 1}': "latency_s: no such key",
    '{"latency_ms": -1}': "latency_ms",
    '{"loss": {"kind": "some"}}': "loss.kind",
    '{"distribution": "table"}': "delays_ms",
}


def called(name: str, ledgers: list[pb.Ledger], link: str | None = None) -> list[pb.Ledger]:
    """Entries of a sensor of that name, on a link that they say is that."""
    for entry in ledgers:
        entry.sensor, entry.link = name, entry.link if link is None else link
    return ledgers


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> FeedReport:
    """Of one recording, with a sensor for each of those links."""
    made = [called(n, entries(link(**k), COUNT, seed=5, in_each=20)) for n, k in LINKS.items()]
    for name, (does, says) in WRONG.items():
        asked = link(**says)
        made.append(called(f"not {name}", entries(link(**does), COUNT, says=asked, in_each=20)))
    for name, keys in NOT_PLAIN.items():
        ledgers = entries(link(**keys), 20 if name == "stalls" else 1000)
        made.append(called(name, [e for e in ledgers if all(one.fate for one in e.messages)]))
    made += [called(text[:50], entries(link(**JITTERED), 400), text) for text in NONE]
    late = entries(link(**JITTERED), COUNT, late_ns=2 * MS, in_each=20)
    made += [called("late", late), called("nothing", entries(link(), 400), "")]
    return told_of(tmp_path_factory.mktemp("links"), [entry for each in made for entry in each])


@pytest.fixture(scope="module")
def found(told: FeedReport) -> dict[str, LinkFigures]:
    return {each.sensor: each for each in told.links}


def assert_z(z: float, of: str) -> None:
    assert_chance(2 * stats.norm.sf(abs(z)), f"{of}, z = {z:+.2f}")


@pytest.mark.parametrize("name", LINKS)
def test_a_right_link_delivers_what_it_asks(name: str, found: dict[str, LinkFigures]) -> None:
    of = found[name]
    assert of.messages == COUNT
    if not of.fit.not_comparable:
        assert_chance(of.fit.p_value, "delay")
        assert of.fit.distance == of.fit.link_distance
        assert of.asked is not None
        for time in ("mean_ms", "p50_ms", "p90_ms"):
            assert getattr(of.delivered, time) == pytest.approx(getattr(of.asked, time), rel=0.05)
    shares = {"loss": of.loss, "doubled": of.duplicates, "corrupted": of.corrupted}
    for what, share in shares.items():
        if share.asked:
            assert_z(share.z, what)
        else:
            assert (share.count, share.delivered) == (0, 0.0)
    if of.loss.asked:
        assert_z(of.bursts.z, "bursts")
        assert of.bursts.bursts > 100


@pytest.mark.parametrize("name", WRONG)
def test_a_link_that_does_something_else_is_found_out(name: str, told: FeedReport) -> None:
    wrong = {each.name for each in told.verdicts.wrong if each.sensor == f"not {name}"}
    assert wrong == {name.partition(",")[0]}


def test_the_engine_is_told_apart_from_the_link(found: dict[str, LinkFigures]) -> None:
    late = found["late"]
    assert late.lateness.p50_ms == pytest.approx(2.0, rel=1e-3)
    assert late.lateness.max_ms == 2.0
    assert late.fit.p_value < 1e-9
    assert_chance(late.fit.link_p_value, "link alone")


def test_links_of_no_plain_law_or_none_are_not_compared(found: dict[str, LinkFigures]) -> None:
    for why in NOT_PLAIN:
        fit = found[why].fit
        assert why in fit.not_comparable
        assert np.isnan([fit.distance, fit.p_value, fit.link_p_value]).all()
    stalls, down, slow = (found[name] for name in ("stalls", "down", "rate limited"))
    assert (stalls.loss.asked, stalls.loss.count) == (0.0, 0)
    assert down.asked is None
    assert down.other_fates["outage"] == 1000
    assert (down.sent, down.loss.of) == (0, 0)
    for ordered in (stalls, found["kept in order"]):
        assert ordered.overtook.asked == ordered.overtook.count == 0
    assert slow.other_fates["queue_full"] == 0 < slow.delivered.p90_ms
    none = found["nothing"]
    assert none.link == {}
    assert none.asked is not None
    assert (none.asked.max_ms, none.delivered.max_ms, none.loss.asked) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("text", NONE)
def test_what_came_over_a_link_that_is_none_is_told(
    text: str, found: dict[str, LinkFigures]
) -> None:
    of = found[text[:50]]
    assert NONE[text] in of.link_problem
    assert of.asked is None
    assert of.fit.not_comparable == "not known"
    assert of.delivered.mean_ms == pytest.approx(100, rel=0.05)
    assert np.isnan([of.loss.asked, of.duplicates.asked, of.overtook.asked]).all()


def test_a_fault_of_the_running_process_in_a_link_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of what delays and loses, and says that this was asked: the oracle asks the scene."""
    for keys in (*LINKS.values(), *NOT_PLAIN.values(), *(says for _, says in WRONG.values())):
        assert Setting(json_of(link(**keys))).differs == set(), keys
    law_of, chain_of = DelayLaw.of, impairment.chain_of

    def later(asked: LinkSettings) -> DelayLaw:
        return replace(law_of(asked), latency_ms=1.05 * asked.latency_ms)

    def longer(asked: Any) -> LossChain:
        return chain_of(asked.model_copy(update={"mean_burst": 2 * asked.mean_burst}))

    monkeypatch.setattr(DelayLaw, "of", later)
    monkeypatch.setattr(impairment, "chain_of", longer)
    told = told_of(tmp_path, entries(link(**LINKS["bursts"]), 2000))
    assert {each.name for each in told.verdicts.wrong} == {"delay", "bursts of losses"}


def test_counts_are_those_of_the_ledger(tmp_path: Path) -> None:
    asked = link(**JITTERED, **lossy("random", probability=0.2), duplicate=0.1, corrupt=0.1)
    ledgers = entries(asked, 2000)
    (found,) = told_of(tmp_path, ledgers).links
    sent = [one for entry in ledgers for one in entry.messages]
    first = [one for one in sent if not one.copy]
    times = [(one.due_utc_ns, one.sent_utc_ns) for one in first if one.fate == pb.SENT]
    due, left = np.array(times).T
    delays_ms = (left - due) / MS
    assert (found.messages, found.sent) == (2000, len(left))
    assert found.loss.count == sum(one.fate == pb.LOST for one in first)
    assert (found.duplicates.count, found.duplicates.of) == (len(sent) - len(first), len(left))
    assert found.corrupted.count == sum(one.HasField("flipped_bit") for one in sent)
    assert found.corrupted.of == sum(one.fate == pb.SENT for one in sent)
    assert found.overtook.count == (left < np.maximum.accumulate(left)).sum()
    assert np.isnan(found.overtook.asked)
    assert found.delivered.mean_ms == pytest.approx(delays_ms.mean())
    assert found.delivered.curve_ms[-1] == found.delivered.max_ms == delays_ms.max()
    lengths = np.repeat(*np.array([(int(n), k) for n, k in found.bursts.lengths.items()]).T)
    assert found.bursts.delivered_mean == pytest.approx(lengths.mean())
    assert found.bursts.delivered_survival[1] == pytest.approx((lengths >= 2).mean())


def test_each_setting_of_a_link_is_told_apart(tmp_path: Path) -> None:
    first, second = JITTERED, JITTERED | {"latency_ms": 300.0}
    ledgers, others = (entries(link(**keys), 3000) for keys in (first, second))
    ledgers[250:500] = others[250:500]
    told = told_of(tmp_path, ledgers)
    found = [(each.number, each.link, each.messages) for each in told.links]
    assert found == [(1, first, 2000), (2, second, 1000)]
    for each in told.links:
        assert_chance(each.fit.p_value, "delay")
    assert told.links[1].first_utc_ns - told.first_utc_ns == 10 * 10**9


def test_a_ledger_of_endless_settings_is_told_in_part(tmp_path: Path) -> None:
    ledgers = entries(link(), 600)
    for n, entry in enumerate(ledgers):
        entry.link = json_of(link(latency_ms=float(n + 1)))
    told = told_of(tmp_path, ledgers)
    assert len(told.links) == 100
    assert "50 entries are under more link settings than are told" in told.notes


def test_sessions_count_apart_and_what_was_recorded_twice_once(tmp_path: Path) -> None:
    ledgers, again = (entries(link(**LINKS["bursts"]), 2000) for _ in range(2))
    for entry in again:
        entry.scan += 100_000
        for one in entry.messages:
            one.due_utc_ns += 10**12
            one.link_due_utc_ns += 10**12
            one.sent_utc_ns += 10**12 if one.sent_utc_ns else 0
    (once,) = told_of(tmp_path, ledgers).links
    told = told_of(tmp_path, [each for entry in (*ledgers, *again) for each in (entry, entry)])
    assert told.entries == 1000
    assert "1000 entries were recorded twice and count once" in told.notes
    (twice,) = told.links
    assert twice.messages == 2 * once.messages
    assert twice.bursts.bursts == 2 * once.bursts.bursts
    assert twice.overtook.count == 2 * once.overtook.count


# Figures, by their definitions.


@given(st.lists(st.integers(-(10**13), 10**13), max_size=40))
def test_quantiles_are_those_of_all_times(all_ns: list[int]) -> None:
    found = found_times(np.array(all_ns, np.int64))
    told_ms = [found.p50_ms, found.p90_ms, found.p99_ms, found.max_ms]
    if not all_ns:
        assert np.isnan([*told_ms, found.mean_ms]).all()
        return
    ranks = np.maximum(np.ceil(np.array([0.5, 0.9, 0.99, 1.0]) * len(all_ns)), 1).astype(int) - 1
    assert told_ms == (np.sort(all_ns)[ranks] / 1e6).tolist()
    assert found.mean_ms == pytest.approx(np.mean(all_ns) / 1e6, rel=1e-9, abs=1e-3)


@pytest.mark.parametrize(
    "more", [{"jitter_ms": 10.0}, {"jitter_ms": 1.0, "distribution": "uniform"}]
)
def test_the_distance_is_that_of_kolmogorov_within_the_resolution(more: dict[str, Any]) -> None:
    law = DelayLaw.of(link(latency_ms=100.0, **more))
    drawn_ms = law.quantile_ms(np.random.default_rng(4).random(500))
    delays_ns = np.rint(drawn_ms * MS).astype(np.int64)
    exact = stats.kstest(delays_ns / MS, law.cdf).statistic
    assert law.distance(delays_ns) == pytest.approx(exact, abs=2 / CELLS + 1 / 500)


def test_a_law_without_a_spread_has_no_distance() -> None:
    for keys in ({"latency_ms": 3.0}, {"distribution": "table", "delays_ms": [3.0]}):
        assert np.isnan(DelayLaw.of(link(**keys)).distance(np.full(100, 3 * MS)))


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


NEEDED_FOR_ORDER = ("entry", "number", "due_utc_ns", "sent_utc_ns", "fate")


def order_of(*rows: tuple[int, int, int, int], links: int = 1) -> list[Order]:
    """Of messages by number, time of sending, fate and link, told in whatever order."""
    number, sent_ns, fate, row = (np.array(c, np.int64) for c in zip(*rows, strict=True))
    empty = tables_of(()).messages
    sent = empty.but(number=number, due_utc_ns=number, sent_utc_ns=sent_ns, fate=fate, entry=row)
    return orders_of(sent.picked(np.arange(len(rows)), NEEDED_FOR_ORDER), links)


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
    (together,) = order_of((0, 5, sent, 0), (1, 5, sent, 0))
    assert (together.left, together.overtook) == (2, 0)


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

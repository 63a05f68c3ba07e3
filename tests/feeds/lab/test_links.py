"""Links of ledgers whose truth is known: what is reported is what there is, right or wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from support.ledgers import entries, json_of, told_of
from support.links import link
from support.significance import assert_chance

from plotfeed.feeds.lab.gathering import FeedReport
from plotfeed.feeds.lab.links import LinkFigures
from plotfeed.proto import plotfeed_pb2 as pb

MS = 1_000_000
COUNT = 8000
JITTERED = {"latency_ms": 100.0, "jitter_ms": 10.0}
LINKS: dict[str, dict[str, Any]] = {
    "normal": JITTERED,
    "correlated": JITTERED | {"delay_correlation": 0.8},
    "clipped": {"latency_ms": 5.0, "jitter_ms": 10.0},
    "uniform": {"latency_ms": 40.0, "jitter_ms": 30.0, "distribution": "uniform"},
    "pareto": {"latency_ms": 50.0, "jitter_ms": 10.0, "distribution": "pareto"},
    "paretonormal": {"latency_ms": 50.0, "jitter_ms": 10.0, "distribution": "paretonormal"},
    "table": {"distribution": "table", "delays_ms": [5.0, 6.0, 6.5, 9.0, 30.0]},
    "random loss": {"loss": {"kind": "random", "probability": 0.05}},
    "correlated loss": {"loss": {"kind": "random", "probability": 0.1, "correlation": 0.4}},
    "bursts": JITTERED | {"loss": {"kind": "gilbert-elliott", "mean_loss": 0.1, "mean_burst": 5.0}},
    "leaking bursts": {
        "loss": {"kind": "gilbert-elliott", "p": 0.02, "r": 0.2, "bad_loss": 0.8, "good_loss": 0.01}
    },
    "four states": {
        "loss": {"kind": "four-state", "p13": 0.02, "p31": 0.3, "p32": 0.1, "p23": 0.5}
    },
    "copies": JITTERED | {"duplicate": 0.1, "corrupt": 0.05},
}


def only(told: FeedReport) -> LinkFigures:
    (found,) = told.links
    return found


def assert_z(z: float, of: str) -> None:
    assert_chance(2 * stats.norm.sf(abs(z)), f"{of}, z = {z:+.2f}")


@pytest.mark.parametrize("name", LINKS)
def test_a_right_link_delivers_what_it_asks(name: str, tmp_path: Path) -> None:
    found = only(told_of(tmp_path, entries(link(**LINKS[name]), COUNT, seed=5, in_each=20)))
    assert found.messages == COUNT
    if not found.fit.not_comparable:
        assert_chance(found.fit.p_value, "delay")
        assert found.fit.distance == found.fit.link_distance
        assert found.asked is not None
        for of in ("mean_ms", "p50_ms", "p90_ms"):
            assert getattr(found.delivered, of) == pytest.approx(getattr(found.asked, of), rel=0.05)
    shares = {"loss": found.loss, "doubled": found.duplicates, "corrupted": found.corrupted}
    for of, share in shares.items():
        if share.asked:
            assert_z(share.z, of)
        else:
            assert (share.count, share.delivered) == (0, 0.0)
    if found.loss.asked:
        assert_z(found.bursts.z, "bursts")
        assert found.bursts.bursts > 100


WRONG: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "delay": ({"latency_ms": 101.0, "jitter_ms": 10.0}, JITTERED),
    "jitter": ({"latency_ms": 100.0, "jitter_ms": 12.0}, JITTERED),
    "loss": (
        {"loss": {"kind": "random", "probability": 0.07}},
        {"loss": {"kind": "random", "probability": 0.05}},
    ),
    "bursts": (
        {"loss": {"kind": "gilbert-elliott", "mean_loss": 0.1, "mean_burst": 7.0}},
        {"loss": {"kind": "gilbert-elliott", "mean_loss": 0.1, "mean_burst": 4.0}},
    ),
    "doubled": ({"duplicate": 0.14}, {"duplicate": 0.1}),
    "corrupted": ({"corrupt": 0.14}, {"corrupt": 0.1}),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_link_that_does_something_else_is_found_out(name: str, tmp_path: Path) -> None:
    does, says = WRONG[name]
    found = only(told_of(tmp_path, entries(link(**does), COUNT, says=link(**says), in_each=20)))
    if name in ("delay", "jitter"):
        assert found.fit.p_value < 1e-6
    else:
        shares = {
            "loss": found.loss.z,
            "bursts": found.bursts.z,
            "doubled": found.duplicates.z,
            "corrupted": found.corrupted.z,
        }
        assert abs(shares.pop(name)) > 5
        assert not [z for z in shares.values() if abs(z) > 5]


def test_counts_are_those_of_the_ledger(tmp_path: Path) -> None:
    asked = link(
        **JITTERED, loss={"kind": "random", "probability": 0.2}, duplicate=0.1, corrupt=0.1
    )
    ledgers = entries(asked, 2000)
    found = only(told_of(tmp_path, ledgers))
    sent = [one for entry in ledgers for one in entry.messages]
    first = [one for one in sent if not one.copy]
    left = np.array([one.sent_utc_ns for one in first if one.fate == pb.SENT])
    delays_ms = np.array([o.sent_utc_ns - o.due_utc_ns for o in first if o.fate == pb.SENT]) / MS
    assert (found.messages, found.sent) == (2000, len(left))
    assert found.loss.count == sum(one.fate == pb.LOST for one in first)
    assert found.duplicates.count == len(sent) - len(first)
    assert found.duplicates.of == len(left)
    assert found.corrupted.count == sum(one.HasField("flipped_bit") for one in sent)
    assert found.corrupted.of == sum(one.fate == pb.SENT for one in sent)
    assert found.overtook.count == (left < np.maximum.accumulate(left)).sum()
    assert found.overtook.delivered == pytest.approx(
        (left < np.maximum.accumulate(left)).mean(), abs=1e-12
    )
    assert np.isnan(found.overtook.asked)
    assert found.delivered.mean_ms == pytest.approx(delays_ms.mean())
    assert found.delivered.p99_ms == pytest.approx(np.quantile(delays_ms, 0.99), rel=0.01)
    assert found.delivered.max_ms == delays_ms.max()
    assert list(found.delivered.curve_ms) == sorted(found.delivered.curve_ms)
    lost = "".join("x" if one.fate == pb.LOST else "." for one in first)
    runs = [len(run) for run in lost.split(".")[1:-1] if run]
    assert found.bursts.lengths == {str(n): runs.count(n) for n in sorted(set(runs))}
    assert found.bursts.delivered_mean == pytest.approx(np.mean(runs))
    assert found.bursts.delivered_survival[1] == pytest.approx(np.mean(np.array(runs) >= 2))


def test_entries_may_come_in_any_order(tmp_path: Path) -> None:
    ledgers = entries(link(**LINKS["bursts"]), 4000)
    shuffled = [ledgers[i] for i in np.random.default_rng(1).permutation(len(ledgers))]
    (tmp_path / "other").mkdir()
    one, other = only(told_of(tmp_path, ledgers)), only(told_of(tmp_path / "other", shuffled))
    for name in ("bursts", "overtook", "loss"):
        assert vars(getattr(one, name)) == vars(getattr(other, name))
    assert one.delivered.curve_ms == other.delivered.curve_ms


def test_the_engine_is_told_apart_from_the_link(tmp_path: Path) -> None:
    found = only(told_of(tmp_path, entries(link(**JITTERED), COUNT, late_ns=2 * MS, in_each=20)))
    assert found.lateness.p50_ms == pytest.approx(2.0, rel=1e-3)
    assert found.lateness.max_ms == 2.0
    assert found.fit.p_value < 1e-9
    assert_chance(found.fit.link_p_value, "link alone")


NOT_PLAIN = {
    "kept in order": JITTERED | {"in_order": True},
    "rate limited": JITTERED | {"rate_kbit_s": 20.0},
    "reordered on purpose": JITTERED | {"reorder": {"probability": 0.2}},
    "stalls": {
        "latency_ms": 5.0,
        "on_loss": "stall",
        "loss": {"kind": "random", "probability": 0.1},
    },
    "down": JITTERED | {"down": True},
    "all the same": {"latency_ms": 5.0},
}


@pytest.mark.parametrize("why", NOT_PLAIN)
def test_delays_that_follow_no_plain_law_are_not_compared_and_it_says_why(
    why: str, tmp_path: Path
) -> None:
    asked = link(**NOT_PLAIN[why])
    count = 20 if why == "stalls" else 1000
    ledgers = [entry for entry in entries(asked, count) if all(one.fate for one in entry.messages)]
    found = only(told_of(tmp_path, ledgers))
    assert why in found.fit.not_comparable
    assert np.isnan([found.fit.distance, found.fit.p_value, found.fit.link_p_value]).all()
    if why == "stalls":
        assert (found.loss.asked, found.loss.count) == (0.0, 0)
        assert found.overtook.asked == found.overtook.count == 0
    if why == "down":
        assert found.asked is None
        assert found.other_fates["outage"] == 1000
        assert (found.sent, found.loss.of) == (0, 0)
    if why == "kept in order":
        assert found.overtook.asked == found.overtook.count == 0
    if why == "rate limited":
        assert found.other_fates["queue_full"] == 0 < found.delivered.p90_ms


def test_each_setting_of_a_link_is_told_apart(tmp_path: Path) -> None:
    first, second = link(**JITTERED), link(latency_ms=300.0, jitter_ms=10.0)
    ledgers = entries(first, 3000)
    for entry, other in zip(ledgers[250:500], entries(second, 3000)[250:500], strict=True):
        entry.CopyFrom(other)
    told = told_of(tmp_path, ledgers)
    assert [(found.number, found.link, found.messages) for found in told.links] == [
        (1, JITTERED, 2000),
        (2, {"latency_ms": 300.0, "jitter_ms": 10.0}, 1000),
    ]
    for found in told.links:
        assert_chance(found.fit.p_value, "delay")
    assert told.links[1].first_utc_ns - told.first_utc_ns == 10 * 10**9


def test_a_sensor_without_a_link_asks_for_nothing(tmp_path: Path) -> None:
    ledgers = entries(link(), 400)
    for entry in ledgers:
        entry.link = ""
    found = only(told_of(tmp_path, ledgers))
    assert found.link == {}
    assert found.asked is not None
    assert (found.asked.max_ms, found.delivered.max_ms, found.loss.asked) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("{", "expected JSON"),
        ("[" * 100_000, "expected JSON"),
        ("[1]", "expected an object"),
        ('{"latency_s": 1}', "latency_s: no such key"),
        ('{"latency_ms": -1}', "latency_ms"),
        ('{"loss": {"kind": "some"}}', "loss.kind"),
        ('{"distribution": "table"}', "delays_ms"),
    ],
)
def test_a_link_that_is_none_is_said_to_be_none_and_what_came_is_told(
    text: str, problem: str, tmp_path: Path
) -> None:
    ledgers = entries(link(**JITTERED), 400)
    for entry in ledgers:
        entry.link = text
    found = only(told_of(tmp_path, ledgers))
    assert problem in found.link_problem
    assert found.asked is None
    assert found.fit.not_comparable == "not known"
    assert found.delivered.mean_ms == pytest.approx(100, rel=0.05)
    assert np.isnan([found.loss.asked, found.duplicates.asked, found.overtook.asked]).all()


def test_a_ledger_of_endless_settings_is_told_in_part(tmp_path: Path) -> None:
    ledgers = entries(link(), 600)
    for n, entry in enumerate(ledgers):
        entry.link = json_of(link(latency_ms=float(n + 1)))
    told = told_of(tmp_path, ledgers)
    assert len(told.links) == 100
    assert "50 entries are under more link settings than are told" in told.notes


def test_a_second_session_in_the_file_counts_on_its_own(tmp_path: Path) -> None:
    ledgers = entries(link(**LINKS["bursts"]), 2000)
    again = entries(link(**LINKS["bursts"]), 2000)
    for entry in again:
        entry.scan += 100_000
        for one in entry.messages:
            one.due_utc_ns += 10**12
            one.link_due_utc_ns += 10**12
            one.sent_utc_ns += 10**12 if one.sent_utc_ns else 0
    (tmp_path / "once").mkdir()
    once = only(told_of(tmp_path / "once", ledgers))
    twice = only(told_of(tmp_path, [*ledgers, *again]))
    assert twice.bursts.bursts == 2 * once.bursts.bursts
    assert twice.overtook.count == 2 * once.overtook.count


def test_an_entry_that_was_recorded_twice_counts_once(tmp_path: Path) -> None:
    ledgers = entries(link(**JITTERED), 400)
    told = told_of(tmp_path, [each for entry in ledgers for each in (entry, entry)])
    assert only(told).messages == 400
    assert told.entries == 100
    assert "100 entries were recorded twice and count once" in told.notes

"""Links of ledgers whose truth is known: what is reported is what there is, right or wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from support.ledgers import entries, json_of, told_of
from support.links import link
from support.significance import assert_chance

from plotfeed.feeds.lab.gathering import FeedReport
from plotfeed.feeds.lab.links import LinkFigures, Setting
from plotfeed.feeds.link import impairment
from plotfeed.feeds.link.delays import DelayLaw
from plotfeed.feeds.link.losses import LossChain
from plotfeed.feeds.scene.link_keys import LinkSettings
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


# Links that do one thing and say another, by what is called wrong of them.
WRONG: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "delay": ({"latency_ms": 101.0, "jitter_ms": 10.0}, JITTERED),
    "delay, by its jitter": ({"latency_ms": 100.0, "jitter_ms": 12.0}, JITTERED),
    "loss": (
        {"loss": {"kind": "random", "probability": 0.07}},
        {"loss": {"kind": "random", "probability": 0.05}},
    ),
    "bursts of losses": (
        {"loss": {"kind": "gilbert-elliott", "mean_loss": 0.1, "mean_burst": 7.0}},
        {"loss": {"kind": "gilbert-elliott", "mean_loss": 0.1, "mean_burst": 4.0}},
    ),
    "duplicates": ({"duplicate": 0.14}, {"duplicate": 0.1}),
    "flipped bits": ({"corrupt": 0.14}, {"corrupt": 0.1}),
    "order": (JITTERED, JITTERED | {"in_order": True}),
}
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


def only(told: FeedReport) -> LinkFigures:
    (found,) = told.links
    return found


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


def test_delays_that_follow_no_plain_law_are_not_compared_and_it_says_why(
    found: dict[str, LinkFigures],
) -> None:
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


def test_a_sensor_without_a_link_asks_for_nothing(found: dict[str, LinkFigures]) -> None:
    none = found["nothing"]
    assert none.link == {}
    assert none.asked is not None
    assert (none.asked.max_ms, none.delivered.max_ms, none.loss.asked) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("text", NONE)
def test_a_link_that_is_none_is_said_to_be_none_and_what_came_is_told(
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
    assert np.isnan(found.overtook.asked)
    assert found.delivered.mean_ms == pytest.approx(delays_ms.mean())
    assert found.delivered.curve_ms[-1] == found.delivered.max_ms == delays_ms.max()
    lost = "".join("x" if one.fate == pb.LOST else "." for one in first)
    runs = [len(run) for run in lost.split(".")[1:-1] if run]
    assert found.bursts.lengths == {str(n): runs.count(n) for n in sorted(set(runs))}
    assert found.bursts.delivered_mean == pytest.approx(np.mean(runs))
    assert found.bursts.delivered_survival[1] == pytest.approx(np.mean(np.array(runs) >= 2))


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

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
import pytest
from support.links import NS, OCTETS, START_NS, due_times, link, passed

from plotfeed.feeds.link.impairment import HELD, Copy, Impairment, Outcome, flip, random_rows
from plotfeed.models.chance import Chance
from plotfeed.proto import plotfeed_pb2 as pb

BURSTS = {"kind": "gilbert-elliott", "mean_loss": 0.2, "mean_burst": 4.0}
SELDOM = {"kind": "random", "probability": 0.02}
ALL: dict[str, Any] = {
    "latency_ms": 30.0,
    "jitter_ms": 8.0,
    "distribution": "pareto",
    "delay_correlation": 0.6,
    "loss": {"kind": "four-state", "p13": 0.05, "p31": 0.3, "p32": 0.1, "p23": 0.5, "p14": 0.02},
    "duplicate": 0.1,
    "corrupt": 0.1,
    "reorder": {"probability": 0.2, "gap": 2},
    "rate_kbit_s": 2000.0,
    "queue_messages": 20,
}
LINKS = {
    "clear": link(),
    "latency": link(latency_ms=5.0),
    "bursts": link(loss=BURSTS),
    "stall": link(latency_ms=20.0, jitter_ms=5.0, loss=SELDOM, on_loss="stall"),
    "all": link(**ALL),
    "table": link(distribution="table", delays_ms=[1.0, 5.0, 2.0], delay_correlation=-0.5),
}
EVERY_LINK = pytest.mark.parametrize("name", LINKS)


def digest(outcomes: list[Outcome]) -> str:
    lines = []
    for fate, copies in outcomes:
        name = pb.Fate.Name(fate).lower()
        lines.append(f"{name} {[(c.due_utc_ns - START_NS, c.flipped_bit) for c in copies]}")
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def test_a_clear_link_passes_everything_as_it_is() -> None:
    dues = due_times(3000, 1000)
    assert passed(link(), dues) == [Outcome(pb.SENT, (Copy(due, None),)) for due in dues]


@EVERY_LINK
def test_the_same_seed_and_name_give_the_same_outcomes(name: str) -> None:
    dues = due_times(3000, 700)
    once = passed(LINKS[name], dues)
    assert passed(LINKS[name], dues) == once
    if name not in ("clear", "latency"):
        assert passed(LINKS[name], dues, seed=2) != once
        assert passed(LINKS[name], dues, name="other") != once


def test_the_outcomes_are_those_that_were_recorded() -> None:
    # With another digest no recorded session gives its messages again.
    assert digest(passed(LINKS["all"], due_times(3000, 700))) == (
        "de6e8b6ebf45eb9a0e7dc76d7c1a65ac3e5c603779d0a26a5c8a7a76ccc2fb82"
    )


@EVERY_LINK
def test_a_link_started_anew_joins_the_one_that_went_on(name: str) -> None:
    dues = due_times(6000, 1000)
    whole = passed(LINKS[name], dues)
    for start in (1000, 3000):  # borders of seconds
        again = passed(LINKS[name], dues[start:])
        differ = [i for i, pair in enumerate(zip(whole[start:], again, strict=True))
                  if pair[0] != pair[1]]  # fmt: skip
        assert not differ or differ[-1] < 1000


@EVERY_LINK
def test_links_know_nothing_of_each_other(name: str) -> None:
    dues = due_times(2000, 700)
    alone = passed(LINKS[name], dues)
    one, other = Impairment(LINKS[name], 1, "radar"), Impairment(LINKS["all"], 9, "other")
    together = []
    for i, due in enumerate(dues):
        together.append(one.pass_on(due, OCTETS))
        if i % 3:
            other.pass_on(due, i)
    assert together == alone


def test_rows_are_the_same_however_they_are_drawn() -> None:
    whole = random_rows(Chance(1, "radar"), 7, 0, 100)
    chance = Chance(1, "radar")
    for first, count in ((90, 10), (0, 3), (3, 40), (43, 1)):
        np.testing.assert_array_equal(
            random_rows(chance, 7, first, count), whole[first : first + count]
        )
    assert not np.isin(random_rows(chance, 8, 0, 100), whole).any()


@pytest.mark.parametrize("rate_hz", [1, 7, 33, 20_000])
def test_blocks_leave_no_trace(rate_hz: int) -> None:
    """What a message draws depends on its place in its second alone."""
    dues = due_times(3 * rate_hz, rate_hz)
    outcomes = passed(link(jitter_ms=10.0, latency_ms=50.0, loss=BURSTS), dues)
    law = passed(link(jitter_ms=10.0, latency_ms=50.0), dues)
    seen = [(o.copies, kept.copies) for o, kept in zip(outcomes, law, strict=True) if o.copies]
    assert all(copies == kept for copies, kept in seen)
    tail = passed(link(jitter_ms=10.0, latency_ms=50.0), dues[rate_hz:])
    assert tail == law[rate_hz:]


SETTINGS: dict[str, dict[str, Any]] = {
    "loss": {"loss": BURSTS},
    "duplicate": {"duplicate": 0.3},
    "corrupt": {"corrupt": 0.3},
    "reorder": {"reorder": {"probability": 0.3}},
    "jitter": {"latency_ms": 50.0, "jitter_ms": 10.0},
}


def traces(outcomes: list[Outcome]) -> dict[str, list[object]]:
    """What each setting did to each message that all of them let through."""
    return {
        "duplicate": [len(o.copies) == 2 for o in outcomes],
        "corrupt": [o.copies[0].flipped_bit if o.copies else None for o in outcomes],
        "jitter": [o.copies[0].due_utc_ns if o.copies else None for o in outcomes],
    }


@pytest.mark.parametrize("changed", SETTINGS)
def test_a_setting_shuffles_no_draws_of_others(changed: str) -> None:
    dues = due_times(2000, 500)
    for other in {"duplicate", "corrupt", "jitter"} - {changed}:
        if {changed, other} == {"reorder", "jitter"}:
            continue  # which takes the delay away
        alone = traces(passed(link(**SETTINGS[other]), dues))[other]
        both = passed(link(**SETTINGS[other], **SETTINGS[changed]), dues)
        for was, now, outcome in zip(alone, traces(both)[other], both, strict=True):
            assert was == now or not outcome.copies


def test_an_outage_drops_and_changes_nothing_after_it() -> None:
    dues = due_times(3000, 500)
    asked = link(**ALL | {"rate_kbit_s": None, "reorder": None})
    whole = passed(asked, dues)
    impairment = Impairment(asked, 1, "radar")
    outcomes = []
    for i, due in enumerate(dues):
        if i == 400:
            impairment.change(asked.model_copy(update={"down": True}))
        if i == 800:
            impairment.change(asked)
        outcomes.append(impairment.pass_on(due, OCTETS))
    assert {o.fate for o in outcomes[400:800]} == {pb.OUTAGE}
    assert outcomes[:400] == whole[:400]
    assert outcomes[800:] == whole[800:]


def test_a_link_that_stalls_holds_what_comes_while_it_is_down() -> None:
    impairment = Impairment(link(latency_ms=5.0, on_loss="stall", down=True), 1, "radar")
    assert impairment.pass_on(START_NS, OCTETS) == HELD
    impairment.change(link(latency_ms=5.0, on_loss="stall"))
    later = START_NS + 3 * NS
    assert impairment.pass_on(later, OCTETS).copies == (Copy(later + 5_000_000, None),)
    # What is passed on late with its own due time leaves no sooner than what came before.
    assert impairment.pass_on(START_NS, OCTETS).copies == (Copy(later + 5_000_000, None),)


def test_a_change_of_link_takes_effect_at_once_and_draws_on() -> None:
    dues = due_times(2000, 500)
    impairment = Impairment(link(), 1, "radar")
    jitter = link(**SETTINGS["jitter"])
    expected = passed(jitter, dues)
    for i, due in enumerate(dues):
        if i % 100 == 0:
            impairment.change(jitter if i // 100 % 2 else link())
        outcome = impairment.pass_on(due, OCTETS)
        assert impairment.link.is_clear != bool(i // 100 % 2)
        assert outcome == (expected[i] if i // 100 % 2 else Outcome(pb.SENT, (Copy(due, None),)))


@pytest.mark.parametrize("correlation", [0.0, 0.9])
@pytest.mark.parametrize("loss", [BURSTS, ALL["loss"]])
def test_a_change_to_the_same_changes_nothing(correlation: float, loss: Any) -> None:
    dues = due_times(3000, 700)
    asked = link(latency_ms=5.0, jitter_ms=1.0, delay_correlation=correlation, loss=loss)
    impairment = Impairment(asked, 1, "radar")
    outcomes = []
    for i, due in enumerate(dues):
        if i % 37 == 0:
            impairment.change(asked.model_copy())
        outcomes.append(impairment.pass_on(due, OCTETS))
    assert outcomes == passed(asked, dues)


def test_order_holds_against_what_left_before_it_was_asked_for() -> None:
    impairment = Impairment(link(latency_ms=100.0), 1, "radar")
    (slow,) = impairment.pass_on(START_NS, OCTETS).copies
    impairment.change(link(in_order=True))
    (quick,) = impairment.pass_on(START_NS + 1, OCTETS).copies
    assert quick.due_utc_ns == slow.due_utc_ns
    impairment.change(link())
    assert impairment.pass_on(START_NS + 2, OCTETS).copies == (Copy(START_NS + 2, None),)


def test_the_state_of_loss_outlives_a_change() -> None:
    forever = {"kind": "gilbert-elliott", "p": 1.0, "r": 0.0}
    never_begins = {"kind": "gilbert-elliott", "p": 0.0, "r": 1e-12}
    impairment = Impairment(link(loss=forever), 1, "radar")
    dues = due_times(50, 100)
    assert impairment.pass_on(dues[0], OCTETS).fate == pb.LOST
    impairment.change(link(loss=never_begins))
    assert {impairment.pass_on(due, OCTETS).fate for due in dues} == {pb.LOST}


def test_a_flipped_bit_is_one_bit() -> None:
    payload = bytes(range(256))
    for bit in range(8 * len(payload)):
        flipped = flip(payload, bit)
        assert flipped != payload
        difference = int.from_bytes(flipped, "big") ^ int.from_bytes(payload, "big")
        assert difference == 1 << (8 * len(payload) - 1 - bit)


def test_an_empty_payload_has_no_bit_to_flip() -> None:
    impairment = Impairment(link(corrupt=1.0, duplicate=1.0), 1, "radar")
    assert [c.flipped_bit for c in impairment.pass_on(START_NS, 0).copies] == [None, None]
    assert {c.flipped_bit for c in impairment.pass_on(START_NS, 1).copies} <= set(range(8))


@pytest.mark.parametrize("gap", [1, 2, 5])
def test_every_gap_th_message_overtakes(gap: int) -> None:
    asked = link(latency_ms=50.0, reorder={"probability": 1.0, "gap": gap})
    dues = due_times(50, 1000)
    outcomes = passed(asked, dues)
    at_once = [o.copies[0].due_utc_ns == due for o, due in zip(outcomes, dues, strict=True)]
    assert at_once == [i % gap == gap - 1 for i in range(50)]


def test_a_link_in_order_never_overtakes_though_it_duplicates() -> None:
    asked = link(**ALL | {"in_order": True, "reorder": None})
    left = [c.due_utc_ns for o in passed(asked, due_times(3000, 700)) for c in o.copies]
    assert left == sorted(left)

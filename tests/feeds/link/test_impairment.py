from __future__ import annotations

import hashlib
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from support.links import OCTETS, START_NS, due_times, link, passed

from plotfeed.feeds.link.delays import MOST_REPEATS, DelayLaw, waits_ns
from plotfeed.feeds.link.impairment import (
    HELD,
    LOST,
    OUTAGE,
    QUEUE_FULL,
    Copy,
    Impairment,
    LinkExpectation,
    Outcome,
    flip,
)
from plotfeed.feeds.scene.link_keys import LONGEST_DELAY_MS, LinkSettings
from plotfeed.proto import plotfeed_pb2 as pb

MS = 1_000_000
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


def test_the_outcomes_are_those_that_were_recorded() -> None:
    """With another digest no recorded session gives its messages again."""
    dues = due_times(3000, 700)
    once, changed = passed(LINKS["all"], dues), Impairment(LINKS["all"], 1, "radar")
    assert digest(once) == "de6e8b6ebf45eb9a0e7dc76d7c1a65ac3e5c603779d0a26a5c8a7a76ccc2fb82"
    assert passed(LINKS["all"], dues, seed=2) != once
    assert passed(LINKS["all"], dues, name="other") != once
    for i, due in enumerate(dues):
        if i % 37 == 0:
            changed.change(LINKS["all"].model_copy())  # to the same
        assert changed.pass_on(due, OCTETS) == once[i]


@EVERY_LINK
def test_a_link_started_anew_joins_the_one_that_went_on(name: str) -> None:
    dues = due_times(6000, 1000)
    whole = passed(LINKS[name], dues)
    for start in (1000, 3000):  # borders of seconds
        again = passed(LINKS[name], dues[start:])
        differ = [i for i, pair in enumerate(zip(whole[start:], again, strict=True))
                  if pair[0] != pair[1]]  # fmt: skip
        assert not differ or differ[-1] < 1000


@pytest.mark.parametrize("rate_hz", [1, 7, 20_000])
def test_blocks_leave_no_trace(rate_hz: int) -> None:
    """What a message draws depends on its place in its second alone."""
    asked, dues = link(**SETTINGS["jitter"]), due_times(3 * rate_hz, rate_hz)
    assert passed(asked, dues[rate_hz:]) == passed(asked, dues)[rate_hz:]


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


SLOW = {"rate_kbit_s": 80.0}  # 10 octets a millisecond
LOSE_ALL = {"loss": {"kind": "random", "probability": 1.0}}
STALL = {"latency_ms": 20.0, "on_loss": "stall"}
ALWAYS = {"loss": {"kind": "gilbert-elliott", "p": 1.0, "r": 0.0}}
NEVER_BEGINS = {"loss": {"kind": "gilbert-elliott", "p": 0.0, "r": 1e-12}}
COPIES, SMALL = {"duplicate": 1.0, "corrupt": 1.0}, SLOW | {"queue_messages": 3}
HEADERS = SLOW | {"overhead_octets": 40, "latency_ms": 7.0}
THREE = [(0, 100, [10]), (0, 100, [20]), (0, 100, [30]), (0, 100, QUEUE_FULL)]
# Of one link, in turn: its settings from then on, or a message, due at so many milliseconds and of
# so many octets, and when its copies leave, or what becomes of it instead.
CASES: dict[str, list[Any]] = {
    "down": [STALL | {"down": True}, (0, 60, HELD), STALL, (3000, 60, [3020]), (0, 60, [3020])],
    "order": [{"latency_ms": 100.0}, (0, 9, [100]), {"in_order": True}, (1, 9, [100])],
    "no order any more": [{"latency_ms": 100.0}, (0, 9, [100]), {}, (2, 9, [2])],
    "state of loss": [ALWAYS, (0, 60, LOST), NEVER_BEGINS, *[(n, 60, LOST) for n in range(50)]],
    "no bit to flip": [COPIES, (0, 0, [0, 0])],
    "headers": [HEADERS, (0, 60, [17]), (0, 160, [37]), (50, 0, [61])],
    "full": [SMALL, *THREE, (20, 100, [40]), (20, 100, [50]), (20, 100, QUEUE_FULL)],
    "a copy waits": [SMALL | COPIES, (0, 100, [10, 20]), (0, 100, [30]), (0, 100, QUEUE_FULL)],
    "quicker": [SLOW, (0, 1000, [100]), {"rate_kbit_s": 800.0}, (0, 1000, [110])],
    "no rate any more": [SLOW, (0, 1000, [100]), {}, (1, 1000, [100]), (1000, 1000, [1000])],
    "lost before it waits": [SLOW | LOSE_ALL, (0, 100, LOST), SLOW, (0, 100, [10])],
    # The last of its repeats is after 240, 480, ... ms and then every 120 s; what is behind waits.
    "lost again and again": [STALL | LOSE_ALL, (0, 9, [842_660]), STALL, (10, 9, [842_660])],
}


@pytest.mark.parametrize("case", CASES)
def test_a_link_does_what_is_worked_out_by_hand(case: str) -> None:
    settings, *steps = CASES[case]
    impairment = Impairment(link(**settings), 1, "radar")
    for step in steps:
        if isinstance(step, dict):
            impairment.change(link(**step))
            continue
        due_ms, octets, expected = step
        outcome = impairment.pass_on(START_NS + due_ms * MS, octets)
        if isinstance(expected, Outcome):
            assert outcome == expected
        else:
            assert [(c.due_utc_ns - START_NS) / MS for c in outcome.copies] == expected
            assert octets or {c.flipped_bit for c in outcome.copies} == {None}


# Of a quick link it is that of Linux; the mean deviation of a normal law is sigma sqrt(2/pi), and
# there and back sqrt(2) of it.
@pytest.mark.parametrize(
    ("law", "first_ms"),
    [
        (DelayLaw(0.0), 200.0),
        (DelayLaw(20.0), 240.0),
        (DelayLaw(1000.0, 100.0), 2000 + 4 * np.sqrt(2) * 100 * np.sqrt(2 / np.pi)),
    ],
)
def test_repeats_wait_twice_as_long_each_time_up_to_two_minutes(
    law: DelayLaw, first_ms: float
) -> None:
    expected = [min(first_ms * 2**n, 120_000.0) for n in range(MOST_REPEATS)]
    np.testing.assert_allclose(np.diff(waits_ns(law)) / MS, expected, rtol=1e-3)


# Any link, and any messages.

chance = st.floats(0, 1)
delay = st.one_of(st.floats(0, LONGEST_DELAY_MS), st.floats(0, 100))
losses = st.one_of(
    st.fixed_dictionaries({"kind": st.just("random"), "probability": chance},
                          optional={"correlation": st.floats(-1, 1)}),
    st.fixed_dictionaries({"kind": st.just("gilbert-elliott"), "p": chance, "r": chance},
                          optional={"good_loss": chance, "bad_loss": chance}),
    st.fixed_dictionaries({"kind": st.just("gilbert-elliott"), "mean_loss": chance,
                           "mean_burst": st.floats(1, 1e6)}),
    st.fixed_dictionaries({"kind": st.just("four-state"), "p13": chance},
                          optional=dict.fromkeys(("p31", "p32", "p23", "p14"), chance)),
)  # fmt: skip
tables = st.fixed_dictionaries(
    {},
    optional={
        "latency_ms": delay,
        "jitter_ms": delay,
        "distribution": st.sampled_from(["normal", "uniform", "pareto", "paretonormal"]),
        "delay_correlation": st.floats(-1, 1),
        "loss": losses,
        "on_loss": st.sampled_from(["drop", "stall"]),
        "duplicate": chance,
        "corrupt": chance,
        "in_order": st.booleans(),
        "reorder": st.fixed_dictionaries(
            {"probability": chance}, optional={"gap": st.integers(1, 10)}
        ),
        "rate_kbit_s": st.floats(0.001, 1e9),
        "overhead_octets": st.integers(0, 65_535),
        "queue_messages": st.integers(1, 100),
        "down": st.booleans(),
    },
)
by_table = st.fixed_dictionaries(
    {
        "distribution": st.just("table"),
        "delays_ms": st.lists(delay, min_size=1, max_size=20),
        "latency_ms": delay,
        "delay_correlation": st.floats(-0.99, 0.99),
    }
)


def valid(keys: dict[str, Any]) -> LinkSettings | None:
    try:
        return LinkSettings.model_validate(keys)
    except ValidationError:
        return None


links = st.one_of(tables, by_table).map(valid).filter(lambda found: found is not None)
steps_ns = st.one_of(st.integers(0, 10**7), st.integers(0, 10**12))
messages = st.lists(st.tuples(steps_ns, st.integers(0, 1 << 28)), min_size=1, max_size=60)


@given(links, links, messages, st.integers(0, (1 << 63) - 1), st.text(max_size=64))
def test_any_link_passes_any_messages_on(
    first: LinkSettings, second: LinkSettings, sent: list[tuple[int, int]], seed: int, name: str
) -> None:
    def outcomes() -> list[Any]:
        impairment, due, found = Impairment(first, seed, name), START_NS, []
        for i, (step, octets) in enumerate(sent):
            if i == len(sent) // 2:
                impairment.change(second)
            due += step
            found.append((due, octets, impairment.link, impairment.pass_on(due, octets)))
        return found

    all_of_it = outcomes()
    assert all_of_it == outcomes()
    for due, octets, asked, outcome in all_of_it:
        assert len(outcome.copies) <= 2
        assert bool(outcome.copies) == (outcome.fate == pb.SENT)
        assert outcome.fate != pb.LOST or asked.on_loss == "drop"
        for copy in outcome.copies:
            assert copy.due_utc_ns >= due
            assert copy.flipped_bit is None or 0 <= copy.flipped_bit < 8 * octets
        if asked.down:
            assert outcome is (OUTAGE if asked.on_loss == "drop" else HELD)
    for (*_, one), (_, _, asked, other) in pairwise(all_of_it):
        if asked.keeps_order and one.copies and other.copies:
            assert one.copies[-1].due_utc_ns <= other.copies[0].due_utc_ns


@given(links)
def test_any_link_says_what_it_asks(link: LinkSettings) -> None:
    asked = LinkExpectation(link)
    quantiles = asked.delay.quantile_ms(np.linspace(0, 1, 11))
    assert (np.diff(quantiles) >= 0).all()
    assert 0 <= asked.loss.mean_loss <= 1
    assert asked.loss.spread_of_loss(1000) >= 0
    assert not asked.loss.mean_burst < 1 - 1e-9
    survival = asked.loss.burst_survival(20)
    assert not ((survival < -1e-9) | (survival > 1 + 1e-9)).any()


@given(st.binary(min_size=1, max_size=100), st.data())
def test_a_flipped_bit_is_one_bit(payload: bytes, data: st.DataObject) -> None:
    bit = data.draw(st.integers(0, 8 * len(payload) - 1))
    flipped = flip(payload, bit)
    difference = int.from_bytes(flipped, "big") ^ int.from_bytes(payload, "big")
    assert difference == 1 << (8 * len(payload) - 1 - bit)
    assert flip(flipped, bit) == payload

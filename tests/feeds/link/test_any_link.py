from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from support.links import START_NS

from plotfeed.feeds.link.impairment import HELD, OUTAGE, Impairment, LinkExpectation, flip
from plotfeed.feeds.scene.link_keys import LONGEST_DELAY_MS, LinkSettings
from plotfeed.proto import plotfeed_pb2 as pb

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
    for due, octets, link, outcome in all_of_it:
        assert len(outcome.copies) <= 2
        assert bool(outcome.copies) == (outcome.fate == pb.SENT)
        assert outcome.fate != pb.LOST or link.on_loss == "drop"
        for copy in outcome.copies:
            assert copy.due_utc_ns >= due
            assert copy.flipped_bit is None or 0 <= copy.flipped_bit < 8 * octets
        if link.down:
            assert outcome is (OUTAGE if link.on_loss == "drop" else HELD)
    for (*_, one), (_, _, link, other) in pairwise(all_of_it):
        if link.keeps_order and one.copies and other.copies:
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
    assert not abs(asked.loss.lag_1_correlation) > 1 + 1e-6


@given(st.binary(min_size=1, max_size=100), st.data())
def test_a_flipped_bit_is_one_bit(payload: bytes, data: st.DataObject) -> None:
    bit = data.draw(st.integers(0, 8 * len(payload) - 1))
    flipped = flip(payload, bit)
    difference = int.from_bytes(flipped, "big") ^ int.from_bytes(payload, "big")
    assert difference == 1 << (8 * len(payload) - 1 - bit)
    assert flip(flipped, bit) == payload

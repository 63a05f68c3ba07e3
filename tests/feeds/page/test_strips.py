from __future__ import annotations

from itertools import groupby
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from support.links import link

from plotfeed.feeds.link.delays import DelayLaw
from plotfeed.feeds.page.strips import (
    BINS,
    LOSSES_KEPT,
    OFF_BELOW,
    LinkRecord,
    looks_summary,
    new_looks,
)

RANDOM = {"kind": "random", "probability": 0.1}
BURSTS = {"kind": "gilbert-elliott", "mean_loss": 0.1, "mean_burst": 4.0}


@given(st.lists(st.booleans(), min_size=1, max_size=80), st.randoms())
def test_bursts_are_counted_in_whatever_order_messages_are_heard_of(
    lost: list[bool], order: object
) -> None:
    record, numbers = LinkRecord(), list(range(len(lost)))
    order.shuffle(numbers)  # type: ignore[attr-defined]
    for number in numbers:
        if lost[number]:
            record.lost(number, 0)
        else:
            record.sent(0, 10**6, duplicate=False)
    bursts = sum(is_lost for is_lost, _ in groupby(lost))
    found = record.summary()
    assert found["mean_burst"] == (sum(lost) / bursts if bursts else None)
    assert found["lost"] == sum(lost)


def test_memory_of_losses_is_bounded_and_bursts_stay_right() -> None:
    record = LinkRecord()
    for number in range(0, 8 * LOSSES_KEPT, 4):
        record.lost(number, 0)
        record.lost(number + 1, 0)
    assert record.summary()["mean_burst"] == 2.0
    assert len(record._lost_numbers) == len(record._lost_lately) == LOSSES_KEPT


@pytest.mark.parametrize(
    ("latency_ms", "jitter_ms", "distribution"),
    [
        *((250.0, jitter_ms, "normal") for jitter_ms in (30.0, 200.0)),
        *((50.0, 10.0, shape) for shape in ("uniform", "pareto")),
        (1000.0, 4.0, "normal"),
        (0.05, 0.01, "normal"),
    ],
)
def test_the_asked_histogram_is_that_of_the_law(
    latency_ms: float, jitter_ms: float, distribution: str
) -> None:
    asked = link(latency_ms=latency_ms, jitter_ms=jitter_ms, distribution=distribution)
    record, law = LinkRecord(), DelayLaw.of(asked)
    record.begin(asked)
    found = record.summary()
    edges_ms = found["low_ms"] + found["width_ms"] * np.arange(BINS + 1)
    expected = np.diff(law.cdf(edges_ms - 1e-9))
    np.testing.assert_allclose(found["asked"], expected, atol=0.006)
    assert sum(found["asked"]) > 0.98
    assert found["asked_mean_ms"] == pytest.approx(law.mean_ms(), rel=0.01)


def test_delivered_and_asked_share_their_bins() -> None:
    for delivered_ms, asked_ms in ((120.03, 120.0), (10.0, 500.0), (500.0, 10.0)):
        record = LinkRecord()
        record.begin(link(latency_ms=asked_ms))
        for _ in range(50):
            record.sent(0, round(delivered_ms * 1e6), duplicate=False)
        found = record.summary()
        assert sum(found["delivered"]) == pytest.approx(1.0)
        assert sum(found["asked"]) == pytest.approx(1.0)
        # A constant delay is one bin, which holds what was delivered.
        assert (found["delivered"] == found["asked"]) == (asked_ms == 120.0)
    nothing = LinkRecord().summary()
    assert nothing["delivered"] == nothing["asked"] == []
    assert nothing["mean_ms"] is nothing["asked_mean_ms"] is nothing["mean_burst"] is None


def rarely(count: int, of: int, chance: float) -> bool:
    """Whether so many of independent trials hardly come by chance."""
    law = stats.binom(of, chance)
    return bool(2 * min(law.cdf(count), law.sf(count - 1)) < OFF_BELOW)


def loss_is_off(lost: int, loss: dict[str, Any] | None) -> bool:
    """What a strip says of so many lost of 300, between outages that take a message each."""
    record = LinkRecord()
    record.begin(link(latency_ms=50.0, loss=loss))
    for number in range(300):
        record.lost(1000 + number, 0, by_chain=False)  # of no weight
        if number < lost:
            record.lost(number, 0)
        else:
            record.sent(0, 50, duplicate=False)
    return bool(record.summary()["loss_off"])


def test_a_strip_calls_off_what_hardly_comes_by_chance() -> None:
    for lost in range(80):
        assert loss_is_off(lost, RANDOM) == rarely(lost, 300, 0.1)
    assert loss_is_off(60, RANDOM)
    assert not loss_is_off(60, BURSTS)  # where losses come in bursts, their number varies more
    assert loss_is_off(120, BURSTS)
    assert [loss_is_off(lost, None) for lost in (0, 1)] == [False, True]
    for detected in range(150, 201):
        looks = new_looks(2500.0)
        looks.add([500.0] * 200, [0.9] * 200, [True] * detected + [False] * (200 - detected))
        assert looks_summary(looks)["off"] == rarely(detected, 200, 0.9)

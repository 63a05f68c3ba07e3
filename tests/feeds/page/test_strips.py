from __future__ import annotations

from itertools import groupby

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from support.links import link
from support.significance import assert_chance

from plotfeed import testing
from plotfeed.feeds.link.delays import DelayLaw
from plotfeed.feeds.link.losses import chain_of
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.page.strips import (
    BINS,
    LOSSES_KEPT,
    OFF_BELOW,
    LinkRecord,
    looks_summary,
    new_looks,
)
from plotfeed.feeds.page.view import View
from plotfeed.models.beam import Sector
from plotfeed.models.state import Looks

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


OFTEN = 400


def test_a_strip_calls_what_is_right_off_as_seldom_as_it_says() -> None:
    rng, losses_off, looks_off = np.random.default_rng(12), 0, 0
    for keys in (RANDOM, BURSTS):
        asked = link(latency_ms=50.0, loss=keys)
        chain = chain_of(asked.loss)
        for _ in range(OFTEN):
            record = LinkRecord()
            record.begin(asked)
            state = int(rng.choice(len(chain.stationary), p=chain.stationary))
            for number in range(300):
                state = int(rng.random() > chain.steps[state][0])
                if rng.random() < chain.emissions[state]:
                    record.lost(number, 0)
                else:
                    record.sent(0, 50, duplicate=False)
            losses_off += record.summary()["loss_off"]
            looks, pd = new_looks(2500.0), rng.random(200)
            looks.add(rng.uniform(0, 2500, 200), pd, rng.random(200) < pd)
            looks_off += looks_summary(looks)["off"]
    for off in (losses_off, looks_off):
        assert_chance(float(stats.binom.sf(off - 1, 2 * OFTEN, OFF_BELOW)), f"{off} off")


def test_a_strip_says_what_is_off() -> None:
    looks = new_looks(2500.0)
    looks.add([500.0] * 200, [0.9] * 200, [True] * 120 + [False] * 80)
    assert looks_summary(looks)["off"]
    record = LinkRecord()
    record.begin(link(latency_ms=50.0, loss=RANDOM))
    for number in range(300):
        record.sent(0, 50, duplicate=False)
        record.lost(1000 + number, 0, by_chain=False)  # by an outage: of no weight, so none is lost
    assert record.summary()["loss_off"]
    clear = LinkRecord()
    clear.begin(link(latency_ms=50.0))
    clear.sent(0, 50, duplicate=False)
    assert not clear.summary()["loss_off"]
    clear.lost(1, 0)
    assert clear.summary()["loss_off"]


def test_looks_that_merge_count_once() -> None:
    both = Looks.none().but(
        **{name: np.zeros(2, np.int64) for name in ("drone", "channel", "t_utc_ns")},
        **{name: np.full(2, 500.0) for name in ("range_m", "azimuth_deg", "elevation_deg")},
        snr=np.ones(2),
        pd=np.full(2, 0.5),
        detected=np.ones(2, np.bool_),
    )
    for keys, expected in (({"merging": {}}, 1), ({}, 2)):
        view, scene = View(), testing.scene([testing.radar(**keys)], seed=1)
        view.scene(scene)
        view.settings(scene.sensor[0], 0)
        sector = Sector(0, 0, 0, 1, 0.0, 360.0)
        view.settled(Batch.of_one(sector, looks=both, sensors=["radar"]), [])
        assert sum(looks_summary(view._looks[0])["looks"]) == expected

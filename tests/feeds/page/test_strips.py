from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from support.links import link
from support.random_scenes import random_tree
from support.significance import assert_chance

from plotfeed.feeds.link.delays import DelayLaw
from plotfeed.feeds.link.losses import chain_of
from plotfeed.feeds.page.strips import (
    BINS,
    LOSSES_KEPT,
    OFF_BELOW,
    RANGE_BINS,
    LinkRecord,
    looks_summary,
    new_looks,
)
from plotfeed.feeds.page.view import View
from plotfeed.feeds.scene.scene import from_tree
from plotfeed.models.sensors.sensor_model import NO_PLOTS
from plotfeed.models.state import Looks, Plots

PROBABILITIES = np.linspace(0, 1, 1001)


@given(st.lists(st.booleans(), min_size=1, max_size=80), st.randoms())
def test_bursts_are_counted_in_whatever_order_messages_are_heard_of(
    lost: list[bool], order: object
) -> None:
    link = LinkRecord()
    numbers = list(range(len(lost)))
    order.shuffle(numbers)  # type: ignore[attr-defined]
    for number in numbers:
        if lost[number]:
            link.lost(number, 0)
        else:
            link.sent(0, 10**6, duplicate=False)
    bursts = sum(is_lost for is_lost, _ in groupby(lost))
    expected = sum(lost) / bursts if bursts else None
    assert link.summary()["mean_burst"] == expected
    assert link.summary()["lost"] == sum(lost)


def test_what_is_expected_of_looks_are_their_odds_not_what_was_detected() -> None:
    """Looks at 100 and 1100 m by their own Pd; nothing near was detected, all of the far were."""
    looks = new_looks(2500.0)
    looks.add([100.0] * 8, [0.9, 0.5] * 4, [False] * 8)
    looks.add([1100.0] * 4, [0.25] * 4, [True] * 4)
    found = looks_summary(looks)
    assert found["width_m"] == 100.0
    shown = {
        name: (found[name][1], found[name][11]) for name in found if name not in ("width_m", "off")
    }
    assert shown == {
        "looks": (8, 4),
        "detected": (0, 4),
        "expected": (5.6, 1.0),
        "variance": (1.36, 0.75),
    }
    assert all(len(column) == RANGE_BINS for name, column in found.items() if name in shown)
    assert sum(found["looks"]) == 12


def test_memory_of_losses_is_bounded_and_bursts_stay_right() -> None:
    link = LinkRecord()
    for number in range(0, 8 * LOSSES_KEPT, 4):
        link.lost(number, 0)
        link.lost(number + 1, 0)
    assert link.summary()["mean_burst"] == 2.0


@pytest.mark.parametrize(
    "law",
    [
        DelayLaw(250.0, 30.0),
        DelayLaw(250.0, 200.0),
        DelayLaw(50.0, 10.0, "uniform"),
        DelayLaw(50.0, 10.0, "pareto"),
        DelayLaw(1000.0, 4.0),
        DelayLaw(0.05, 0.01),
    ],
)
def test_the_asked_histogram_is_that_of_the_law(law: DelayLaw) -> None:
    link = LinkRecord()
    link.begin(law.quantile_ms(PROBABILITIES))
    found = link.summary()
    edges_ms = found["low_ms"] + found["width_ms"] * np.arange(BINS + 1)
    expected = np.diff(law.cdf(edges_ms - 1e-9))
    np.testing.assert_allclose(found["asked"], expected, atol=0.006)
    assert sum(found["asked"]) > 0.98
    assert found["asked_mean_ms"] == pytest.approx(law.mean_ms(), rel=0.01)


def test_a_constant_delay_is_one_bin_that_holds_what_was_delivered() -> None:
    link = LinkRecord()
    link.begin(DelayLaw(120.0).quantile_ms(PROBABILITIES))
    for _ in range(100):
        link.sent(0, 120_030_000, duplicate=False)
    found = link.summary()
    assert max(found["asked"]) == 1.0
    assert found["delivered"] == found["asked"]


def test_delivered_and_asked_share_their_bins_whichever_is_wider() -> None:
    for delivered_ms, asked_ms in ((10.0, 500.0), (500.0, 10.0)):
        link = LinkRecord()
        link.begin([asked_ms])
        for _ in range(50):
            link.sent(0, round(delivered_ms * 1e6), duplicate=False)
        found = link.summary()
        assert sum(found["delivered"]) == pytest.approx(1.0)
        assert sum(found["asked"]) == pytest.approx(1.0)
        assert found["delivered"] != found["asked"]


def test_a_link_of_which_nothing_is_known_has_no_moments() -> None:
    found = LinkRecord().summary()
    assert found["delivered"] == found["asked"] == []
    assert found["mean_ms"] is found["asked_mean_ms"] is found["mean_burst"] is None


def test_what_was_handed_over_before_a_change_is_not_judged_by_it() -> None:
    link = LinkRecord()
    link.begin([250.0], since_utc_ns=1000)
    link.sent(999, 5000, duplicate=False)
    link.lost(4, 999)
    link.sent(999, 6000, duplicate=True)
    found = link.summary()
    assert (found["messages"], found["lost"], found["duplicates"]) == (0, 0, 0)
    link.sent(1000, 5000, duplicate=False)
    assert link.summary()["messages"] == 1


OFTEN = 400


def test_a_strip_calls_right_losses_off_as_seldom_as_it_says() -> None:
    rng, off = np.random.default_rng(12), 0
    for keys in (
        {"kind": "random", "probability": 0.1},
        {"kind": "gilbert-elliott", "mean_loss": 0.1, "mean_burst": 4.0},
    ):
        chain = chain_of(link(loss=keys).loss)
        for _ in range(OFTEN):
            record = LinkRecord()
            record.begin([50.0], loss=chain)
            state = int(rng.choice(len(chain.stationary), p=chain.stationary))
            for number in range(300):
                state = int(rng.random() > chain.steps[state][0])
                if rng.random() < chain.emissions[state]:
                    record.lost(number, 0)
                else:
                    record.sent(0, 50, duplicate=False)
            off += record.summary()["loss_off"]
    assert_chance(float(stats.binom.sf(off - 1, 2 * OFTEN, OFF_BELOW)), f"{off} off")


def test_a_strip_calls_right_detections_off_as_seldom_as_it_says() -> None:
    rng, off = np.random.default_rng(13), 0
    for _ in range(2 * OFTEN):
        looks = new_looks(2500.0)
        pd = rng.random(200)
        looks.add(rng.uniform(0, 2500, 200), pd, rng.random(200) < pd)
        off += looks_summary(looks)["off"]
    assert_chance(float(stats.binom.sf(off - 1, 2 * OFTEN, OFF_BELOW)), f"{off} off")


def test_a_strip_says_what_is_off() -> None:
    looks = new_looks(2500.0)
    looks.add([500.0] * 200, [0.9] * 200, [True] * 120 + [False] * 80)
    assert looks_summary(looks)["off"]
    record = LinkRecord()
    record.begin([50.0], loss=chain_of(link(loss={"kind": "random", "probability": 0.1}).loss))
    for number in range(300):
        record.sent(0, 50, duplicate=False)
        record.lost(1000 + number, 0, by_chain=False)
    assert record.summary()["loss_off"]
    clear = LinkRecord()
    clear.begin([50.0], loss=chain_of(None))
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
    scene = from_tree(random_tree(3), Path("a.toml"))
    name = scene.sensor[0].id
    for keys, expected in (({"merging": {}}, 1), ({}, 2)):
        view = View()
        view.scene(scene)
        view.settings(name, keys)
        view.report(Sector(name, both, NO_PLOTS))
        assert sum(looks_summary(view._looks[0])["looks"]) == expected


class Sector(NamedTuple):
    sensor: str
    looks: Looks
    plots: Plots

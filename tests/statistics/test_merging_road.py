"""Drones too close to be told apart: how often they merge, where, how strongly, who they are."""

from __future__ import annotations

from collections import Counter
from functools import cache
from typing import Any

import numpy as np
import pytest
from support.every_kind import MIMO
from support.radar_equations import mean_snr, multiplier
from support.significance import assert_mean, assert_standard_normal, assert_sum

from plotfeed.models.frames import wrap_180
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.testing import Feed, fly, held, radar, rotating, scene

RADAR = radar(elevation_max_deg=60.0, merging={})
SCANS = 60
PAIRS = 20
RANGE_M = 3000.0  # Where a drone of 1 m2 is detected nearly always


def merged_in(road: Feed) -> Counter[tuple[str, ...]]:
    """How often each set of drones made one plot."""
    return Counter(
        tuple(sorted([plot.drone, *plot.merged_drones]))
        for entry in road.ledgers
        for plot in entry.plots
        if plot.drone
    )


def pairs(range_m: float = 0.0, azimuth_deg: float = 0.0, elevation_deg: float = 0.0) -> Any:
    """Drones of 1 m2 by two, so far apart, all around."""
    return [
        held(f"{i}-{k}", 360 * i / PAIRS + k * azimuth_deg, 10.0 + k * elevation_deg,
             RANGE_M + k * range_m, rcs_m2=1.0)
        for i in range(PAIRS) for k in range(2)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("apart", "scan"),
    [
        ({"range_m": 10.0}, None),
        ({"azimuth_deg": 1.5}, None),
        ({"elevation_deg": 7.0}, None),
        ({}, None),
        ({"azimuth_deg": 1.5}, rotating(1.0, 8)),
    ],
    ids=["range", "azimuth", "elevation", "in one place", "azimuth, rotating"],
)
def test_pairs_merge_as_often_as_their_distance_says(
    apart: dict[str, float], scan: dict[str, Any] | None
) -> None:
    """Rotating, four pairs of twenty straddle a border: ten sigma, if none of these merged."""
    sensor = RADAR | ({"scan": scan} if scan else {})
    found = merged_in(fly(scene([sensor], pairs(**apart), seed=71), SCANS))
    together = {drones: n for drones, n in found.items() if len(drones) > 1}
    assert {a.split("-")[0] == b.split("-")[0] for a, b in together} == {True}
    distance2 = sum(
        (apart.get(name, 0.0) / width) ** 2
        for name, width in (("range_m", 10.0), ("azimuth_deg", 2.0), ("elevation_deg", 6.0))
    )
    p = 2.0**-distance2
    n = SCANS * PAIRS
    seen = sum(together.values())
    if p == 1.0:
        assert seen >= 0.999 * n
        assert len(found) == PAIRS
        return
    # Pairs that stay apart make two plots; one in a few thousand is not detected.
    assert_sum(seen, n * p, n * p * (1 - p))
    singles = sum(count for drones, count in found.items() if len(drones) == 1)
    assert abs(singles - 2 * (n - seen)) < 0.01 * n


@cache
def unequal() -> Feed:
    """A drone of 1 m2 and one of a third, 4 m and a degree apart."""
    drones = [
        held(f"{i}-{k}", 18 * i + k * 1.0, 10.0, RANGE_M + 4.0 * k, rcs_m2=(1.0, 1 / 3)[k])
        for i in range(PAIRS)
        for k in range(2)
    ]
    return fly(scene([RADAR], drones, seed=73), 2 * SCANS)


def test_the_merged_plot_lies_at_the_centroid_of_powers() -> None:
    plots = unequal().plots()
    merged = np.array(
        [bool(plot.merged_drones) for entry in unequal().ledgers for plot in entry.plots]
    )
    assert 1000 < merged.sum() < len(merged)
    rows = plots.rows(merged)
    assert {name.split("-")[1] for name in rows.drone} == {"0"}, "the stronger is named first"
    # The weaker is farther: by its power it draws the plot a quarter of the way.
    second = (RANGE_M / (RANGE_M + 4.0)) ** 4 / 3
    share = second / (1 + second)
    assert_standard_normal(
        (rows.range_m - rows.true_range_m - 4.0 * share) / rows.sigma_range_m, "range"
    )
    off_deg = wrap_180(rows.azimuth_deg - rows.true_azimuth_deg)
    assert_standard_normal((off_deg - share) / rows.sigma_azimuth_deg, "azimuth")
    alone = plots.rows(~merged & (plots.drone != ""))
    assert_mean((alone.range_m - alone.true_range_m) / alone.sigma_range_m, 0.0)


def test_looks_of_merged_drones_share_their_odds_and_their_fate() -> None:
    """Two of one place and of unlike size: Pd of the sum of their mean ratios."""
    far_m = 11_000.0
    drones = [
        held(f"{i}-{k}", 18 * i, 10.0, far_m, rcs_m2=(0.01, 0.004)[k])
        for i in range(PAIRS)
        for k in range(2)
    ]
    road = fly(scene([RADAR], drones, seed=74), SCANS)
    snr = float(mean_snr(RADAR, far_m, 0.014))
    p = (1 + multiplier(RADAR) / (1 + snr)) ** -16
    looks = road.looks()
    np.testing.assert_allclose(looks.pd, p, rtol=1e-4)
    first, second = looks.rows(looks.drone < "x").detected[::2], looks.detected[1::2]
    assert (first == second).all()
    own = 10 ** (looks.snr_db / 10)
    np.testing.assert_allclose(own[::2] + own[1::2], snr, rtol=1e-4)
    assert_sum(first.sum(), p * len(first), p * (1 - p) * len(first))
    assert (road.plots().drone != "").sum() == first.sum()


def test_a_mimo_radar_sums_the_ratios_transmitter_by_transmitter() -> None:
    transmitters = [
        {"power_w": power_w, "east_m": 100.0 * k, "north_m": 0.0, "above_site_m": 0.0}
        for k, power_w in enumerate((2000.0, 500.0))
    ]
    weak = {"gain_tx_dbi": 11.6, "gain_rx_dbi": 11.6}
    sensor = MIMO | weak | {"transmitters": transmitters, "merging": {}}
    drones = [
        held(f"{i}-{k}", 24 * i, 10.0, 4000.0, rcs_m2=0.01) for i in range(15) for k in range(2)
    ]
    both = fly(scene([sensor], drones, seed=77), 60).looks()
    one = [held(f"{i}", 24 * i, 10.0, 4000.0, rcs_m2=0.02) for i in range(15)]
    alone = fly(scene([sensor], one, seed=77), 2).looks()
    np.testing.assert_allclose(both.pd[:30:2], alone.pd[:15], rtol=1e-3)


def test_a_ledger_says_who_merged_and_tells_the_tracker_nothing() -> None:
    road = fly(scene([RADAR], pairs()[:2], seed=79), 5)
    assert "merged" not in str(pb.PlotBatch.DESCRIPTOR.fields_by_name)
    truths = [plot for entry in road.ledgers for plot in entry.plots if plot.drone]
    assert {(plot.drone, *plot.merged_drones) for plot in truths} <= {
        ("0-0", "0-1"),
        ("0-1", "0-0"),
    }

"""Detections that leave as bytes against the closed form of Pd, range by range and scan by scan."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import stats
from support.radar_equations import pd
from support.significance import Array, assert_chance, assert_sum

from plotfeed.proto.utc import NS
from plotfeed.testing import Feed, flown, fly, held, radar, rotating, scene, waypoint

RANGES_M = (2e3, 4e3, 5.5e3, 7e3, 8.5e3, 10e3, 11.5e3, 13e3, 15e3, 18e3)
AT_EACH = 24
SCANS = 240
SENSORS = {
    "staring": radar(elevation_max_deg=30.0),
    "rotating": radar(elevation_max_deg=30.0, scan=rotating(0.5, sectors=4)),
}
KINDS = pytest.mark.parametrize("kind", SENSORS)


@cache
def road(kind: str) -> Feed:
    """Rings of drones at each of the ranges."""
    drones = [
        held(f"{ring}-{i}", 15 * i + ring + 1, 4.0, range_m)
        for ring, range_m in enumerate(RANGES_M)
        for i in range(AT_EACH)
    ]
    period_s = SENSORS[kind]["scan"]["period_s"]
    return fly(scene([SENSORS[kind]], drones, seed=11), SCANS * period_s)


@cache
def detected(kind: str) -> Array:
    """Whether category 048 and the protobuf have a plot: ring, drone, scan."""
    looks, plots = road(kind).looks(), road(kind).plots()
    assert len(looks) == len(RANGES_M) * AT_EACH * SCANS
    hits = np.zeros((len(RANGES_M), AT_EACH, SCANS), dtype=int)
    theirs = plots.rows(plots.drone != "")
    for drone, scan, rho_nm in zip(theirs.drone, theirs.scan, theirs.rho_nm, strict=True):
        ring, i = map(int, drone.split("-"))
        assert abs(rho_nm * 1852 - RANGES_M[ring]) < 60
        hits[ring, i, scan - looks.scan.min()] += 1
    return hits


@KINDS
def test_each_ring_is_detected_as_often_as_its_pd_says(kind: str) -> None:
    for hits, range_m in zip(detected(kind), RANGES_M, strict=True):
        p = float(pd(SENSORS[kind], range_m))
        assert_sum(hits.sum(), p * hits.size, p * (1 - p) * hits.size, f"{range_m:.0f} m")


@KINDS
def test_one_detection_is_one_plot(kind: str) -> None:
    assert detected(kind).max() == 1
    assert detected(kind).sum() == road(kind).looks().detected.sum()


@KINDS
def test_drones_of_a_ring_fare_alike(kind: str) -> None:
    p = pd(SENSORS[kind], np.array(RANGES_M))[:, None]
    counts = detected(kind).sum(axis=2)
    square = (counts - SCANS * p) ** 2 / (SCANS * p * (1 - p))
    assert_chance(float(stats.chi2.sf(square.sum(), counts.size)), "drone by drone, more")
    assert_chance(float(stats.chi2.cdf(square.sum(), counts.size)), "drone by drone, less")


@KINDS
def test_drones_of_a_scan_fare_independently(kind: str) -> None:
    """Their numbers of detections scatter from scan to scan as a sum of independent ones does."""
    p = pd(SENSORS[kind], np.array(RANGES_M))
    counts = detected(kind).sum(axis=(0, 1))
    variance = AT_EACH * (p * (1 - p)).sum()
    square = float(((counts - AT_EACH * p.sum()) ** 2).sum() / variance)
    assert_chance(float(stats.chi2.sf(square, SCANS)), "scan by scan, more")
    assert_chance(float(stats.chi2.cdf(square, SCANS)), "scan by scan, less")


@KINDS
def test_a_scan_does_not_know_of_the_one_before(kind: str) -> None:
    """Chi-square of independence of successive detections, ring by ring."""
    for hits, range_m in zip(detected(kind), RANGES_M, strict=True):
        pairs = 2 * hits[:, :-1] + hits[:, 1:]
        table = np.bincount(pairs.ravel(), minlength=4).reshape(2, 2)
        if table.min() >= 5:
            result: Any = stats.chi2_contingency(table, correction=False)
            assert_chance(float(result.pvalue), f"{range_m:.0f} m")


@KINDS
def test_runs_of_hits_and_misses_are_as_many_as_chance_makes(kind: str) -> None:
    """Runs test of Wald and Wolfowitz: given its hits, the runs of a drone, summed over all."""
    hits = detected(kind).reshape(-1, SCANS)
    n1 = hits.sum(axis=1).astype(float)
    n2 = SCANS - n1
    runs = 1 + (np.diff(hits, axis=1) != 0).sum(axis=1)
    mean = 1 + 2 * n1 * n2 / SCANS
    variance = (mean - 1) * (mean - 2) / (SCANS - 1)
    assert variance.sum() > 1000
    assert_sum(runs.sum(), mean.sum(), variance.sum(), "runs")


def test_a_moving_drone_is_detected_as_its_range_of_the_moment_says() -> None:
    """One flies from 16 km to 4 km, seen by a radar that stares and one that turns."""
    path = (waypoint(33.0, 3.0, 16_000.0), waypoint(33.0, 3.0, 4_000.0))
    sensors = [
        SENSORS[kind] | {"id": kind, "scan": SENSORS[kind]["scan"] | {"period_s": 0.25}}
        for kind in SENSORS
    ]
    flight = fly(scene(sensors, [flown("d", *path, speed_m_s=40.0, repeat=False)], seed=12), 299.0)
    for sensor in sensors:
        looks, plots = flight.looks(sensor["id"]), flight.plots(sensor["id"])
        assert abs(len(looks) - 4 * 299) <= 1
        t_s = looks.time_utc_ns / NS - 1_700_000_000
        np.testing.assert_allclose(looks.range_m, 16_000 - 40 * t_s, atol=0.5)
        p = pd(sensor, looks.range_m)
        for part in np.array_split(np.arange(len(looks)), 6):
            times = looks.time_utc_ns[part]
            found = np.isin(times, plots.time_utc_ns[plots.drone == "d"]).sum()
            assert_sum(found, p[part].sum(), (p[part] * (1 - p[part])).sum(), sensor["id"])

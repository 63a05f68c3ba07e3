"""A turning radar, from the scene to the bytes: when it looks where, and what it says in between.

Tests of significance are at the rate of tests/support/significance.py; the rest is exact.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from support.significance import Array
from support.targets import add_sample

from plotfeed import Engine
from plotfeed.models.frames import aer_to_enu, wrap_180
from plotfeed.models.state import Signature
from plotfeed.proto.utc import NS
from plotfeed.testing import (
    START_NS,
    Feed,
    FeedTable,
    flown,
    fly,
    held,
    radar,
    rotating,
    scene,
    waypoint,
)

SCANS = {"quick": rotating(1.0, 32), "odd": rotating(0.7, 7)}
TURNS = 60
EVERY_SCAN = pytest.mark.parametrize("name", SCANS)


def beam_deg(t_utc_ns: Array, period_ns: int) -> Array:
    return np.asarray(t_utc_ns % period_ns * (360 / period_ns))


@cache
def crossing(name: str) -> Feed:
    """Drones that cross north, south and every sector's border, both ways, near and far."""
    rng = np.random.default_rng(60)
    drones = []
    for i in range(80):
        centre_deg, closest_m = 4.5 * i, rng.uniform(100, 4000)
        ends = (
            aer_to_enu(centre_deg + side, 0.0, closest_m / np.cos(np.radians(70)))
            for side in ((-70, 70), (70, -70))[i % 2]
        )
        places = [
            {"east_m": float(e), "north_m": float(n), "above_site_m": float(30 + i)}
            for e, n, _ in ends
        ]
        drones.append(flown(f"d{i}", *places, speed_m_s=float(rng.uniform(5, 40))))
    drones.append(held("north", 0.0, 5.0, 900.0))
    drones.append(held("border", 90.0, 5.0, 900.0))
    return fly(scene([radar(scan=SCANS[name])], drones, seed=61), TURNS * SCANS[name]["period_s"])


def by_drone(looks: FeedTable) -> dict[str, FeedTable]:
    return {name: looks.rows(looks.drone == name) for name in np.unique(looks.drone)}


@EVERY_SCAN
def test_a_look_is_taken_when_the_beam_is_where_the_drone_is(name: str) -> None:
    looks = crossing(name).looks()
    period_ns = round(SCANS[name]["period_s"] * NS)
    off_deg = wrap_180(looks.azimuth_deg - beam_deg(looks.time_utc_ns, period_ns))
    assert np.abs(off_deg).max() < 1e-6
    assert (looks.time_utc_ns // period_ns == looks.scan).all()


@EVERY_SCAN
def test_the_beam_meets_each_drone_once_between_passing_it_and_passing_it_again(name: str) -> None:
    """From look to look the beam gains one turn on the drone, whichever way it flies."""
    period_ns = round(SCANS[name]["period_s"] * NS)
    looks = by_drone(crossing(name).looks())
    assert len(looks) == 82
    crossed_north = set()
    for drone, mine in looks.items():
        flown_deg = np.unwrap(mine.azimuth_deg, period=360)
        ahead_turns = (mine.time_utc_ns - START_NS) / period_ns - flown_deg / 360
        np.testing.assert_allclose(np.diff(ahead_turns), 1, rtol=0, atol=1e-8)
        assert abs(len(mine) - TURNS) <= 1
        if np.any(np.diff(mine.azimuth_deg) > 180):
            crossed_north.add((drone, "counter-clockwise"))
        if np.any(np.diff(mine.azimuth_deg) < -180):
            crossed_north.add((drone, "clockwise"))
    assert {way for _, way in crossed_north} == {"clockwise", "counter-clockwise"}


@EVERY_SCAN
def test_plots_bear_the_time_of_their_look_and_come_in_the_order_of_azimuth(name: str) -> None:
    looks, plots = crossing(name).looks(), crossing(name).plots()
    theirs = plots.rows(plots.drone != "")
    looked = looks.rows(looks.detected)
    np.testing.assert_array_equal(theirs.drone, looked.drone)
    np.testing.assert_array_equal(theirs.time_utc_ns, looked.time_utc_ns)
    np.testing.assert_array_equal(theirs.true_azimuth_deg, looked.azimuth_deg)
    assert (np.diff(plots.time_utc_ns) >= 0).all()
    theirs = theirs.rows(theirs.drone != "north")  # that is at 0 and at 360
    same_scan = np.diff(theirs.scan) == 0
    assert (np.diff(theirs.true_azimuth_deg)[same_scan] > -1e-6).all()


@EVERY_SCAN
def test_a_sectors_plots_leave_at_its_end_before_its_crossing(name: str) -> None:
    """All of one sector before any of the next: plots of 048, then the north marker, 034."""
    sensor = [m for m in crossing(name).messages if m.topic.startswith("plotfeed/radar/asterix")]
    period_ns, sectors = round(SCANS[name]["period_s"] * NS), SCANS[name]["sectors"]
    last = (-1, -1, -1)
    for message in sensor:
        properties = dict(message.properties)
        scan, sector = int(properties["scan"]), int(properties["sector"])
        place = (scan, sector, int(message.topic.endswith("034")))
        assert place >= last
        last = place
        assert message.due_utc_ns == scan * period_ns + -(-(sector + 1) * period_ns // sectors)
    plots = crossing(name).plots()
    into_ns = plots.time_utc_ns - plots.scan * period_ns
    assert (into_ns * sectors // period_ns == plots.sector).all()


@EVERY_SCAN
def test_service_messages_tell_of_every_sector_and_of_north_once_a_turn(name: str) -> None:
    period_s, sectors = SCANS[name]["period_s"], SCANS[name]["sectors"]
    period_ns = round(period_s * NS)
    records = crossing(name).records("radar", 34)
    first_ns = -(-START_NS * sectors // period_ns) * period_ns / sectors  # a sector begins
    seen: list[tuple[Any, ...]] = [
        (r.get("I034/000"), r.get("I034/020"), r.get("I034/041"), r.get("I034/030"))
        for r in records
    ]
    expected: list[tuple[Any, ...]] = []
    for k in range(1, TURNS * sectors + 1):
        end_ns = -(-(round(first_ns * sectors / period_ns) + k) * period_ns // sectors)
        index = end_ns * sectors // period_ns % sectors
        tod_s = np.rint(end_ns * 128 / NS) / 128 % 86_400
        if index == 0:
            expected.append((1, None, np.rint(period_s * 128) / 128, tod_s))
        lsbs = np.rint(index * 256 / sectors) % 256
        expected.append((2, lsbs * 360 / 256, None, tod_s))
    assert seen == expected[: len(seen)]
    assert len(expected) - len(seen) <= 2


@pytest.mark.parametrize("sectors", [39, 161, 256])
def test_the_last_of_any_number_of_sectors_ends_at_north(sectors: int) -> None:
    """Of most of these numbers, so many times their part of 360 is not 360 in floating point."""
    sensor = radar(scan=rotating(1.0, sectors))
    records = fly(scene([sensor], seed=62), 1.0).records("radar", 34)
    kinds = [r.get("I034/000") for r in records]
    assert kinds == [2] * (sectors - 1) + [1, 2]
    assert records[-1].get("I034/020") == 0
    assert records[-2].get("I034/030") == records[-1].get("I034/030")


def test_telemetry_that_comes_late_costs_no_look_and_gives_none_twice() -> None:
    """Where a drone is taken to be jumps to and fro over the beam, which meets it once a turn."""
    rng = np.random.default_rng(64)
    made = scene([radar(scan=rotating(1.0, 32))], seed=64, telemetry={"stale_after_s": 10.0})
    engine, sector_ns = Engine(made, START_NS), NS // 32
    looked: list[tuple[int, int]] = []
    azimuths_deg = rng.uniform(0, 360, 15)
    for step in range(32 * 20):
        for i, azimuth_deg in enumerate(azimuths_deg):
            if (step + i) % 4 == 0:
                place = waypoint(azimuth_deg + rng.normal(0, 1), 5.0, 500.0)
                add_sample(
                    engine.trajectories,
                    f"d{i}",
                    START_NS + step * sector_ns - NS // 100,
                    latitude_deg=place["latitude_deg"],
                    longitude_deg=place["longitude_deg"],
                    height_m=place["height_m"],
                    velocity_enu_m_s=(0.0, 0.0, 0.0),
                    sigma_m=None,
                    signature=Signature(rcs_m2=0.01),
                )
        for batch in engine.until(START_NS + (step + 1) * sector_ns):
            looked.extend((drone, step) for drone in batch.looks.drone.tolist())
    for i in range(len(azimuths_deg)):
        steps = [step for drone, step in looked if drone == i]
        assert len(steps) >= 19
        assert set(np.diff(steps)) <= {31, 32, 33}

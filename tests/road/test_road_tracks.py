"""Sensors that track, from the scene to the bytes: 062 and 063 beside plots, looks and truth."""

from __future__ import annotations

from collections import defaultdict
from functools import cache
from typing import Any

import numpy as np
import pytest
from support.asterix_readers import items_of, read_blocks, values_of
from support.every_kind import MIMO, PASSIVE

from plotfeed.models.frames import geodetic_to_ecef
from plotfeed.proto.asterix.codec.decode import Record
from plotfeed.proto.utc import NS
from plotfeed.testing import (
    SITE,
    START_NS,
    Feed,
    flown,
    fly,
    held,
    radar,
    rotating,
    scene,
    waypoint,
)

TURNS = 120
KNOWN = {"I062/010", "I062/040", "I062/070", "I062/080", "I062/100", "I062/105", "I062/185"}
KNOWN |= {"I062/290", "I062/500"}
WITH_HEIGHT = {"I062/130", "I062/220"}
SENSORS: list[dict[str, Any]] = [
    radar(id="turning", sac=7, sic=1, report=["plots", "asterix-062"], scan=rotating(1.0, 8)),
    radar(id="flat", sac=7, sic=2, report=["asterix-062", "plots"], measures_elevation=False),
    {
        "id": "gate",
        "type": "range_gate",
        "report": ["asterix-062"],
        "scan": {"kind": "staring", "period_s": 0.5},
        "range_max_m": 5000.0,
        "sigma_m": 20.0,
        "position_enu_m": [300.0, -200.0, 10.0],
        "tracks": {"confirm_hits": 1, "confirm_window": 1, "smoothing_scans": 2.0},
    },
]


def drones() -> list[dict[str, Any]]:
    rng = np.random.default_rng(210)
    far = [
        flown(
            f"d{i}",
            *(
                waypoint(rng.uniform(0, 360), rng.uniform(2, 20), rng.uniform(6000, 19_900))
                for _ in range(2)
            ),
            speed_m_s=float(rng.uniform(5, 30)),
        )
        for i in range(30)
    ]
    lands = flown("lands", waypoint(40.0, 5.0, 2000.0), waypoint(45.0, 5.0, 2000.0), repeat=False)
    return [*far, held("still", 0.0, 10.0, 1500.0), lands]


@cache
def road() -> Feed:
    return fly(scene(SENSORS, drones(), seed=211), float(TURNS))


def lives(sensor: str) -> dict[int, list[Record]]:
    of_track = defaultdict(list)
    for record in road().records(sensor, 62):
        of_track[int(record.get("I062/040"))].append(record)
    return of_track


def told(records: list[Record], path: str) -> np.ndarray:
    return np.array([record.get(path) for record in records], dtype=np.float64)


@pytest.mark.parametrize("sensor", ["turning", "flat", "gate"])
def test_records_have_the_items_of_a_track_and_say_simulated(sensor: str) -> None:
    records = road().records(sensor, 62)
    assert len(records) > 250
    expected = KNOWN | (set() if sensor == "flat" else WITH_HEIGHT)
    for record in records:
        assert set(record.items) == expected
        assert record.get("I062/080/SIM") == 1
        assert record.get("I062/080/CST") == (record.get("I062/290/PSR") > 0)


@pytest.mark.parametrize("sensor", ["turning", "flat", "gate"])
def test_every_life_begins_and_goes_on_without_a_hole(sensor: str) -> None:
    last_s = START_NS / NS % 86_400 + TURNS
    for number, records in lives(sensor).items():
        firsts = [record.get("I062/080/TSB") for record in records]
        lasts = [record.get("I062/080/TSE") for record in records]
        assert firsts == [1] + [0] * (len(records) - 1), number
        assert lasts[:-1] == [0] * (len(records) - 1), number
        times_s = told(records, "I062/070")
        assert np.diff(times_s).max(initial=0.0) <= 1.5
        assert lasts[-1] or times_s[-1] >= last_s - 1.5, number


def test_both_positions_are_one() -> None:
    for sensor in ("turning", "gate"):
        records = road().records(sensor, 62)
        feet = told(records, "I062/130")
        enu_m = SITE.from_ecef(
            geodetic_to_ecef(
                told(records, "I062/105/LAT"), told(records, "I062/105/LON"), feet * 0.3048
            )
        )
        east, north = told(records, "I062/100/X"), told(records, "I062/100/Y")
        assert np.abs(enu_m[:, 0] - east).max() < 0.6
        assert np.abs(enu_m[:, 1] - north).max() < 0.6


def test_the_drone_that_landed_is_coasted_and_dropped() -> None:
    for sensor, misses in (("turning", 5), ("flat", 5)):
        ended = [r for r in lives(sensor).values() if r[-1].get("I062/080/TSE")]
        assert ended
        for records in ended:
            assert [r.get("I062/080/CST") for r in records[-misses:]] == [1] * misses


@pytest.mark.parametrize(("sensor", "sic"), [("turning", 1), ("flat", 2)])
def test_the_sensor_says_every_ten_seconds_how_it_does(sensor: str, sic: int) -> None:
    records = road().records(sensor, 63)
    assert len(records) == TURNS // 10
    assert all(r.get("I063/030") % 10 == 0 for r in records)
    for path, value in (("010/SIC", sic), ("050/SIC", sic), ("060/CON", 0)):
        assert {r.get(f"I063/{path}") for r in records} == {value}


def test_asterix_decoder_reads_the_same() -> None:
    for sensor in ("turning", "flat"):
        blocks = road().payloads(f"{sensor}/asterix/062")
        ours = road().records(sensor, 62)
        theirs = [items_of(r) for block in read_blocks(blocks) for r in block]
        assert len(theirs) == len(ours)
        for mine, other in zip(ours, theirs, strict=True):
            assert set(other) == set(mine.items)
            for item in ("I062/040", "I062/070", "I062/100", "I062/105", "I062/185"):
                value = mine.items[item]
                plain = list(value.values()) if isinstance(value, dict) else [value]
                np.testing.assert_allclose(values_of(other[item]), plain, rtol=0, atol=1e-6)


def test_every_sensor_that_may_track_reports_tracks() -> None:
    towers = [
        PASSIVE["transmitters"][0] | {"id": f"tower-{azimuth_deg}",
                                      "place": waypoint(azimuth_deg, 0.5, 11_000.0)}
        for azimuth_deg in (150, 210)
    ]  # fmt: skip
    passive = PASSIVE | {
        "id": "passive", "report": ["asterix-062", "plots"], "transmitters": towers,
        "range_max_m": 15_000.0,
    }  # fmt: skip
    mimo = MIMO | {"id": "mimo", "report": ["asterix-062"]}
    seen = fly(scene([passive, mimo], [held("one", 30.0, 5.0, 2000.0)], seed=213), 60.0)
    assert len({p.drone for p in seen.ledgers[0].looks}) == 1
    for sensor in ("passive", "mimo"):
        records = seen.records(sensor, 62)
        assert len(records) > 20
        assert (set(records[0].items) >= WITH_HEIGHT) == (sensor == "mimo")

"""Sensors that track, from the scene to the bytes: by the truth, and by plots alone."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from support.asterix_readers import items_of, read_blocks, values_of
from support.every_kind import MIMO, PASSIVE, scene_of, seen

from plotfeed.feeds.formats import SceneFormats
from plotfeed.feeds.scene.sensors.sensor_keys import TracksKeys
from plotfeed.models.frames import geodetic_to_ecef
from plotfeed.models.sensors.sensor_model import NO_LOOKS
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
    staring,
    waypoint,
)

# By the truth: 062 and 063 beside plots and looks.


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


# A plain tracker follows drones by plots alone, and errs as trackers do.


PLAIN = {"kind": "plain"}
DURATION_S = 40.0
T0_S = START_NS / NS % 86_400
SCANS = {"turning": rotating(1.0, 8), "staring": staring()}


def sensor(name: str, **more: Any) -> dict[str, Any]:
    floors = {"range_floor_m": 5.0, "azimuth_floor_deg": 0.4, "elevation_floor_deg": 0.4}
    report = ["plots", "asterix-062"]
    base = {"id": name, "report": report, "scan": SCANS[name], "tracks": PLAIN, "pfa": 1e-8}
    return radar(**(base | floors | more))


def straight_on() -> list[dict[str, Any]]:
    """Each flies straight on, in a sector of its own."""
    return [
        flown(f"d{i}", *(waypoint(36.0 * i + 18.0, 10.0, r) for r in (1500.0, 3000.0)))
        for i in range(10)
    ]


@cache
def followed() -> Feed:
    sensors = [sensor("turning", sic=1), sensor("staring", sic=2)]
    return fly(scene(sensors, straight_on(), seed=301), DURATION_S)


@pytest.mark.parametrize("name", SCANS)
def test_it_follows_each_drone_by_one_track_and_better_than_its_plots(name: str) -> None:
    """Beside the nearest drone: all fly straight on at 10 m/s, in ten directions."""
    records = [r for r in followed().records(name, 62) if r.get("I062/070") - T0_S > 15]
    assert len(records) > 200
    assert {record.get("I062/080/SIM") for record in records} == {1}
    assert {int(record.get("I062/040")) for record in records} == set(range(1, 11))
    t_s, east_m, north_m, *sigma_m = (
        np.array([record.get(f"I062/{path}") for record in records])
        for path in ("070", "100/X", "100/Y", "500/APC/X", "500/APC/Y")
    )
    azimuth = np.radians(36.0 * np.arange(10) + 18.0)
    range_m = (1500.0 + 10.0 * (t_s - T0_S)) * np.cos(np.radians(10.0))
    true_m = range_m[:, None, None] * np.stack([np.sin(azimuth), np.cos(azimuth)], axis=-1)
    off_m = np.stack([east_m, north_m], axis=-1)[:, None] - true_m
    off_m = off_m[np.arange(len(off_m)), np.linalg.norm(off_m, axis=2).argmin(axis=1)]
    assert np.abs(off_m.T / sigma_m).mean() < 1.5
    plots = followed().plots(name)
    across_m = plots.range_m * np.radians(plots.azimuth_deg - plots.true_azimuth_deg)
    plot_m = np.hypot(plots.range_m - plots.true_range_m, across_m)
    assert np.hypot(*off_m.T).mean() < 0.9 * np.nanmean(plot_m)


def test_what_it_says_follows_from_plots_and_not_from_whose_they_are() -> None:
    made = scene_of("rotating", 2, ["asterix-062"])
    plain = TracksKeys(kind="plain", confirm_hits=1)
    tracking = tuple(s.model_copy(update={"tracks": plain}) for s in made.sensor)
    made = made.model_copy(update={"sensor": tracking})
    found = seen(made)
    plots = found.plots.but(drone=np.full(len(found.plots), -1))
    nothing = np.zeros_like(found.looks_by)
    others = replace(found, plots=plots, looks=NO_LOOKS, looks_by=nothing, names=["x"])
    mine, theirs = (SceneFormats(made).messages(each) for each in (found, others))
    assert mine == theirs
    assert any("asterix/062" in m.topic for each in mine for m in each)


def test_it_is_deceived_by_false_alarms_misses_what_is_faint_and_loses_it() -> None:
    noisy = sensor("staring", pfa=3e-4, doppler_cells=1, range_max_m=2000.0, report=["asterix-062"])
    deceived = fly(scene([noisy], seed=303), 15.0).records("staring", 62)
    assert any(record.get("I062/080/TSB") for record in deceived)
    faint = sensor("staring", power_w=0.02, report=["asterix-062"])
    lost = fly(scene([faint], straight_on(), seed=304), DURATION_S).records("staring", 62)
    assert any(record.get("I062/080/CST") for record in lost)
    assert any(record.get("I062/080/TSE") for record in lost)

"""A plain tracker on the whole road: it follows drones by plots alone, and errs as trackers do."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from support.every_kind import scene_of, seen

from plotfeed.feeds.formats import SceneFormats
from plotfeed.feeds.scene.sensors.sensor_keys import TracksKeys
from plotfeed.models.sensors.sensor_model import NO_LOOKS
from plotfeed.proto.asterix.codec.decode import Record
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, Feed, flown, fly, radar, rotating, scene, staring, waypoint

PLAIN = {"kind": "plain"}
DURATION_S = 40.0
SCANS = {"turning": rotating(1.0, 8), "staring": staring()}


def sensor(name: str, **more: Any) -> dict[str, Any]:
    floors = {"range_floor_m": 5.0, "azimuth_floor_deg": 0.4, "elevation_floor_deg": 0.4}
    report = ["plots", "asterix-062"]
    base = {"id": name, "report": report, "scan": SCANS[name], "tracks": PLAIN, "pfa": 1e-8}
    return radar(**(base | floors | more))


def drones() -> list[dict[str, Any]]:
    """Each flies straight on, in a sector of its own."""
    return [
        flown(f"d{i}", *(waypoint(36.0 * i + 18.0, 10.0, r) for r in (1500.0, 3000.0)))
        for i in range(10)
    ]


@cache
def road() -> Feed:
    sensors = [sensor("turning", sic=1), sensor("staring", sic=2)]
    return fly(scene(sensors, drones(), seed=301), DURATION_S)


@cache
def true_places() -> tuple[np.ndarray, np.ndarray]:
    """Where drones are every tenth of a second, on paths as straight as these; (k,), (10, k, 2)."""
    t_s = np.arange(0.0, DURATION_S + 1.0, 0.1)
    azimuth = np.radians(36.0 * np.arange(10) + 18.0)
    level = np.cos(np.radians(10.0))
    range_m = (1500.0 + 10.0 * t_s) * level
    return t_s, np.stack(
        [np.outer(np.sin(azimuth), range_m), np.outer(np.cos(azimuth), range_m)], axis=-1
    )


def errors(records: list[Record]) -> tuple[np.ndarray, np.ndarray]:
    """East and north of the nearest drone, over the stated deviations, and in metres; (n, 2)."""
    t_s, places_m = true_places()
    found = []
    for record in records:
        at_s = record.get("I062/070") - START_NS / NS % 86_400
        k = round(at_s * 10)
        here = np.array([record.get("I062/100/X"), record.get("I062/100/Y")])
        off = here - places_m[:, k]
        near = off[np.argmin(np.hypot(*off.T))]
        sigma = np.array([record.get(f"I062/500/APC/{axis}") for axis in "XY"])
        found.append((near / sigma, near))
    assert len(t_s)
    return np.array([f[0] for f in found]), np.array([f[1] for f in found])


@pytest.mark.parametrize("name", SCANS)
def test_it_follows_each_drone_by_one_track_and_better_than_its_plots(name: str) -> None:
    records = road().records(name, 62)
    assert {record.get("I062/080/SIM") for record in records} == {1}
    numbers = {int(record.get("I062/040")) for record in records}
    assert numbers == set(range(1, 11))
    late = [r for r in records if r.get("I062/070") - START_NS / NS % 86_400 > 15]
    assert len(late) > 200
    over_sigma, off_m = errors(late)
    assert np.abs(over_sigma).mean() < 1.5
    plots = road().plots(name)
    plot_m = np.hypot(
        plots.range_m - plots.true_range_m,
        plots.range_m * np.radians(plots.azimuth_deg - plots.true_azimuth_deg),
    )
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
    lost = fly(scene([faint], drones(), seed=304), DURATION_S).records("staring", 62)
    assert any(record.get("I062/080/CST") for record in lost)
    assert any(record.get("I062/080/TSE") for record in lost)

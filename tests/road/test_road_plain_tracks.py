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
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, Feed, flown, fly, radar, rotating, scene, staring, waypoint

PLAIN = {"kind": "plain"}
DURATION_S = 40.0
T0_S = START_NS / NS % 86_400
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


@pytest.mark.parametrize("name", SCANS)
def test_it_follows_each_drone_by_one_track_and_better_than_its_plots(name: str) -> None:
    """Beside the nearest drone: all fly straight on at 10 m/s, in ten directions."""
    records = [r for r in road().records(name, 62) if r.get("I062/070") - T0_S > 15]
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
    plots = road().plots(name)
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
    lost = fly(scene([faint], drones(), seed=304), DURATION_S).records("staring", 62)
    assert any(record.get("I062/080/CST") for record in lost)
    assert any(record.get("I062/080/TSE") for record in lost)

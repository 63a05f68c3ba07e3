"""Whose height is above mean sea level and whose above the ellipsoid, on every wire."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.frames import aer_to_enu, geoid_undulation_m
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.testing import Feed, fly, held, radar, rotating, scene

FOOT_M = 0.3048


def far_off(**more: Any) -> Scene:
    """Drones 100 km off, where sea level is another one than at the radars."""
    drones = [held(f"d{i}", 30.0 * i, 4.0, 100_000.0) for i in range(12)]
    far = {"range_max_m": 200_000.0, "power_w": 1e6, "id": "turning", "scan": rotating(1.0, 8)}
    sensors = [
        radar(sic=1, **far),
        radar(id="staring", sic=2, report=["asterix-015", "plots"], position_enu_m=[9e4, 0, 0]),
    ]
    return scene(sensors, drones, seed=3, **more)


def values(flown: Feed, topic: str, path: str) -> list[float]:
    found = [r.get(path) for p in flown.payloads(topic) for r in decode(p)]
    return [value for value in found if isinstance(value, float)]


@pytest.mark.parametrize("stated_m", [None, 20.0])
def test_heights_of_048_are_above_the_sea_where_the_plot_is(stated_m: float | None) -> None:
    more = {} if stated_m is None else {"telemetry": {"geoid_undulation_m": stated_m}}
    there_is = far_off(**more)
    flown = fly(there_is, 12.0)
    plots = flown.plots("turning")
    here = frame_at(there_is.scene.site, there_is.sensor[0].position_enu_m)
    there = aer_to_enu(plots.azimuth_deg, plots.elevation_deg, plots.range_m)
    level_m = geoid_undulation_m(*here.to_geodetic(there)[:2])
    assert np.ptp(level_m) > 4.0
    if stated_m is not None:
        level_m = np.full_like(level_m, stated_m)
    altitude_m = np.array(values(flown, "turning/asterix/048", "I048/110")) * FOOT_M
    assert len(altitude_m) == len(plots) > 50
    told = np.abs(plots.height_m) < 60e3  # beyond which 048 has no numbers
    off_m = np.abs(altitude_m + level_m - plots.height_m)[told]
    assert len(off_m) > 50
    assert off_m.max() < 12.5 * FOOT_M + 1e-6


def test_the_place_of_025_is_above_the_sea_where_the_sensor_is() -> None:
    there_is = far_off()
    flown = fly(there_is, 12.0)
    here = frame_at(there_is.scene.site, there_is.sensor[1].position_enu_m)
    level_m = geoid_undulation_m(here.latitude_deg, here.longitude_deg)
    said = values(flown, "staring/asterix/025", "I025/610")
    assert said
    assert said == pytest.approx([here.height_m - level_m] * len(said), abs=0.126)

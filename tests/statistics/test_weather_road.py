"""Rain, gases, wind and jammers by time, as looks and detections have them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.hills import write_ridge
from support.radar_equations import mean_snr

from plotfeed.feeds.engine.simulation import SimulatedSensor, simulate
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.frames import aer_to_enu
from plotfeed.proto.errors import PlotfeedError
from plotfeed.testing import START_NS, held, radar, scene

EMITTER = {"frequency_hz": 2.44e9, "bandwidth_hz": 1e6, "eirp_dbm": 20.0}
RADAR = radar(power_w=5e4, frequency_hz=24.15e9)


def drones(n: int = 12) -> list[dict[str, Any]]:
    return [
        held(f"d{i}", 30.0 * i, 3.0, 1500.0 + 400.0 * i, rcs_m2=0.03, sound_power_db=130.0,
             emitters=[EMITTER]) for i in range(n)
    ]  # fmt: skip


def flown(made: Scene, duration_s: float = 20) -> SimulatedSensor:
    return simulate(made, duration_s, start_utc_ns=START_NS)[made.sensor[0].id]


def jammer(azimuth_deg: float, **more: Any) -> dict[str, Any]:
    east_m, north_m, up_m = aer_to_enu(azimuth_deg, 3.0, 4000.0)
    place = {"east_m": float(east_m), "north_m": float(north_m), "above_site_m": float(up_m) + 1.3}
    return {"id": "noisy", "eirp_w": 10.0, "frequency_hz": 24.15e9, "bandwidth_hz": 40e6,
            **place, **more}  # fmt: skip


def test_a_jammer_behind_a_ridge_drowns_nothing(tmp_path: Path) -> None:
    ridge = write_ridge(tmp_path, height_m=1000)
    noisy = jammer(0.0, sidelobe_db=0.0)
    made = scene([RADAR], drones(), seed=8, jammer=[noisy], folder=tmp_path,
                 terrain={"elevation": [ridge]})  # fmt: skip
    free = scene([RADAR], drones(), seed=8, folder=tmp_path, terrain={"elevation": [ridge]})
    np.testing.assert_allclose(flown(made).looks.snr, flown(free).looks.snr, rtol=1e-12)


def test_an_event_of_one_sensor_brings_rain_and_a_jammer_to_it_alone() -> None:
    keys = {k: v for k, v in jammer(90.0, sidelobe_db=0.0).items() if k != "id"}
    event = {"from_s": 5.0, "set": {"weather": {"rain_mm_h": 5.0}, "jamming": {"near": keys}}}
    other = RADAR | {"id": "other"}
    made = scene([RADAR | {"event": [event]}, other], drones(), seed=9)
    found = simulate(made, 12, start_utc_ns=START_NS)
    for name, jammed in (("radar", True), ("other", False)):
        looks = found[name].looks
        later = looks.t_utc_ns > START_NS + 7e9
        left = looks.snr / mean_snr(RADAR, looks.range_m, 0.03)
        assert np.abs(left[~later][:12] - 1).max() < 1e-9
        assert (left[later].max() < 0.1) == jammed


@pytest.mark.parametrize(
    ("tables", "says"),
    [
        ({"weather": [{"rain_mm_h": -1.0}]}, r"weather\[0\]\.rain_mm_h"),
        ({"weather": [{"snow_mm_h": 1.0}]}, r"weather\[0\]\.snow_mm_h.*no such key"),
        ({"weather": [{"rain_mm_h": 1.0, "from_s": 9.0, "to_s": 3.0}]}, "to_s: must be above"),
        ({"jammer": [jammer(0.0, eirp_w=0.0)]}, r"jammer\[0\]\.eirp_w"),
        ({"jammer": [{"id": "x"}]}, r"jammer\[0\]"),
    ],
)
def test_weather_and_jammers_without_sense_are_told_by_their_key(
    tables: dict[str, Any], says: str
) -> None:
    with pytest.raises(PlotfeedError, match=says) as told:
        scene([RADAR], seed=1, **tables)
    assert "event" not in str(told.value)

"""Rain, gases, wind and jammers by time, as looks and detections have them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.every_kind import FAR_SENSORS
from support.hills import write_ridge
from support.radar_equations import LIGHT_M_S, mean_snr, pd
from support.significance import assert_sum

from plotfeed.feeds.engine.simulation import SimulatedSensor, simulate
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.effects.weather import rain_db_per_km
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


def seconds(found: SimulatedSensor) -> Any:
    return (found.looks.t_utc_ns - START_NS) / 1e9


def test_rain_and_gases_weaken_echoes_from_when_they_begin_until_they_end() -> None:
    """At 24.15 GHz: 7.4312043 dB/km both ways for 25 mm/h, by P.838-3."""
    rain = {"rain_mm_h": 25.0, "from_s": 5.0, "to_s": 12.0}
    found = flown(scene([RADAR], drones(), seed=3, weather=[rain]))
    looks, at_s = found.looks, seconds(found)
    lost_db = -10 * np.log10(looks.snr / mean_snr(RADAR, looks.range_m, 0.03))
    rains = (at_s >= 6) & (at_s <= 11)
    np.testing.assert_allclose(lost_db[rains], 7.4312043054 * looks.range_m[rains] / 1e3, rtol=1e-9)
    dry = (at_s < 5) | (at_s > 13)
    assert np.abs(lost_db[dry]).max() < 1e-9
    p = pd(RADAR, looks.range_m, 0.03 * 10 ** (-lost_db / 10))
    np.testing.assert_allclose(looks.pd, p, rtol=1e-9)
    moist = flown(scene([RADAR | {"weather": {"vapour_g_m3": 15.0}}], drones(), seed=3)).looks
    lost_db = -10 * np.log10(moist.snr / mean_snr(RADAR, moist.range_m, 0.03))
    per_km = lost_db / (moist.range_m / 1e3)
    assert 0.6 < per_km.min() * 10 / 10 < per_km.max() < 0.8
    assert np.ptp(per_km) < 1e-9


def test_rain_in_the_cell_drowns_targets_and_detections_are_as_many_as_are_left() -> None:
    weather = {"rain_mm_h": 0.3, "rain_echo": True}
    sensor = radar(frequency_hz=16e9, power_w=2e3) | {"weather": weather}
    many = [held(f"d{i}", 3.0 * i, 3.0, 800.0 + 20.0 * i, rcs_m2=0.1) for i in range(100)]
    found = flown(scene([sensor], many, seed=4))
    looks = found.looks
    wave_m = LIGHT_M_S / 16e9
    back = np.pi**5 * 0.93 * 200 * 0.3**1.6 * 1e-18 / wave_m**4
    beams = np.radians(sensor["azimuth_beamwidth_deg"]) * np.radians(6.0)
    volume_m3 = np.pi / (8 * np.log(2)) * beams * looks.range_m**2 * 10.0
    free = mean_snr(sensor, looks.range_m, 0.1)
    left = 10 ** (-2 * float(rain_db_per_km(16e9, 0.3)) * looks.range_m / 1e4)
    expected = free * left / (1 + free * left * back * volume_m3 / 0.1)
    assert (expected < free * left / 3).all()
    np.testing.assert_allclose(looks.snr, expected, rtol=1e-9)
    p = pd(sensor, looks.range_m, 0.1 * expected / free)
    assert 0.02 < p.mean() < 0.98
    assert_sum(float(looks.detected.sum()), float(p.sum()), float((p * (1 - p)).sum()))


def test_wind_adds_its_noise_to_that_of_microphones() -> None:
    array = FAR_SENSORS["array"] | {"noise_db": 20.0, "frequency_hz": 400.0, "windscreen_m": 0.09}
    calm = flown(scene([array], drones(), seed=5)).looks
    wind = {"wind_m_s": 6.0}
    windy = flown(scene([array], drones(), seed=5, weather=[wind])).looks
    of_wind_db = 40 * np.log10(6) - 23 * np.log10(400 * 0.09 / 6) + 15
    louder_db = 10 * np.log10(10**2.0 + 10 ** (of_wind_db / 10)) - 20.0
    np.testing.assert_allclose(10 * np.log10(calm.snr / windy.snr), louder_db, rtol=1e-9)
    assert louder_db > 3


def jammer(azimuth_deg: float, **more: Any) -> dict[str, Any]:
    east_m, north_m, up_m = aer_to_enu(azimuth_deg, 3.0, 4000.0)
    place = {"east_m": float(east_m), "north_m": float(north_m), "above_site_m": float(up_m) + 1.3}
    return {"id": "noisy", "eirp_w": 10.0, "frequency_hz": 24.15e9, "bandwidth_hz": 40e6,
            **place, **more}  # fmt: skip


def test_a_jammer_drowns_what_is_near_its_direction_while_it_is_on() -> None:
    on = {"from_s": 6.0, "to_s": 14.0, "sidelobe_db": -30.0}
    found = flown(scene([RADAR], drones(), seed=6, jammer=[jammer(90.0, **on)]))
    looks, at_s = found.looks, seconds(found)
    left = looks.snr / mean_snr(RADAR, looks.range_m, 0.03)
    noise_w_hz = 1.380649e-23 * 290 * 10**0.5
    wave_m = LIGHT_M_S / 24.15e9
    range_m = 4000.0
    over = 10.0 / 40e6 * (wave_m / (4 * np.pi * range_m)) ** 2 * 10**3.54 / noise_w_hz
    jammed = (at_s >= 7) & (at_s <= 13)
    at_it = np.abs(looks.azimuth_deg - 90.0) < 0.1
    np.testing.assert_allclose(1 / left[jammed & at_it] - 1, over, rtol=0.02)
    np.testing.assert_allclose(1 / left[jammed & ~at_it] - 1, over / 1000, rtol=0.02)
    assert over > 100
    assert np.abs(left[at_s < 6] - 1).max() < 1e-9
    assert np.abs(left[at_s > 15] - 1).max() < 1e-9


@pytest.mark.parametrize("kind", ["mimo", "passive", "rf"])
def test_other_radios_are_jammed_in_their_bands_alone(kind: str) -> None:
    carrier_hz = {"mimo": 15e9, "passive": 600e6, "rf": 2.44e9}[kind]
    bands = {"in": carrier_hz, "beside": 1.5 * carrier_hz}
    free = flown(scene([FAR_SENSORS[kind]], drones(), seed=7)).looks
    left = {}
    for name, frequency_hz in bands.items():
        noisy = jammer(90.0, frequency_hz=frequency_hz, sidelobe_db=-10.0)
        made = scene([FAR_SENSORS[kind]], drones(), seed=7, jammer=[noisy])
        left[name] = flown(made).looks.snr / free.snr
    assert (left["beside"] == 1).all()
    assert left["in"].max() < 0.5
    if kind != "rf":
        assert left["in"].min() < left["in"].max() / 3


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

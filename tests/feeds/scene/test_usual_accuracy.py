"""Error floors and broadcasts whose values a scene does not state; warnings of what none has."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import every_kind
from support.command import plotfeed_here
from support.every_kind import GATE, MICROPHONES
from support.scene_files import radar as radar_text
from support.scene_files import scene_file, scene_text

from plotfeed.feeds.cli.check import report
from plotfeed.feeds.scene.scene import Scene, SceneError
from plotfeed.feeds.scene.sensors.illuminator_keys import OF_A_KIND, broadcasts
from plotfeed.models.propagation import C_M_S
from plotfeed.testing import radar, scene, waypoint

RADAR = {k: v for k, v in radar().items() if "floor" not in k}
CELLS = ("range_resolution_m", "azimuth_beamwidth_deg", "elevation_beamwidth_deg", "frequency_hz")
MIMO = every_kind.MIMO | {key: RADAR[key] for key in CELLS}
PASSIVE = every_kind.PASSIVE | {
    "azimuth_beamwidth_deg": 4.0, "azimuth_min_deg": 90.0, "azimuth_max_deg": 270.0,
    "transmitters": [
        {"id": name, "erp_w": 1e5, "frequency_hz": 1e8 * n, "bandwidth_hz": 1e6 * n,
         "place": waypoint(10.0 * n, 0.2, 20_000.0)} for n, name in ((2, "dab"), (6, "tv"))
    ],
}  # fmt: skip
RF = {k: v for k, v in every_kind.RF.items() if "floor" not in k}
FLOORS = ("range_floor_m", "azimuth_floor_deg", "elevation_floor_deg")


def illuminated(*transmitters: dict[str, Any]) -> Scene:
    place = {"place": waypoint(90.0, 0.2, 20_000.0)}
    return scene([PASSIVE | {"transmitters": [place | each for each in transmitters]}], seed=1)


@pytest.mark.parametrize("kind", broadcasts())
def test_a_kind_of_broadcast_gives_what_the_scene_does_not(kind: str) -> None:
    (found,) = illuminated({"id": "a", "preset": kind}).sensor[0].illuminators
    told = broadcasts()[kind]
    for key in OF_A_KIND:
        assert getattr(found, key) == told[key]["value"]
        assert told[key]["note"]  # why it is that
    (other,) = illuminated({"id": "a", "preset": kind, "erp_w": 77.0}).sensor[0].illuminators
    assert (other.erp_w, other.frequency_hz) == (77.0, found.frequency_hz)


def test_cells_of_range_are_those_of_the_broadcasts_bandwidth() -> None:
    """The broadcast of the paper's 189 MHz is resolved to 195 m, television to 39 m."""
    made = illuminated(*({"id": kind, "preset": kind} for kind in broadcasts()))
    model: Any = made.sensor[0].model(made.scene.site)
    cells_m = dict(zip(broadcasts(), model.range_resolution_m, strict=True))
    assert cells_m["dab"] == pytest.approx(195.2, abs=0.1)
    assert cells_m["dvb-t"] == pytest.approx(39.4, abs=0.1)
    assert cells_m["gsm"] == pytest.approx(C_M_S / 200e3)
    assert np.rint(C_M_S / model.wavelengths_m[0] / 1e6) == 189


def test_a_kind_that_nobody_has_is_told_with_those_that_there_are() -> None:
    own = {"erp_w": 1.0, "frequency_hz": 1e6, "bandwidth_hz": 1e4}
    with pytest.raises(SceneError) as caught:
        illuminated({"id": "a", "preset": "am"} | own)
    ((key, text),) = caught.value.problems
    assert key == "sensor[0].transmitters[0].preset"
    assert "'dab', 'dvb-t', 'fm' or 'gsm'" in text


def model_of(sensor: dict[str, Any]) -> Any:
    made = scene([sensor], seed=1)
    return made.sensor[0].model(made.scene.site)


def warnings(sensor: dict[str, Any]) -> list[str]:
    made = scene([sensor | {"report": ["plots"]}], [], seed=1)
    found: list[str] = report(made)["sensors"][0]["warnings"]
    return [text for text in found if "emits nothing" not in text]  # nothing flies here


@pytest.mark.parametrize("sensor", [RADAR, MIMO], ids=["active", "mimo"])
def test_radars_err_by_shares_of_their_cells_and_beams(sensor: dict[str, Any]) -> None:
    """A twentieth of 10 m, a tenth of 2 and of 6 degrees; and a twentieth of a Doppler cell."""
    model = model_of(sensor | {"doppler": {}})
    assert [getattr(model, key) for key in FLOORS] == pytest.approx([0.5, 0.2, 0.6])
    cell_m_s = C_M_S / 10e9 / (2 * 0.06)
    assert model.doppler.floors_m_s == pytest.approx((cell_m_s / 20,))
    assert warnings(sensor) == []


def test_a_passive_radar_errs_by_shares_of_each_channels_cells() -> None:
    model = model_of(PASSIVE | {"doppler": {}})
    assert model.range_floors_m == pytest.approx([C_M_S / 2e6 / 20, C_M_S / 6e6 / 20])
    assert model.azimuth_floor_deg == pytest.approx(0.4)
    cells_m_s = [C_M_S / 2e8 / 0.3, C_M_S / 6e8 / 0.3]
    assert model.doppler.floors_m_s == pytest.approx([cell / 20 for cell in cells_m_s])
    assert warnings(PASSIVE) == []
    sigma_m, _ = model.sigmas(np.full(2, np.inf), model.range_resolution_m, model.range_floors_m)
    np.testing.assert_array_equal(sigma_m, model.range_floors_m)


def test_what_a_scene_states_stands_zero_too() -> None:
    model = model_of(RADAR | dict.fromkeys(FLOORS, 0.0) | {"doppler": {"floor_m_s": 0.0}})
    assert [getattr(model, key) for key in FLOORS] == [0, 0, 0]
    assert model.doppler.floors_m_s == (0,)
    model = model_of(PASSIVE | {"bistatic_range_floor_m": 3.0, "azimuth_floor_deg": 0.0})
    assert model.range_floors_m.tolist() == [3, 3]
    assert model.azimuth_floor_deg == 0


@pytest.mark.parametrize(
    ("sensor", "keys", "told"),
    [
        (RADAR, {"range_floor_m": 0.0}, "range_floor_m is 0 m, more accurate .* some 0.5 m"),
        (RADAR, {"azimuth_floor_deg": 0.0}, "azimuth_floor_deg is 0 degrees, more .* 0.2 degrees"),
        (RADAR, {"elevation_floor_deg": 40.0}, "elevation_floor_deg is 40 degrees, more inacc"),
        (RADAR, {"doppler": {"floor_m_s": 0.0}, "doppler_cells": 900}, "doppler.floor_m_s is 0 m"),
        (MIMO, {"range_floor_m": 0.0}, "range_floor_m is 0 m"),
        (PASSIVE, {"bistatic_range_floor_m": 0.0}, "bistatic_range_floor_m is 0 m, .* some 2.5 m"),
        (PASSIVE, {"azimuth_floor_deg": 0.0}, "azimuth_floor_deg is 0 degrees, .* some 0.4 deg"),
        (PASSIVE, {"doppler": {"floor_m_s": 90.0}}, "doppler.floor_m_s is 90 m/s, more inaccurate"),
        (MICROPHONES, {"azimuth_floor_deg": 0.01}, "azimuth_floor_deg is 0.01 .* some 2 degrees"),
        (MICROPHONES, {"elevation_floor_deg": 0.0}, "elevation_floor_deg is 0 .* some 2 degrees"),
        (RF, {"azimuth_floor_deg": 0.0}, "azimuth_floor_deg is 0 degrees, .* some 2 degrees"),
        (GATE, {"sigma_m": 0.0}, "sigma_m is 0 m, more accurate than sensors are"),
    ],
)  # fmt: skip
def test_a_floor_that_is_no_sensors_is_told(
    sensor: dict[str, Any], keys: dict[str, Any], told: str
) -> None:
    assert warnings(sensor) == []
    (text,) = warnings(sensor | keys)
    assert re.match(told, text), text
    if "elevation_floor_deg" in keys and sensor is RADAR:
        assert warnings(sensor | keys | {"measures_elevation": False}) == []


LOW = {"transmitters": [PASSIVE["transmitters"][0] | {"frequency_hz": 200.0}]}  # type: ignore[index]


@pytest.mark.parametrize(
    ("sensor", "keys", "told"),
    [
        (RADAR, {"frequency_hz": 10.0}, "frequency_hz is 10"),
        (MIMO, {"frequency_hz": 1e12}, "frequency_hz is 1e+12"),
        (RF, {"frequency_min_hz": 2.4e3}, "frequency_min_hz is 2400"),
        (PASSIVE, LOW, "frequency_hz of dab is 200"),
    ],
)
def test_a_carrier_in_another_unit_is_told(
    sensor: dict[str, Any], keys: dict[str, Any], told: str
) -> None:
    text = warnings(sensor | keys)[0]
    assert f"{told}: such sensors work from 3e+06 to 3e+11 Hz" in text


def test_a_signal_that_no_receiver_has_is_told(tmp_path: Path) -> None:
    """10 Hz for 10 GHz is 180 dB; a megawatt for a watt is told by the signal alone."""
    for wrong, tells in (("frequency_hz = 10.0", 2), ("power_w = 5e8", 1)):
        right = "frequency_hz = 10e9" if tells == 2 else "power_w = 500.0"
        text = scene_text(sensors=radar_text().replace(right, wrong))
        scene_path = scene_file(tmp_path, text)
        done = plotfeed_here("check", scene_path)
        lines = [line for line in done.stdout.splitlines() if "warning: radar: " in line]
        assert sum("the SNR is " in line and " dB at 1 km" in line for line in lines) == 1, lines
        (sensor,) = json.loads(plotfeed_here("check", scene_path, "--json").stdout)["sensors"]
        assert [f"  warning: radar: {text}" for text in sensor["warnings"]] == lines
        assert sum("another unit" in text for text in sensor["warnings"]) == tells

"""The command on small scenes: table, JSON and pictures."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from support.chart_cases import MIMO, RADAR, method, scene_of
from support.scene_files import scene_file, scene_text

from plotfeed.feeds.cli.main import cli
from plotfeed.feeds.lab.chart import charted
from plotfeed.feeds.lab.chart_command import as_values, lines, print_chart, verdict
from plotfeed.feeds.lab.charted import WORDS, Effort, ns_text, share_text
from plotfeed.feeds.scene.scene import example
from plotfeed.models.sensors.range_gate import RangeGate
from plotfeed.models.sensors.sensor_model import Prediction, Targets
from plotfeed.proto.errors import PlotfeedError

STAGES = {
    "active": {"beam timing", "frames", "propagation", "detection", "errors", "false alarms"},
    "mimo": {"frames", "propagation", "detection", "errors", "false alarms"},
    "passive": {"frames", "propagation", "detection", "errors", "false alarms"},
    "microphone": {"frames", "propagation", "detection", "errors", "false alarms"},
}
RF = {
    "id": "rf", "type": "rf", "scan": {"kind": "staring", "period_s": 1.0},
    "frequency_min_hz": 2.4e9, "frequency_max_hz": 2.5e9, "channel_bandwidth_hz": 1e6,
    "integration_s": 1e-4, "range_max_m": 10_000.0, "baseline_m": 0.2,
}  # fmt: skip
OMNI = {
    "id": "omni", "type": "acoustic", "scan": {"kind": "staring", "period_s": 1.0},
    "noise_db": 0.0, "sensitivity_db": -5.0, "range_max_m": 3000.0, "azimuth_beamwidth_deg": 360.0,
}  # fmt: skip
GATE = {
    "id": "gate", "type": "range_gate", "scan": {"kind": "staring", "period_s": 1.0},
    "range_max_m": 10_000.0, "sigma_m": 5.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def section_4() -> dict[str, Any]:
    return as_values(charted(example("section-4"), Effort.quick(60)))


def sensors(values: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {sensor["id"]: sensor for sensor in values["sensors"]}


def test_every_sensor_has_the_stages_that_it_has(section_4: dict[str, Any]) -> None:
    found = {name: {s["stage"] for s in v["stages"]} for name, v in sensors(section_4).items()}
    assert found == {name: stages | {"encoding"} for name, stages in STAGES.items()}
    assert section_4["unseen"] == []


def test_each_stage_has_the_choice_of_the_scene_and_a_front(section_4: dict[str, Any]) -> None:
    for sensor in section_4["sensors"]:
        for stage in sensor["stages"]:
            methods = stage["methods"]
            ours = [m for m in methods if m["ours"]]
            assert len(ours) == (2 if stage["stage"] == "encoding" else 1)
            cheapest = min(methods, key=lambda m: m["ns"]["median"])
            assert any(m["on_front"] for m in methods)
            assert all(m["ns"]["low"] <= m["ns"]["median"] <= m["ns"]["high"] for m in methods)
            assert cheapest["ns"]["median"] >= 0
            assert {name for m in methods for name in m["errors"]} <= WORDS.keys()


def test_what_the_engine_does_adds_next_to_nothing(section_4: dict[str, Any]) -> None:
    for sensor in section_4["sensors"]:
        for stage in sensor["stages"]:
            for m in stage["methods"]:
                if m["ours"] and stage["stage"] != "encoding":
                    assert m["share"] < 1e-6, (sensor["id"], stage["stage"])


def test_errors_are_those_that_one_expects_of_the_scene(section_4: dict[str, Any]) -> None:
    active = sensors(section_4)["active"]
    # At 20 m/s, uniform over a scan of 1 s: some 20/sqrt(3) m, less across the line of sight.
    late = method(active, "beam timing", "instant of the scan")["errors"]["range_m"]
    assert 5 < late < 20
    # An LSB of 1/256 NM, 7.23 m; its rms error is by sqrt(12) smaller.
    coarse = method(active, "encoding", "asterix-048")["errors"]["range_m"]
    assert coarse == pytest.approx(1852 / 256 / np.sqrt(12), rel=0.3)
    fine = method(active, "encoding", "asterix-015")["errors"]["azimuth_deg"]
    assert fine == pytest.approx(360 / 65536 / np.sqrt(12), rel=0.3)
    assert method(active, "encoding", "plots")["share"] == 0
    flat = method(active, "frames", "flat Earth")["errors"]
    assert 1 < flat["range_m"] < 20
    alarms = method(active, "false alarms", "off")["errors"]["false_alarms"]
    assert alarms == pytest.approx(180 * 995 * 5 * 1e-6)


def test_the_table_says_what_json_has(section_4: dict[str, Any]) -> None:
    text = list(lines(section_4))
    for sensor in section_4["sensors"]:
        assert any(line.startswith(f"\n{sensor['id']} ({sensor['type']})") for line in text)
        for stage in sensor["stages"]:
            for m in stage["methods"]:
                told = (m["method"], ns_text(m["ns"]["median"]), share_text(m["share"]))
                assert any(all(part in line for part in told) for line in text), told
    assert json.loads(json.dumps(section_4)) == section_4


def test_it_ends_with_the_cheapest_that_adds_little(section_4: dict[str, Any]) -> None:
    last = list(lines(section_4))[-len(section_4["sensors"]) :]
    for line, sensor in zip(last, section_4["sensors"], strict=True):
        assert line == verdict(sensor)
        assert line.startswith(f"{sensor['id']}: the cheapest configuration that adds less than")
        assert sensor["configurations"]["cheapest"]["share"] < 0.1


def test_a_verdict_says_when_there_is_nothing_to_gain() -> None:
    scene = {"methods": {"frames": "a"}, "ns": 100.0, "errors": {}, "share": 0.0}
    sensor = {"id": "r", "configurations": {"scene": scene, "cheapest": scene}}
    assert "is what the scene has, 100 ns" in verdict(sensor)
    sensor["configurations"] = {"scene": scene, "cheapest": None}
    assert "no configuration" in verdict(sensor)
    dearer = scene | {"methods": {"frames": "b"}, "ns": 150.0}
    sensor["configurations"] = {"scene": scene, "cheapest": dearer}
    assert "50% more than the scene's 100" in verdict(sensor)
    assert "b in place of a" in verdict(sensor)


def test_any_mix_of_sensors_can_be_charted() -> None:
    emitter = {"frequency_hz": 2.44e9, "bandwidth_hz": 1e6, "eirp_dbm": 20.0}
    path = [{"east_m": e, "north_m": 900.0, "above_site_m": 120.0} for e in (-800.0, 900.0)]
    drone = {"id": "d", "speed_m_s": 10.0, "path": path, "emitters": [emitter]}
    radar, detector = RADAR | {"measures_elevation": False}, RF | {"measures_azimuth": False}
    mixed = (RF, GATE, detector | {"id": "detector"}, OMNI, radar)
    scene = scene_of(*mixed, drones=[drone | {"sound_power_db": 90.0}])
    values = as_values(charted(scene, Effort.quick(30)))
    found = sensors(values)
    assert list(found) == ["rf", "gate", "detector", "omni", "radar"]
    assert {s["stage"] for s in found["gate"]["stages"]} == {"frames", "encoding"}
    assert "elevation_deg" not in found["radar"]["own"]
    assert set(found["rf"]["own"]) == {"azimuth_deg", "pd", "false_alarms"}
    assert set(found["detector"]["own"]) == {"pd", "false_alarms"}
    assert {s["stage"] for s in found["radar"]["stages"]} >= {"errors", "encoding"}


def test_sensors_that_nothing_reaches_leave_the_others_of_a_scene_their_chart() -> None:
    silent = (RF | {"measures_azimuth": False}, OMNI | {"noise_db": 200.0})
    values = as_values(charted(scene_of(*silent, RADAR), Effort.quick(20)))
    assert set(values["unseen"]) == {"rf", "omni"}
    assert list(sensors(values)) == ["radar"]


def test_a_scene_without_drones_is_charted_over_the_sensors_cover() -> None:
    values = as_values(charted(scene_of(RADAR | {"range_max_m": 3000.0}), Effort.quick(30)))
    (radar,) = values["sensors"]
    assert radar["own"]["range_m"] > 0


@pytest.mark.parametrize("kind", ["radar", "mimo", "rf"])
def test_over_a_ground_that_the_scene_names_the_two_rays_are_its_choice(kind: str) -> None:
    ground = {"multipath": {"antenna_height_m": 20.0}}
    emitter = {"frequency_hz": 2.44e9, "bandwidth_hz": 1e6, "eirp_dbm": 0.0}
    path = [{"east_m": e, "north_m": 900.0, "above_site_m": 40.0} for e in (500.0, 6000.0)]
    drone = {"id": "d", "speed_m_s": 10.0, "path": path, "emitters": [emitter]}
    sensor = {"radar": RADAR, "mimo": MIMO, "rf": RF}[kind] | ground
    values = as_values(charted(scene_of(sensor, drones=[drone]), Effort.quick(40)))
    (found,) = values["sensors"]
    two_rays = method(found, "propagation", "two rays, flat ground")
    assert two_rays["ours"]
    assert two_rays["share"] == 0
    free = method(found, "propagation", "free space")
    assert not free["ours"]
    assert free["errors"]["pd"] > 0


def test_drones_that_would_merge_are_charted_each_by_itself() -> None:
    values = as_values(charted(scene_of(RADAR | {"merging": {}}), Effort.quick(40)))
    assert values["sensors"][0]["stages"]


def test_a_format_is_left_out_for_which_a_sensor_measures_too_little() -> None:
    emitter = {"frequency_hz": 2.44e9, "bandwidth_hz": 1e6, "eirp_dbm": 20.0}
    path = [{"east_m": e, "north_m": 900.0, "above_site_m": 120.0} for e in (-800.0, 900.0)]
    drone = {"id": "d", "speed_m_s": 10.0, "path": path, "emitters": [emitter]}
    detector = RF | {"measures_azimuth": False}
    (found,) = as_values(charted(scene_of(detector, drones=[drone]), Effort.quick(30)))["sensors"]
    (encoding,) = (s for s in found["stages"] if s["stage"] == "encoding")
    formats = {m["method"] for m in encoding["methods"]}
    assert "plots" in formats
    assert "asterix-205" not in formats


def test_a_sensor_that_sees_nobody_is_left_out() -> None:
    values = as_values(charted(scene_of(RF, RADAR), Effort.quick(20)))
    assert values["unseen"] == ["rf"]
    assert any("rf: left out" in line for line in lines(values))


@dataclass(frozen=True, kw_only=True)
class Coin(RangeGate):
    """A sensor of which no stage knows more than what every model says of itself."""

    @property
    def false_alarms_per_scan(self) -> float:
        return 4.0

    def predict(self, targets: Targets) -> Prediction:
        return replace(super().predict(targets), pd=np.full(len(targets), 0.5))


def test_a_new_sensor_has_rows_by_what_its_model_says_of_itself() -> None:
    gate = scene_of(GATE).sensor[0]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(gate), "model", lambda *_: Coin(range_max_m=10_000.0, sigma_m=5.0))
        (coin,) = as_values(charted(scene_of(GATE), Effort.quick(30)))["sensors"]
    stages = {s["stage"] for s in coin["stages"]}
    assert stages == {"frames", "detection", "false alarms", "encoding"}
    assert method(coin, "detection", "closed form")["errors"]["pd"] == 0
    assert method(coin, "false alarms", "off")["errors"]["false_alarms"] == 4.0
    assert coin["own"]["false_alarms"] == 2.0


def run(*arguments: object) -> Any:
    return CliRunner().invoke(cli, ["chart", *map(str, arguments)], standalone_mode=False)


def test_the_command_prints_json_and_draws(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text(port=1883))
    done = run(scene, "--quick", "--targets", 20, "--json", "--out", tmp_path / "to")
    assert done.exception is None
    values = json.loads(done.stdout)
    assert values["targets"] == 20
    drawn = {path.name for path in (tmp_path / "to").iterdir()}
    stages = {s["stage"].replace(" ", "-") for s in values["sensors"][0]["stages"]}
    assert drawn == {f"{name}.png" for name in stages | {"batches", "configurations"}}
    assert all(path.stat().st_size > 5000 for path in (tmp_path / "to").iterdir())


def test_wrong_use_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_file(tmp_path, scene_text(port=1883))
    for arguments in (("absent.toml",), (scene, "--targets", 0), (scene, "--picture", "gif")):
        error = run(*arguments).exception
        assert error is not None
        assert len(str(error).splitlines()) == 1
    a_file = tmp_path / "file"
    a_file.touch()
    assert "is a file" in str(run(scene, "--out", a_file).exception)
    without = "import sys; sys.modules['mpmath'] = None; from plotfeed.feeds.cli.main import main"
    command = [sys.executable, "-c", f"{without}; main()", "chart", str(scene)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stderr == "plotfeed: charts need mpmath: pip install 'plotfeed[charts]'\n"
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(PlotfeedError, match=r"plotfeed\[charts\]"):
        print_chart(
            example("section-4"),
            out=tmp_path,
            picture="png",
            targets=10,
            quick=True,
            force=False,
            as_json=False,
        )

"""What one meets on the first day: full disks, interruptions, scenes that are not yet right."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.command import PLOTFEED, plotfeed_here
from support.recordings import plots, written
from support.scene_files import radar, scene_file, scene_text
from support.waiting import PATIENCE_S

from plotfeed.replay.mcap import McapWriter

STARING = """
range_max_m = 5000.0
[sensor.scan]
kind = "staring"
period_s = 1.0
"""
RF = f"""
[[sensor]]
id = "listener"
type = "rf"
measures_azimuth = false
frequency_min_hz = 2.4e9
frequency_max_hz = 2.5e9
channel_bandwidth_hz = 1e6
integration_s = 0.01{STARING}"""
GATE = f'[[sensor]]\nid = "gate"\ntype = "range_gate"\nsigma_m = 0.0{STARING}'
FULL = Path("/dev/full")
SIMULATED = ("--broker", "none", "--speed", "max", "--duration")


def ended(*words: object, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        list(map(str, words)),
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


def test_ctrl_c_while_it_is_imported_is_no_traceback(tmp_path: Path) -> None:
    for module in ("click", "numpy"):
        path = tmp_path / f"{module}.py"
        path.write_text("raise KeyboardInterrupt")
        done = ended(*PLOTFEED, "demo", "--duration", "1", PYTHONPATH=str(tmp_path))
        assert (done.returncode, done.stdout, done.stderr.strip()) == (130, "", "")
        path.unlink()


@pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")
def test_a_full_disk_is_told_with_the_name_of_the_file(tmp_path: Path) -> None:
    source = tmp_path / "in.mcap"
    source.write_bytes(written(McapWriter, plots(3)))
    scene = scene_file(tmp_path, scene_text())
    for words in (
        ("convert", source, FULL, "--to", "jsonl"),
        ("convert", source, FULL, "--to", "mcap"),
        ("run", scene, *SIMULATED, "1", "--json", "--record", FULL, "--force"),
    ):
        done = plotfeed_here(*words)
        assert done.returncode == 1
        assert f"{FULL}: No space left on device" in done.stderr
    with FULL.open("w") as full:
        words = [*PLOTFEED, "schema", "messages"]
        out = subprocess.run(words, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert out.returncode == 1
    assert out.stderr == "plotfeed: standard output: No space left on device\n"


def test_a_disk_that_fills_up_is_told_with_the_name_and_leaves_nothing(tmp_path: Path) -> None:
    source, target = tmp_path / "in.mcap", tmp_path / "out.jsonl"
    source.write_bytes(written(McapWriter, plots(1000)))
    code = (
        "import resource, sys\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))\n"
        "from plotfeed.feeds.cli.main import main\n"
        "main()"
    )
    done = ended(sys.executable, "-c", code, "convert", source, target)
    assert done.returncode == 1
    assert done.stderr == f"plotfeed: {target}: File too large\n"
    assert [path.name for path in tmp_path.iterdir()] == ["in.mcap"]


def test_without_a_broker_no_topic_is_listed(tmp_path: Path) -> None:
    done = plotfeed_here("run", scene_file(tmp_path, scene_text()), *SIMULATED, "1")
    assert "plotfeed/" not in done.stdout
    assert "  MQTT        none, so no topics" in done.stdout


def test_check_says_why_an_rf_sensor_sees_nothing(tmp_path: Path) -> None:
    emitter = "emitters = [{{ frequency_hz = {}, bandwidth_hz = 0, eirp_dbm = 20.0 }}]"
    drone = scene_text().rpartition("[[drone]]")[2]
    for emits, told in (
        ("", "the target emits nothing, so it sees nothing"),
        (emitter.format("5.8e9"), "the target emits nothing from 2400 to 2500 MHz"),
        (emitter.format("2.45e9"), None),
    ):
        text = scene_text(sensors=RF, drones=f"[[drone]]\n{emits}{drone}")
        done = plotfeed_here("check", scene_file(tmp_path, text), "--json")
        (sensor,) = json.loads(done.stdout)["sensors"]
        found = [words for words in sensor["warnings"] if "emits nothing" in words]
        assert len(found) == bool(told)
        assert all(told in words for words in found if told)
        assert bool(told) == (max(row["pd"] for row in sensor["table"]) == 0)


def test_check_as_json_tells_of_a_scene_that_it_refuses(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text().replace("power_w", "powr_w"))
    done = plotfeed_here("check", scene, "--json")
    assert done.returncode == 2
    told = json.loads(done.stdout)
    assert told["file"] == str(scene)
    keys = [("sensor[0].power_w", "radar"), ("sensor[0].powr_w", "radar")]
    assert [(p["key"], p["of"]) for p in told["problems"]] == keys
    assert scene.read_text().split("\n")[told["problems"][1]["line"] - 1] == "powr_w = 500.0"
    absent = plotfeed_here("check", tmp_path / "absent.toml", "--json")
    assert json.loads(absent.stdout)["problems"][0]["what"] == "No such file or directory"
    right = plotfeed_here("check", scene_file(tmp_path, scene_text()), "--json")
    assert json.loads(right.stdout)["problems"] == []


@pytest.mark.parametrize("latitude", ["90.0", "-90.0"])
def test_a_site_at_a_pole_is_checked_and_run(latitude: str, tmp_path: Path) -> None:
    every = radar(more='report = ["asterix-048", "asterix-015", "asterix-062", "plots"]') + GATE
    text = scene_text(sensors=every).replace("latitude_deg = 40.45", f"latitude_deg = {latitude}")
    scene = scene_file(tmp_path, text)
    assert plotfeed_here("check", scene).returncode == 0
    done = plotfeed_here("run", scene, *SIMULATED, "2", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["plots"] > 0


NOT_ENCODED = (
    (
        "height_m = 650.0\n[tel",
        "height_m = 50_000.0\n[tel",
        "scene.site.height_m: 50000 is not within -32768 to 32767, for I034/120/HGT",
    ),
    (
        'id = "radar"',
        'id = "radar"\nposition_enu_m = [0.0, 0.0, 40_000.0]',
        "sensor[0].position_enu_m of 'radar': 40650 is not within -32768 to 32767, for "
        "I034/120/HGT of asterix-048",
    ),
    (
        "longitude_deg = -3.73",
        "longitude_deg = 150.0",
        "scene.site.longitude_deg: 150 is not within -90 to 89.999999",
    ),
    (
        "period_s = 0.5",
        "period_s = 600.0",
        "sensor[0].scan.period_s of 'radar': 600 is not within 0 to 511.9921875, for "
        "I034/041 of asterix-048",
    ),
)


def test_what_no_session_could_encode_check_refuses_by_its_key(tmp_path: Path) -> None:
    sensors = radar(more='report = ["asterix-048", "asterix-015"]')
    text = scene_text(sensors=sensors) + '[asterix]\nlongitude_025 = "half-turn"\n'
    for right, wrong, told in NOT_ENCODED:
        assert right in text
        scene = scene_file(tmp_path, text.replace(right, wrong, 1))
        checked = plotfeed_here("check", scene)
        ran = plotfeed_here("run", scene, *SIMULATED, "1")
        assert (checked.returncode, checked.stderr) == (ran.returncode, ran.stderr)
        assert checked.returncode == 2
        key = wrong.partition(" =")[0] if "position" not in wrong else "position_enu_m"
        lines = enumerate(scene.read_text().split("\n"), 1)
        (line,) = (n for n, each in lines if each.startswith(key))
        assert f"{scene}: line {line}: {told}" in checked.stderr


def test_a_drone_at_the_zenith_has_a_height(tmp_path: Path) -> None:
    drone = """
    [[drone]]
    id = "above"
    speed_m_s = 1.0
    path = [
        { east_m = 0.0, north_m = 0.0, above_site_m = 500.0 },
        { east_m = 0.0, north_m = 0.0, above_site_m = 600.0 },
    ]
    """
    text = scene_text(sensors=GATE, drones=drone, start_utc="2026-01-01T12:00:00Z")
    scene, record = scene_file(tmp_path, text), tmp_path / "record.mcap"
    assert plotfeed_here("run", scene, *SIMULATED, "3", "--record", record).returncode == 0
    listed = plotfeed_here("show", record, "--list").stdout
    assert "elevation_deg 90  height_m 115" in listed


def test_a_chart_without_a_known_suffix_is_refused(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text())
    for name in ("picture", "picture.gif"):
        done = plotfeed_here("check", scene, "--chart", tmp_path / name)
        assert done.returncode == 2
        assert "expected a name that ends in .png, .svg, .pdf" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["scene.toml"]


def test_shells_complete_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    for shell in ("bash", "zsh", "fish"):
        monkeypatch.setenv("COMP_WORDS", "plotfeed re")
        monkeypatch.setenv("COMP_CWORD", "re" if shell == "fish" else "1")
        for how, said in (("source", "plotfeed"), ("complete", "record")):
            monkeypatch.setenv("_PLOTFEED_COMPLETE", f"{shell}_{how}")
            done = plotfeed_here()
            assert said in done.stdout
            assert done.stderr == ""

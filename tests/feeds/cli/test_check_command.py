"""`check`: what a scene's sensors see, and what of it cannot be run."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from support.command import plotfeed_here
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.testing.built_scene import toml_of

SIMULATED = ("--broker", "none", "--speed", "max", "--duration")
STARING = 'range_max_m = 5000.0\n[sensor.scan]\nkind = "staring"\nperiod_s = 1.0\n'
RF = f"""
[[sensor]]
id = "listener"
type = "rf"
measures_azimuth = false
frequency_min_hz = 2.4e9
frequency_max_hz = 2.5e9
channel_bandwidth_hz = 1e6
integration_s = 0.01
{STARING}"""
GATE = f'[[sensor]]\nid = "gate"\ntype = "range_gate"\nsigma_m = 0.0\n{STARING}'


def checked(folder: Path, text: str, *options: object) -> dict[str, Any]:
    """What is told of a scene as JSON."""
    done = plotfeed_here("check", scene_file(folder, text), "--json", *options)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_it_tells_pd_and_errors_against_range(tmp_path: Path) -> None:
    text = plotfeed_here("check", scene_file(tmp_path, scene_text()))
    assert text.returncode == 0
    assert "radar (active_radar, SAC 0 SIC 1)" in text.stdout
    found = checked(tmp_path, scene_text())
    assert (found["scene"], found["drones"], found["problems"]) == ("test", 1, [])
    (sensor,) = found["sensors"]
    pds = [row["pd"] for row in sensor["table"]]
    assert all(0 <= pd <= 1 for pd in pds)
    bigger = checked(tmp_path, scene_text(), "--rcs-m2", "1.0")
    assert bigger["sensors"][0]["table"][-1]["pd"] > pds[-1]
    near = radar().replace("range_max_m = 10_000.0", "range_max_m = 2500.0")
    rows = checked(tmp_path, scene_text(sensors=near))["sensors"][0]["table"]
    # The range of a row is that to the drone at its height, not along the ground.
    levels_db = [row["snr_db"] + 40 * math.log10(row["range_m"]) for row in rows]
    assert levels_db == pytest.approx([levels_db[-1]] * len(rows))


# Eight beams of 2 degrees, a turn in half a second: 22.2 ms on a target.
@pytest.mark.parametrize(
    ("beams", "told"), [(8, None), (7, "for 0.0194 s of a turn"), (1, "for 0.00278 s of a turn")]
)
def test_it_tells_where_a_beam_has_less_time_than_it_needs(
    beams: int, told: str | None, tmp_path: Path
) -> None:
    sensor = radar(more=f"receive_beams = {beams}")
    sensor = sensor.replace("integration_s = 0.01", "integration_s = 0.022")
    done = plotfeed_here("check", scene_file(tmp_path, scene_text(sensors=sensor)))
    assert ("integration_s is 0.022, but the beam is on a target" in done.stdout) == bool(told)
    assert told is None or told in done.stdout


HINT = "give drones [[drone.emitters]]; those of telemetry bring theirs"
EMITTER = "emitters = [{{ frequency_hz = {}, bandwidth_hz = 0, eirp_dbm = 20.0 }}]"


@pytest.mark.parametrize(
    ("emits", "told"),
    [
        ("", [f"the target emits nothing, so it sees nothing: {HINT}"]),
        (
            EMITTER.format("5.8e9"),
            ["the target emits nothing from 2400 to 2500 MHz, so it sees nothing"],
        ),
        (EMITTER.format("2.45e9"), []),
    ],
)
def test_it_says_why_an_rf_sensor_sees_nothing(emits: str, told: list[str], tmp_path: Path) -> None:
    drone = f"[[drone]]\n{emits}{scene_text().rpartition('[[drone]]')[2]}"
    (sensor,) = checked(tmp_path, scene_text(sensors=RF, drones=drone))["sensors"]
    assert [words for words in sensor["warnings"] if "emits nothing" in words] == told
    assert bool(told) == (max(row["pd"] for row in sensor["table"]) == 0)


def test_a_scene_that_it_refuses_has_its_lines_and_keys_named(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text().replace("power_w", "powr_w"))
    text = scene.read_text().split("\n")
    table, key = text.index("[[sensor]]") + 1, text.index("powr_w = 500.0") + 1
    for verb in ("run", "check"):
        done = plotfeed_here(verb, scene)
        assert (done.returncode, done.stdout) == (2, "")
        assert done.stderr.splitlines() == [
            f"plotfeed: {scene}: line {table}: sensor[0].power_w of 'radar': missing",
            f"plotfeed: {scene}: line {key}: sensor[0].powr_w of 'radar': no such key; "
            "did you mean power_w?",
        ]
    done = plotfeed_here("check", scene, "--json")
    assert done.returncode == 2
    told = json.loads(done.stdout)
    assert told["file"] == str(scene)
    problems = [(each["key"], each["of"], each["line"]) for each in told["problems"]]
    missing, unknown = ("sensor[0].power_w", "radar", table), ("sensor[0].powr_w", "radar", key)
    assert problems == [missing, unknown]
    absent = plotfeed_here("check", tmp_path / "absent.toml", "--json")
    assert json.loads(absent.stdout)["problems"][0]["what"] == "No such file or directory"


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


@pytest.mark.parametrize(("right", "wrong", "told"), NOT_ENCODED)
def test_what_no_session_could_encode_is_refused_by_its_key(
    right: str, wrong: str, told: str, tmp_path: Path
) -> None:
    sensors = radar(more='report = ["asterix-048", "asterix-015"]')
    text = scene_text(sensors=sensors) + '[asterix]\nlongitude_025 = "half-turn"\n'
    assert right in text
    scene = scene_file(tmp_path, text.replace(right, wrong, 1))
    done = plotfeed_here("check", scene)
    ran = plotfeed_here("run", scene, *SIMULATED, "1")
    assert (done.returncode, done.stderr) == (ran.returncode, ran.stderr)
    assert done.returncode == 2
    key = wrong.partition(" =")[0] if "position" not in wrong else "position_enu_m"
    lines = enumerate(scene.read_text().split("\n"), 1)
    (line,) = (n for n, each in lines if each.startswith(key))
    assert f"{scene}: line {line}: {told}" in done.stderr


@pytest.mark.parametrize("latitude", ["90.0", "-90.0"])
def test_a_site_at_a_pole_is_checked_and_run(latitude: str, tmp_path: Path) -> None:
    every = radar(more='report = ["asterix-048", "asterix-015", "asterix-062", "plots"]') + GATE
    text = scene_text(sensors=every).replace("latitude_deg = 40.45", f"latitude_deg = {latitude}")
    scene = scene_file(tmp_path, text)
    assert plotfeed_here("check", scene).returncode == 0
    done = plotfeed_here("run", scene, *SIMULATED, "2", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["plots"] > 0


def test_a_drone_at_the_zenith_has_a_height(tmp_path: Path) -> None:
    path = [{"east_m": 0.0, "north_m": 0.0, "above_site_m": float(up)} for up in (500, 600)]
    drone = f"[[drone]]\n{toml_of({'id': 'above', 'speed_m_s': 1.0, 'path': path})}"
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

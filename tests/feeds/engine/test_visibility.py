"""What is foretold of who sees whom is what a session then looks at, and with what Pd."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.command import plotfeed_here
from support.hills import write_ridge
from support.random_scenes import random_tree
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.engine.emulated_sensors import EmulatedSensors
from plotfeed.feeds.engine.scene_drones import launch, trajectories_of
from plotfeed.feeds.engine.simulation import simulate
from plotfeed.feeds.engine.visibility import SEEN_PD, Outlook, Sightline
from plotfeed.feeds.scene.scene import Scene, from_tree, load
from plotfeed.feeds.testing.built_scene import toml_of
from plotfeed.testing import START_NS, staring
from plotfeed.testing import scene as built

SECONDS = 8.0
# Hindrances of what no sensor looks at.
WITHIN = {"range", "elevation", "direction", "nothing to sense", "off"}
OF_PAIRS = {"acoustic_pair", "multistatic_passive", "multistatic_mimo"}
EMITTER = {"frequency_hz": 2.44e9, "bandwidth_hz": 10e6, "eirp_dbm": 20.0}


def looks_by_itself(sensor: dict[str, Any]) -> bool:
    """Whether each of its looks alone makes a plot, wherever others point it."""
    return "mount" not in sensor and sensor.get("type") not in {None, *OF_PAIRS}


def outlook_of(scene: Scene) -> Outlook:
    trajectories = trajectories_of(scene)
    launch(scene, trajectories, START_NS)
    return Outlook(scene, EmulatedSensors(scene, trajectories), trajectories, START_NS)


def standing(name: str, *at_m: float, **keys: Any) -> dict[str, Any]:
    """A drone that all but hovers."""
    east_m, north_m, above_m = at_m
    place = {"north_m": north_m, "above_site_m": above_m}
    path = [{"east_m": east_m, **place}, {"east_m": east_m + 0.1, **place}]
    return {"id": name, "speed_m_s": 0.01, "rcs_m2": 0.05, "path": path, **keys}


def anywhere(seed: int) -> list[dict[str, Any]]:
    """Drones all around, near and far, low and high, some of which emit and sound."""
    rng = np.random.default_rng(seed)
    drones = []
    for n in range(24):
        angle, range_m = rng.uniform(0, 2 * np.pi), 10 ** rng.uniform(1.5, 4.5)
        at = range_m * np.sin(angle), range_m * np.cos(angle), 10 ** rng.uniform(1, 4)
        heard = {"sound_power_db": 105.0, "emitters": [EMITTER]} if n % 2 else {}
        drones.append(standing(f"drone-{n}", *at, **heard))
    return drones


@pytest.mark.parametrize("seed", range(8))
def test_what_is_foretold_is_what_is_looked_at(seed: int) -> None:
    """Sensors of all kinds and effects; a drone that one looks at has the Pd that was foretold."""
    tree = random_tree(seed)
    tree = {key: tree[key] for key in ("scene", "telemetry")} | {
        "sensor": [s for s in tree["sensor"] if looks_by_itself(s)],
        "drone": anywhere(seed),
    }
    for sensor in tree["sensor"]:
        sensor.pop("event", None)
    if not tree["sensor"]:
        return
    scene = from_tree(tree, Path("scene.toml"))
    ran = simulate(scene, SECONDS, start_utc_ns=START_NS)
    compared = 0
    for line in outlook_of(scene).sightlines(scene.fleet.names):
        looks = ran[line.sensor].looks
        mine = looks.drone == ran.drones.index(line.drone)
        if line.hindrance is not None and line.hindrance.kind in WITHIN:
            assert not mine.any(), line
            continue
        assert mine.any(), line
        missed: defaultdict[int, float] = defaultdict(lambda: 1.0)
        for scan, pd in zip(looks.scan[mine].tolist(), looks.pd[mine].tolist(), strict=True):
            missed[scan] *= 1 - pd
        pds = [1 - chance for chance in missed.values()]
        if line.hindrance is not None:
            assert max(pds) < SEEN_PD, line
        else:
            assert line.pd[0] * 0.98 <= min(pds) <= max(pds) <= line.pd[1] * 1.02, line
        compared += 1
    assert compared > 1


def tables(drones: Iterable[dict[str, Any]]) -> str:
    return "".join(f"[[drone]]\n{toml_of(drone)}" for drone in drones)


def sightlines(folder: Path, *drones: dict[str, Any], sensors: str, **more: str) -> list[Sightline]:
    text = scene_text(sensors=sensors, drones=tables(drones), **more)
    scene = load(scene_file(folder, text))
    return list(outlook_of(scene).sightlines(scene.fleet.names))


CAMERA = {
    "id": "eye", "type": "camera", "scan": staring(), "range_max_m": 3000.0, "pan_deg": 90.0,
    "horizontal_fov_deg": 60.0, "tilt_deg": 10.0, "pixels_across": 6000, "pixels_down": 4000,
}  # fmt: skip
EYE = f"[[sensor]]\n{toml_of(CAMERA)}"


@pytest.mark.parametrize(
    ("drone", "sensors", "kind", "text"),
    [
        (standing("d", 0, 0, 300), radar(), "elevation", "90° high at best, it looks"),
        (standing("d", 500e3, 0, 9e3), radar(), "range", "499 km away at its nearest, it"),
        (standing("d", 0, 1000, -800), radar(), "elevation", "-39° high at best"),
        (standing("d", 0, 1000, 100), radar(more="enabled = false"), "off", "it is off"),
        (standing("d", 0, 1000, 100), radar(more="range_min_m = 2e3"), "range", "from 2 km on"),
        (standing("d", 0, 1000, 100), EYE, "direction", "it looks from 60° to 120°"),
        (standing("d", 0, 9000, 100, rcs_m2=1e-9), radar(), "too weak", "at best, 9 km away"),
    ],
    ids=lambda value: value if isinstance(value, str) and "\n" not in value else "",
)
def test_why_a_sensor_does_not_see_a_drone(
    drone: dict[str, Any], sensors: str, kind: str, text: str, tmp_path: Path
) -> None:
    (line,) = sightlines(tmp_path, drone, sensors=sensors)
    assert line.hindrance is not None
    assert (line.hindrance.kind, line.spans_s) == (kind, ())
    assert text in line.hindrance.text


def test_hills_hide_and_the_ground_covers(tmp_path: Path) -> None:
    write_ridge(tmp_path, height_m=900)
    terrain = '[terrain]\nelevation = ["N40W004.hgt"]\n'
    hidden, below = standing("hidden", 0, 8000, 50), standing("below", 0, 8000, -300)
    lines = sightlines(tmp_path, hidden, below, sensors=terrain + radar())
    assert [line.hindrance and line.hindrance.kind for line in lines] == ["horizon", "ground"]


def test_from_when_to_when_goes_by_flight_and_events(tmp_path: Path) -> None:
    """In at 10 km after 400 of 800 s; the radar is off from 500 s to 600 s."""
    way = [{"east_m": 0.0, "north_m": m, "above_site_m": 100.0} for m in (18_000.0, 2000.0)]
    drone = standing("d", 0, 0, 0) | {"speed_m_s": 20.0, "path": way, "rcs_m2": 1.0}
    off = "[[sensor.event]]\nfrom_s = 500.0\nto_s = 600.0\nset = { enabled = false }\n"
    (line,) = sightlines(tmp_path, drone, sensors=radar() + off)
    step_s = 800 / 63
    (begins_s, until_s), (again_s, ends_s) = line.spans_s
    assert 400 <= begins_s <= 400 + step_s
    assert 500 - step_s <= until_s <= 500
    assert 600 <= again_s <= 600 + step_s
    assert ends_s == pytest.approx(800, abs=0.1)
    assert 0.5 < line.pd[0] < line.pd[1] <= 1.0


PLACES = {"overhead": (0, 0, 300), "far": (500e3, 0, 300), "mole": (0, 1000, -800)}
UNSEEN = [standing(name, *at_m) for name, at_m in (PLACES | {"seen": (0, 1000, 100)}).items()]


def test_check_and_run_say_who_sees_whom_and_why_not(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text(drones=tables(UNSEEN)))
    found = json.loads(plotfeed_here("check", scene, "--json").stdout)
    told = {each["drone"]: each for each in found["visibility"]["drones"]}
    assert found["visibility"]["pd_at_least"] == SEEN_PD
    assert {drone: [w["why"] for w in of["not_seen_by"]] for drone, of in told.items()} == {
        "overhead": ["elevation"],
        "far": ["range"],
        "mole": ["elevation"],
        "seen": [],
    }
    (seen,) = told["seen"]["seen_by"]
    assert (seen["sensor"], seen["if_turned"]) == ("radar", False)
    assert seen["spans_s"] == [[0.0, pytest.approx(10.0, abs=0.001)]]
    assert 0.9 < seen["pd_min"] <= seen["pd_max"] <= 1.0
    text = plotfeed_here("check", scene).stdout
    assert "far, from 0 to 10 s: no sensor sees it" in text
    assert "    radar: not, range: 499 km away at its nearest, it sees to 10 km" in text
    assert "warning: drone 'mole' is 800 m below the site at its lowest, and no [terrain]" in text
    options = ("--broker", "none", "--speed", "max", "--duration", 1, "--json")
    done = plotfeed_here("run", scene, *options)
    (line,) = [line for line in done.stderr.splitlines() if "no sensor sees" in line]
    assert line.startswith("plotfeed: no sensor sees overhead (radar: 90° high at best")
    assert "far (radar: 499 km away at its nearest" in line
    assert "seen (" not in line
    assert list(json.loads(done.stdout)["unseen"]) == ["overhead", "far", "mole"]
    assert plotfeed_here("run", scene_file(tmp_path, scene_text()), *options).stderr == ""


def test_of_many_drones_all_are_asked_after_and_some_explained() -> None:
    """200 sensors and 600 drones, of which 100 are out of reach of all."""
    gate = {"type": "range_gate", "sigma_m": 0.0, "range_max_m": 2000.0, "scan": staring()}
    sensors = [
        gate | {"id": f"gate-{n}", "position_enu_m": [n * 300.0, 0.0, 0.0]} for n in range(200)
    ]
    near = [standing(f"near-{n}", n * 100.0, 500.0, 100.0) for n in range(500)]
    far = [standing(f"far-{n}", n * 100.0, 5000.0, 100.0) for n in range(100)]
    outlook = outlook_of(built(sensors, [*near, *far], seed=1))
    unseen = outlook.unseen()
    assert list(unseen) == [drone["id"] for drone in far]
    assert "4.6 km away" in unseen["far-0"] or "5 km away" in unseen["far-0"]
    assert len(outlook.drones) <= 40

"""What a scene needs is told right where it is known by hand, and by the same random numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from support.command import plotfeed_here
from support.every_kind import EMITTER, RF

from plotfeed.feeds.lab.needs import (
    METRICS,
    Finding,
    Needs,
    Run,
    Variant,
    choices_of,
    on_front,
    rewritten,
    variants_of,
)
from plotfeed.feeds.lab.oracle import rain_db_km
from plotfeed.feeds.scene.scene import Scene, example, from_tree, parsed
from plotfeed.feeds.testing.built_scene import toml_of
from plotfeed.proto.errors import PlotfeedError
from plotfeed.testing import flown, held, radar, staring, waypoint

START_NS = 1_767_268_800 * 10**9
# Of which one in 20 may be wrong: four are in one test of 970.
EXPERIMENTS, MOST_WRONG = 10, 3
SITE = {"latitude_deg": 40.45, "longitude_deg": -3.73, "height_m": 650.0}


def tree(*, drones: int = 12, **keys: Any) -> dict[str, Any]:
    """A radar that finds nearly every drone in every scan."""
    sensor = radar(
        scan=staring(), report=["plots"], pfa=1e-8, **{"power_w": 5e4, "frequency_hz": 10e9, **keys}
    )
    if not drones:  # but those that stand 3 km away
        where = [held(f"d{i}", 30.0 * i, 8.0, 3000.0) for i in range(12)]
        return {
            "scene": {"name": "known", "seed": 1, "site": SITE},
            "sensor": [sensor],
            "drone": where,
        }
    rng = np.random.default_rng(3)
    paths = [
        [waypoint(float(a), 8.0, float(r)) for a, r in zip(*pair, strict=True)]
        for pair in zip(rng.uniform(0, 360, (drones, 2)), rng.uniform(1500, 4000, (drones, 2)),
                        strict=True)
    ]  # fmt: skip
    return {
        "scene": {"name": "known", "seed": 1, "site": SITE},
        "sensor": [sensor],
        "drone": [flown(f"d{i}", *places) for i, places in enumerate(paths)],
    }


def scene_with(**keys: Any) -> Scene:
    made = tree(**keys)
    return from_tree(made, Path("known.toml"), toml_of(made))


def bearings_with(**keys: Any) -> Scene:
    """A direction finder that hears every drone, and gives no places: no tracker has to run."""
    made = tree(drones=40)
    made["sensor"] = [RF | {"report": ["plots"], **keys}]
    for drone in made["drone"]:
        drone["emitters"] = [EMITTER]
    return from_tree(made, Path("known.toml"), toml_of(made))


def found(scene: Scene, variants: list[Variant], seed: int = 1, **how: Any) -> list[Finding]:
    asked = {"matters": 0.02, "runs": 8, "duration_s": 10.0, **how}
    return list(Needs(scene, variants, seed=seed, start_utc_ns=START_NS, **asked).findings)


def only(scene: Scene, name: str) -> list[Variant]:
    return [each for each in variants_of(scene) if each.name == name]


def verdicts(pd_factor: float, **how: Any) -> list[str]:
    scene = bearings_with(degradation={"pd_factor": pd_factor})
    variants = only(scene, "without degradation")
    seeds = range(1, 1000 * EXPERIMENTS, 1000)
    return [found(scene, variants, seed, **how)[0].verdict for seed in seeds]


def test_what_takes_two_fifths_of_all_detections_is_needed() -> None:
    assert sum(each != "needed" for each in verdicts(0.6, runs=4)) <= MOST_WRONG


def test_what_takes_one_percent_can_go_where_two_matter() -> None:
    assert sum(each != "can go" for each in verdicts(0.99)) <= MOST_WRONG


def test_what_changes_nothing_can_go_at_once() -> None:
    scene = scene_with(degradation={"error_factor": 1.0})
    (told,) = found(scene, only(scene, "without degradation"), runs=4)
    assert told.verdict == "can go"
    assert all(c.value == c.low == c.high == 0 for c in told.changes)


def test_rain_takes_what_the_radar_equation_says() -> None:
    """Drones that stand 3 km away behind 12 dB of rain are found as with a 16th of the power."""

    def excess_db(rain_mm_h: float) -> float:
        return 6.0 * float(rain_db_km(np.array(10e9), rain_mm_h, "horizontal")) - 12.0

    weather = {"rain_mm_h": brentq(excess_db, 1.0, 300.0)}
    wet = scene_with(weather=weather, power_w=2000.0, drones=0)
    weak = scene_with(power_w=2000.0 / 10**1.2, drones=0)
    seen = [Run(Variant(name="", scene=s, sensors=frozenset([0])), 1, START_NS, 60.0)
            for s in (wet, weak)]  # fmt: skip
    assert seen[0].figures[0, 0] == pytest.approx(seen[1].figures[0, 0], abs=0.03)
    (told,) = found(wet, only(wet, "without weather"))
    assert told.verdict == "needed"


def test_both_sides_draw_the_same_numbers() -> None:
    """Else the variance of a difference would be twice that of one side, not a tenth of it."""
    scene = scene_with(power_w=5.0, degradation={"pd_factor": 0.95})
    (variant,) = only(scene, "without degradation")
    base = Variant(name="", scene=scene, sensors=frozenset([0]))
    one, other = (
        np.array([Run(each, seed, START_NS, 10.0).figures[0, 0] for seed in range(1, 25)])
        for each in (base, variant)
    )
    assert 0.2 < one.mean() < 0.8
    assert np.var(other - one) < 0.5 * np.var(one)


def test_a_format_that_is_coarse_shows_its_steps() -> None:
    scene = scene_with(range_floor_m=0.1, range_resolution_m=0.5)
    (variant,) = [each for each in choices_of(scene) if each.read_back == "asterix-048"]
    base = Variant(name="", scene=scene, sensors=frozenset([0]))
    column = list(METRICS).index("range_m")
    fine, coarse = (Run(v, 1, START_NS, 10.0).figures[0, column] for v in (base, variant))
    step_m = 1852 / 256
    assert coarse == pytest.approx(np.hypot(fine, step_m / np.sqrt(12)), rel=0.15)


def test_the_front_is_what_nothing_beats() -> None:
    costs, sizes = np.array([3.0, 1.0, 2.0, 2.0]), np.array([0.0, 5.0, 4.0, 6.0])
    assert on_front(costs, sizes).tolist() == [1, 2, 0]


@pytest.mark.parametrize("name", ["section-4", "field-day"])
def test_a_lean_scene_loads_and_has_lost_what_can_go(name: str) -> None:
    scene = example(name)
    told = Needs(
        scene, [v for v in variants_of(scene) if len(v.effects) == 1], matters=0.02, runs=2,
        duration_s=2.0, seed=1, start_utc_ns=START_NS,
    )  # fmt: skip
    for verdict in ("can go", "missing"):
        other = parsed(rewritten(scene, told, verdict).encode(), scene.folder / "other.toml")
        left = {each.name for each in variants_of(other)}
        gone = [each.variant for each in told.findings if each.verdict == verdict]
        for each in gone:
            (effect,) = each.effects
            of_presets = all(effect not in sensor for sensor in written(scene))
            assert of_presets or each.name not in left or verdict == "missing"
            if verdict == "missing":
                assert f"without {effect}" in left


def written(scene: Scene) -> list[set[str]]:
    import tomllib

    return [set(sensor) for sensor in tomllib.loads(scene.text).get("sensor", [])]


def test_runs_that_end_before_the_first_scan_decide_nothing() -> None:
    scene = scene_with(degradation={"pd_factor": 0.5})
    (told,) = found(scene, only(scene, "without degradation"), runs=2, duration_s=0.1)
    assert (told.verdict, told.largest) == ("undecided", None)


def test_a_scene_without_drones_of_its_own_is_told_so() -> None:
    made = tree()
    del made["drone"]
    scene = from_tree(made, Path("known.toml"))
    with pytest.raises(PlotfeedError, match="flies no drones"):
        found(scene, variants_of(scene))


def test_the_commands_say_it_in_groups_and_draw_it(tmp_path: Path) -> None:
    path = tmp_path / "here.toml"
    path.write_text(toml_of(tree(degradation={"pd_factor": 0.5})))
    how = ["--runs", "4", "--duration", "5"]
    said = plotfeed_here(
        "needs", path, *how, "--chart", tmp_path / "n.png", "--lean", tmp_path / "l"
    )
    assert "Needed: without it, a tracker would notice" in said.stdout
    assert "without degradation" in said.stdout
    assert (tmp_path / "n.png").read_bytes().startswith(b"\x89PNG")
    assert "degradation" in (tmp_path / "l").read_text()
    said = plotfeed_here("chart", path, *how)
    assert "asterix-048 alone" in said.stdout
    assert "Choices; * is on the front" in said.stdout


@pytest.mark.parametrize("share", ["0", "100%", "much", "-1%"])
def test_a_share_that_is_none_is_refused_in_a_line(tmp_path: Path, share: str) -> None:
    path = tmp_path / "here.toml"
    path.write_text(toml_of(tree()))
    said = plotfeed_here("needs", path, "--matters", share)
    assert said.returncode == 2
    assert said.stderr.startswith("plotfeed: --matters: expected a share such as 2% or 0.02")

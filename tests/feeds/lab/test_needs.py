"""What a scene needs is told right where it is known by hand, and by the same random numbers."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.command import plotfeed_here, refusal
from support.doc_commands import DOCS, doc_command

from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.engine.ordinary_world import WORLD_KEYS
from plotfeed.feeds.lab import needs
from plotfeed.feeds.lab.needs import (
    FIRST_RUNS,
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
from plotfeed.feeds.scene.examples import summaries
from plotfeed.feeds.scene.scene import Scene, example, from_tree, load, parsed
from plotfeed.feeds.testing.built_scene import toml_of
from plotfeed.proto.errors import PlotfeedError
from plotfeed.testing import flown, radar, staring, waypoint

START_NS = 1_767_268_800 * 10**9
# Of which one in 20 may be wrong: three are in one test of 450.
EXPERIMENTS, MOST_WRONG = 6, 2
KNOWN = doc_command("needs_known")
SITE = {"latitude_deg": 40.45, "longitude_deg": -3.73, "height_m": 650.0}


def tree(*, drones: int = 12, **keys: Any) -> dict[str, Any]:
    """A radar that finds nearly every drone in every scan."""
    sensor = radar(
        scan=staring(), report=["plots"], pfa=1e-8, **{"power_w": 5e4, "frequency_hz": 10e9, **keys}
    )
    rng = np.random.default_rng(3)
    ends = rng.uniform(0, 360, (drones, 2)), rng.uniform(1500, 4000, (drones, 2))
    drawn = zip(*(end.tolist() for end in ends), strict=True)
    return {
        "scene": {"name": "known", "seed": 1, "site": SITE},
        "sensor": [sensor],
        "drone": [
            flown(f"d{i}", waypoint(a0, 8.0, r0), waypoint(a1, 8.0, r1))
            for i, ((a0, a1), (r0, r1)) in enumerate(drawn)
        ],
    }


def made_of(tree: dict[str, Any]) -> Scene:
    return from_tree(tree, Path("known.toml"), toml_of(tree))


def scene_with(**keys: Any) -> Scene:
    return made_of(tree(**keys))


def needs_of(scene: Scene, variants: list[Variant], **how: Any) -> Needs:
    asked = {"matters": 0.02, "runs": 8, "duration_s": 10.0, "seed": 1, **how}
    return Needs(scene, variants, start_utc_ns=START_NS, **asked)


def only(scene: Scene, name: str) -> list[Variant]:
    return [each for each in variants_of(scene) if each.name == name]


def finding(scene: Scene, name: str, **how: Any) -> Finding:
    """Of the one variant of that name."""
    (told,) = needs_of(scene, only(scene, name), **how).findings
    return told


def run_of(scene: Scene, seed: int = 1, duration_s: float = 10.0, **keys: Any) -> Run:
    every = frozenset(range(len(scene.sensor)))
    return Run(Variant(name="", scene=scene, sensors=every, **keys), seed, START_NS, duration_s)


def figure(run: Run, metric: str, sensor: int = 0) -> float:
    return float(run.figures[sensor, list(METRICS).index(metric)])


@pytest.mark.parametrize("known", KNOWN["KNOWN"], ids=lambda each: each.words)
def test_what_is_known_by_hand_is_told_right(known: Any) -> None:
    told = KNOWN["told_of"](known, EXPERIMENTS)
    assert sum(not each.is_right(known) for each in told) <= MOST_WRONG
    if not known.change:
        assert {(each.low, each.high) for each in told} == {(0.0, 0.0)}


def test_the_page_says_that_it_is_told_right_in_95_of_100() -> None:
    rates = [int(n) for n in re.findall(r"\| (\d+) of 100 \|", (DOCS / "needs.md").read_text())]
    assert len(rates) == len(KNOWN["KNOWN"])
    assert min(rates) >= 95


def test_both_sides_draw_the_same_numbers() -> None:
    """Else the variance of a difference would be twice that of one side, not a fifth of it."""
    scene = scene_with(power_w=4.0, degradation={"pd_factor": 0.95})
    (variant,) = only(scene, "without degradation")
    seeds = range(1, 17)
    one, other = (
        np.array([figure(run_of(each, seed), "pd") for seed in seeds])
        for each in (scene, variant.scene)
    )
    assert 0.2 < one.mean() < 0.8
    assert np.var(other - one) < 0.5 * np.var(one)


def test_a_link_delays_and_loses_what_it_says() -> None:
    link = {"latency_ms": 120.0, "loss": {"kind": "random", "probability": 0.3}}
    run = run_of(scene_with(link=link), duration_s=200.0)
    assert figure(run, "delay_s") == pytest.approx(0.12, abs=1e-6)
    assert figure(run, "lost") == pytest.approx(0.3, abs=4 * np.sqrt(0.3 * 0.7 / 200))
    for on_loss in ("drop", "stall"):  # what a link holds is not there
        down = run_of(scene_with(link={"down": True, "on_loss": on_loss}))
        assert figure(down, "lost") == 1.0
        assert np.isnan(figure(down, "delay_s"))


def test_pd_of_looks_is_that_which_plots_are_counted_by() -> None:
    scene = scene_with(power_w=5.0)
    counted, closed = run_of(scene), run_of(scene, closed_form=True)
    chances = 12 * 10
    assert figure(closed, "pd") == pytest.approx(figure(counted, "pd"), abs=3 / np.sqrt(chances))
    assert figure(run_of(scene, 2, closed_form=True), "pd") == figure(closed, "pd")


def test_what_is_lost_without_a_sensor_is_what_no_other_has() -> None:
    """One radar sees half of the sky, the other one all of it: only that one is needed."""
    made = tree()
    half = {"id": "half", "azimuth_min_deg": 0.0, "azimuth_max_deg": 180.0}
    made["sensor"].append(made["sensor"][0] | half)
    losses = needs_of(made_of(made), [], runs=2).losses
    for loss in losses["half"]:
        assert loss.before - loss.after == pytest.approx(0.0, abs=0.02)
    for loss in losses["radar"]:
        assert loss.before > 0.9
        assert 0.3 < loss.before - loss.after < 0.7


@pytest.mark.parametrize("key", WORLD_KEYS)
def test_an_ordinary_world_is_noticed_by_who_looks_low(tmp_path: Path, key: str) -> None:
    """A radar 2 m above the ground, and drones at 20 m about a kilometre away."""
    paths = [[waypoint(5.0 * i, 1.2, 900.0), waypoint(5.0 * i, 1.2, 1100.0)] for i in range(6)]
    made = tree(drones=0, position_enu_m=[0.0, 0.0, 2.0])
    made["drone"] = [flown(f"d{i}", *places) for i, places in enumerate(paths)]
    scene = from_tree(made, tmp_path / "known.toml", toml_of(made))
    variants = [each for each in variants_of(scene, tmp_path) if each.effects == (f"[{key}]",)]
    (told,) = needs_of(scene, variants, runs=4).findings
    assert told.verdict == "missing"
    metric = "pd" if key == "terrain" else "alarms"
    assert max(told.changes, key=lambda c: abs(c.share)).metric in {metric, "gospa_m"}
    assert told.most(metric) is not None


def test_a_format_that_is_coarse_shows_its_steps() -> None:
    scene = scene_with(range_floor_m=0.1, range_resolution_m=0.5)
    (variant,) = [each for each in choices_of(scene) if each.read_back == "asterix-048"]
    fine = figure(run_of(scene), "range_m")
    coarse = figure(Run(variant, 1, START_NS, 10.0), "range_m")
    step_m = 1852 / 256
    assert coarse == pytest.approx(np.hypot(fine, step_m / np.sqrt(12)), rel=0.15)


def test_the_front_is_what_nothing_beats() -> None:
    costs, sizes = np.array([3.0, 1.0, 2.0, 2.0, 4.0]), np.array([0.0, 5.0, 4.0, 6.0, 0.0])
    assert on_front(costs, sizes).tolist() == [1, 2, 0]


@pytest.mark.parametrize("name", ["section-4", "field-day"])
def test_a_lean_scene_loads_and_has_lost_what_can_go(name: str) -> None:
    scene = example(name)
    alone = [variant for variant in variants_of(scene) if len(variant.effects) == 1]
    told = needs_of(scene, alone, runs=2, duration_s=2.0)
    written = [set(sensor) for sensor in tomllib.loads(scene.text)["sensor"]]
    for verdict in ("can go", "missing"):
        text = rewritten(scene, told, verdict)
        left = {v.name for v in variants_of(parsed(text.encode(), scene.folder / "other.toml"))}
        for each in (f.variant for f in told.findings if f.verdict == verdict):
            (effect,) = each.effects
            assert f"# {each.name}: " in text
            if verdict == "missing":
                assert f"without {effect}" in left
            elif any(effect in sensor for sensor in written):  # and not in a preset
                assert each.name not in left


@pytest.mark.parametrize("name", summaries())
def test_a_shipped_scene_is_lean_or_says_why_not(name: str) -> None:
    """Whatever could go by the table of docs/needs.md: effects, and sensors that are spared."""
    (row,) = re.findall(rf"^\| {name} \| (.*) \|$", (DOCS / "needs.md").read_text(), re.MULTILINE)
    _, goes, _, _, _, spared, _ = row.split(" | ")
    said = re.search(r"# plotfeed needs: ((?:.*\n#? ?(?=\S))*.*)", example(name).text)
    why = said[1] if said else ""
    unsaid = [each for each in re.findall(r"`([^`]+)`", goes + spared) if each not in why]
    assert unsaid == []


def test_runs_that_end_before_the_first_scan_decide_nothing() -> None:
    scene = scene_with(degradation={"pd_factor": 0.5})
    told = finding(scene, "without degradation", runs=2, duration_s=0.1)
    assert (told.verdict, told.largest) == ("undecided", None)


def test_a_scene_without_drones_of_its_own_is_told_so() -> None:
    scene = scene_with(drones=0)
    with pytest.raises(PlotfeedError, match="flies no drones"):
        needs_of(scene, variants_of(scene))


def test_the_commands_say_it_in_groups_and_draw_it(tmp_path: Path) -> None:
    path, lean, full = (tmp_path / f"{name}.toml" for name in ("here", "lean", "full"))
    keys = {"degradation": {"pd_factor": 0.5}, "bias": {"range_offset_m": 0.0}}
    made = tree(position_enu_m=[0.0, 0.0, 2.0], **keys)
    (sensor,) = made.pop("sensor")
    path.write_text(f"{toml_of(made)}[[sensor]]\n{toml_of(sensor)}")
    how = ["--runs", "4", "--duration", "5"]
    files = ["--chart", tmp_path / "n.png", "--write", lean, "--write", full]
    said = plotfeed_here("needs", path, *how, *files)
    needed, goes = said.stdout.index("Needed: without"), said.stdout.index("Can go: without")
    assert needed < said.stdout.index("without degradation") < goes
    assert goes < said.stdout.index("without bias")
    assert "4 of 4 runs at most" in said.stderr
    assert "minutes of processor" in said.stdout
    assert (tmp_path / "n.png").read_bytes().startswith(b"\x89PNG")
    assert "# without bias" in lean.read_text()
    assert load(lean).sensor[0].bias is None
    assert load(lean).sensor[0].degradation is not None
    assert load(full).birds
    assert list(Engine(load(full), START_NS).until(START_NS + 10**9))
    said = plotfeed_here("chart", path, *how, "--json")
    told = json.loads(said.stdout)["findings"]
    assert {"asterix-048 alone", "Pd of looks, in closed form"} <= {f["variant"] for f in told}
    assert all(f["octets"]["low"] <= f["octets"]["ratio"] <= f["octets"]["high"] for f in told)
    assert "Choices; * is on the front" in plotfeed_here("chart", path, *how).stdout


def test_runs_go_on_until_all_is_decided_or_the_time_is_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An effect of 1 %, where 2 % matter, takes some eight runs: not after no time at all."""
    known = KNOWN["KNOWN"][-1]
    scene = known.made(tmp_path)
    told = finding(scene, f"without {known.without}", runs=None)
    assert (told.verdict, told.runs) == ("can go", told.runs_needed)
    assert told.runs > FIRST_RUNS
    monkeypatch.setattr(needs, "BUDGET_S", 0.0)
    told = finding(scene, f"without {known.without}", runs=None)
    assert (told.verdict, told.runs) == ("undecided", FIRST_RUNS)
    assert told.runs_needed > FIRST_RUNS


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--write", "there.toml"), "expected a name that ends in lean.toml or full.toml"),
        *((("--matters", share), "--matters: expected a share such as 2% or 0.02")
          for share in ("0", "100%", "much", "-1%")),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(tmp_path: Path, options: tuple[str, str], said: str) -> None:
    path = tmp_path / "here.toml"
    path.write_text(toml_of(tree()))
    assert said in refusal("needs", path, *options)

"""One run's figures: by hand, by a session, and by what levels of one seed have in common."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.engine.simulation import simulate
from plotfeed.feeds.lab.runs import RunJob
from plotfeed.feeds.lab.sweep import SENSOR_COLUMNS, START_UTC_NS, RunPlan, arrivals_ns, run_once
from plotfeed.feeds.scene.levels import levels_of
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.scene.varied_keys import VariedKey
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.models.tracks import NEVER, enough_ns
from plotfeed.proto.utc import NS

PLAN = RunPlan(
    duration_s=30.0, protect_enu_m=(0.0, 0.0, 0.0), alert_plots=3, alert_within_s=10.0, bin_m=200.0
)
# With plots that are false alarms.
FAINT = radar("north", more="pfa = 1e-4").replace("pfa = 1e-5\n", "")


def runs(file: Path, *vary: str, seed: int = 5, **plan: Any) -> list[dict[str, Any]]:
    """A run at each level, with the same seed."""
    how = RunPlan(**{name: getattr(PLAN, name) for name in PLAN.__slots__} | plan)
    levels = levels_of([file], [VariedKey.parse(text) for text in vary])
    return [run_once(RunJob(level=level, run=0, seed=seed, plan=how)) for level in levels]


def column(result: dict[str, Any], name: str, sensor: str | None = None) -> Any:
    (row,) = (row for row in result["sensors"] if row[0] == sensor)
    return row[list(SENSOR_COLUMNS).index(name)]


def test_levels_with_one_seed_draw_the_same(tmp_path: Path) -> None:
    file = scene_file(tmp_path, scene_text(sensors=FAINT))
    late = runs(file, "link.latency_ms=0,500,1500")
    for name in ("looks", "expected", "detected", "plots", "false_alarms", "range_rms_m"):
        assert len({column(result, name, "north") for result in late}) == 1, name
    assert [column(result, "delay_ms", "north") for result in late] == [0.0, 500.0, 1500.0]
    told_s = [result["drones"][-1][6] for result in late]
    np.testing.assert_allclose(np.diff(told_s), [0.5, 1.0], atol=1e-6)
    strong = runs(file, "sensor.north.power_w=0.001,0.01,0.1,1.0")
    detected = [column(result, "detected") for result in strong]
    assert len({column(result, "looks") for result in strong}) == 1
    assert detected == sorted(detected)
    assert detected[0] < detected[-1]


def test_figures_are_those_of_the_simulation(tmp_path: Path) -> None:
    file = scene_file(tmp_path, scene_text(sensors=FAINT + radar("south")))
    (result,) = runs(file, seed=9)
    found = simulate(load(file), PLAN.duration_s or 0.0, seed=9, start_utc_ns=START_UTC_NS)
    for sensor, seen in found.items():
        assert column(result, "looks", sensor) == len(seen.looks)
        assert column(result, "plots", sensor) == len(seen.plots)
        assert column(result, "false_alarms", sensor) == (seen.plots.drone < 0).sum()
        assert column(result, "detected", sensor) == seen.looks.detected.sum()
        hits = seen.plots.rows(seen.plots.drone >= 0)
        rms_m = np.sqrt(np.mean((hits.range_m - hits.true_range_m) ** 2))
        np.testing.assert_allclose(column(result, "range_rms_m", sensor), rms_m)
        classes = [row for row in result["distances"] if row[0] == sensor]
        assert sum(row[3] for row in classes) == len(seen.looks)
        assert all(row[2] - row[1] == PLAN.bin_m for row in classes)
    both = sum(len(seen.plots) for seen in found.values())
    assert column(result, "plots") == column(result, "arrived") == both
    together = [row for row in result["drones"] if row[0] is None]
    each = [row for row in result["drones"] if row[0] is not None]
    assert [row[1] for row in together] == ["visitor"]
    assert together[0][4] == min(row[4] for row in each)
    assert together[0][6] <= min(row[6] for row in each)


DROPS = (
    'link = { latency_ms = 80.0, jitter_ms = 30.0, in_order = true, loss = { kind = "random", '
    "probability = 0.2 } }\n"
)
STALLS = 'link = { on_loss = "stall" }\n'  # What waits for it arrives when it is up again
COPIES = "link = { latency_ms = 80.0, jitter_ms = 30.0, duplicate = 0.5 }\n"  # The first counts
EVENTS = (
    "event = [{ from_s = 5.0, to_s = 9.0, set = { link = { down = trueOUTAGE } } }, "
    "{ from_s = 15.0, set = { link = { latency_ms = 300.0 } } }]"
)


@pytest.mark.parametrize(
    ("link", "outage"),
    # Of what is held and then leaves in any order, a copy may leave first.
    [(DROPS, ""), (STALLS, ""), (COPIES, ""), (COPIES, ', on_loss = "stall"')],
)
def test_the_link_does_what_it_does_in_a_session(link: str, outage: str, tmp_path: Path) -> None:
    more = f'report = ["plots"]\n{link}{EVENTS.replace("OUTAGE", outage)}'
    scene = load(scene_file(tmp_path, scene_text(sensors=radar("north", more=more))))
    seen = simulate(scene, 20.0, seed=scene.scene.seed, start_utc_ns=START_UTC_NS)["north"]
    arrived = arrivals_ns(seen, scene.scene.seed, START_UTC_NS)
    np.testing.assert_array_equal(arrived, left_in_session(scene, 20.0, seen.sectors.end_ns))
    up_again_ns = START_UTC_NS + 9 * NS
    assert (arrived == up_again_ns).any() or link is not STALLS


def left_in_session(scene: Scene, duration_s: float, due_ns: Any) -> Any:
    """When a session in simulated time sends the plots of sectors that are due then."""
    left: dict[int, int] = {}

    def tap(message: Any, sent_utc_ns: int) -> None:
        if message.topic.endswith("/plots"):
            left[message.due_utc_ns] = min(sent_utc_ns, left.get(message.due_utc_ns, NEVER))

    clock = InstantClock(START_UTC_NS)
    asyncio.run(run(scene, clock=clock, broker="none", duration_s=duration_s + 5.0, tap=tap))
    return np.array([left.get(due, NEVER) for due in due_ns.tolist()])


def test_an_alert_is_so_many_plots_of_a_drone_within_a_time() -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        n, plots, within = int(rng.integers(0, 30)), int(rng.integers(1, 5)), 8
        drone, t_ns = rng.integers(0, 3, n), rng.integers(0, 40, n)
        expected = []
        for one in range(3):
            mine = sorted(t_ns[drone == one].tolist())
            ends = [b for a, b in zip(mine, mine[plots - 1 :], strict=False) if b - a <= within]
            expected.append(min(ends, default=NEVER))
        assert enough_ns(drone, t_ns, plots, within, 3).tolist() == expected


def test_distances_of_alerts_are_to_what_is_protected(tmp_path: Path) -> None:
    still = """
[[drone]]
id = "still"
rcs_m2 = 0.1
speed_m_s = 0.01
repeat = true
path = [
    { east_m = 300.0, north_m = 400.0, above_site_m = 100.0 },
    { east_m = 300.01, north_m = 400.0, above_site_m = 100.0 },
]
"""
    file = scene_file(tmp_path, scene_text(drones=still))
    (far,) = runs(file, duration_s=10.0)
    (near,) = runs(file, duration_s=10.0, protect_enu_m=(300.0, 400.0, 60.0))
    np.testing.assert_allclose(column(far, "alert_distance_m"), np.hypot(500.0, 100.0), atol=0.1)
    np.testing.assert_allclose(column(near, "alert_distance_m"), 40.0, atol=0.1)
    (never,) = runs(file, "sensor.radar.enabled=false", duration_s=10.0)
    assert (column(never, "alerted"), column(never, "alert_distance_m")) == (0, 0.0)
    assert never["drones"] == [[None, "still", 0, 0, None, None, None, None]]

from __future__ import annotations

import asyncio
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from support.scene_files import DRONE, radar, scene_file, scene_text

import plotfeed
from plotfeed import Observer, PlotfeedError, Scene, load, run, simulate
from plotfeed.feeds.engine.simulation import Simulation
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.scene.scene import example
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.models.state import FALSE_ALARM

START = "2026-01-01T12:00:00.05Z"
START_NS = 1_767_268_800 * 10**9
DURATION_S = 20.0
SECOND_DRONE = DRONE.replace("visitor", "late").replace("rcs_m2", "start_s = 4.0\nrcs_m2")
SENSORS = "\n".join(
    [
        radar("plain"),
        radar(
            "scripted",
            period_s=0.7,
            more="""
event = [
    { from_s = 3.0, to_s = 6.005, set = { enabled = false } },
    { from_s = 5.0, to_s = 9.0, set = { pfa_factor = 20, loss_db = 5.0 } },
]
link = { latency_ms = 300, loss = { kind = "random", probability = 0.5 } }
bias = { time_offset_s = 0.2, azimuth_offset_deg = 1.0 }
""",
        ).replace("[sensor.scan]", "[sensor.scan]\njitter_ms = 10.0"),
        radar("staring", period_s=0.4).replace("rotating", "staring").replace("sectors = 8", ""),
        radar("merging", more='merging = {}\nreport = ["asterix-048"]'),
    ]
)


class Reports(Observer):
    def __init__(self) -> None:
        self.of: dict[str, list[Batch]] = {}

    def report(self, report: Batch) -> None:
        self.of.setdefault(report.sensor, []).append(report)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    text = scene_text(start_utc=START, sensors=SENSORS, drones=DRONE + SECOND_DRONE)
    return scene_file(tmp_path, text)


async def assert_as_in_a_session(simulated: Simulation, what: Scene, start_utc_ns: int) -> None:
    """Every column of every sensor, and to which scan and sector it belongs."""
    reports, clock = Reports(), InstantClock(start_utc_ns)
    await run(what, clock=clock, broker="none", duration_s=DURATION_S, observers=[reports])
    assert set(simulated) == set(reports.of)
    for sensor, of_session in reports.of.items():
        for name in ("plots", "looks"):
            rows, parts = getattr(simulated[sensor], name), [getattr(r, name) for r in of_session]
            expected = type(parts[0]).joined(parts)
            assert len(rows) == len(expected)
            for field in fields(expected):
                there = getattr(expected, field.name)
                if there is None or field.name == "sensor":  # all of a simulation's rows are of one
                    assert getattr(rows, field.name) is None
                else:
                    np.testing.assert_array_equal(getattr(rows, field.name), there)
            lengths = [len(part) for part in parts]
            scans, sectors = zip(
                *((r.sector.scan, r.sector.index) for r in of_session), strict=True
            )
            assert rows.scan.tolist() == np.repeat(scans, lengths).tolist()
            assert rows.sector.tolist() == np.repeat(sectors, lengths).tolist()


@pytest.mark.asyncio
async def test_columns_are_those_that_a_session_reports(path: Path) -> None:
    simulated, what = simulate(path, DURATION_S), load(path)
    await assert_as_in_a_session(simulated, what, what.scene.start_utc_ns or 0)
    assert simulated.drones == ("visitor", "late")
    drones = np.concatenate([each.plots.drone for each in simulated.values()])
    assert set(drones) == {FALSE_ALARM, 0, 1}
    simulated = simulate("section-4", DURATION_S, start_utc_ns=START_NS)
    await assert_as_in_a_session(simulated, example("section-4"), START_NS)
    assert set(simulated) == {"active", "mimo", "passive", "microphone"}


@pytest.mark.asyncio
async def test_it_works_where_a_loop_is_running(path: Path) -> None:
    alone = await asyncio.to_thread(simulate, path, 1.0)
    assert len(simulate(path, 1.0)["plain"].plots) == len(alone["plain"].plots) > 0


def test_a_seed_draws_anew_and_a_path_is_a_scene(path: Path) -> None:
    what = load(path)
    own = simulate(path, 5.0)["plain"].plots.range_m
    same = simulate(str(path), 5.0, seed=what.scene.seed)
    other = simulate(what, 5.0, seed=what.scene.seed + 1)
    np.testing.assert_array_equal(own, same["plain"].plots.range_m)
    assert own.tolist() != other["plain"].plots.range_m.tolist()


def test_before_the_first_sector_ends_tables_are_empty_and_errors_are_the_command_s(
    path: Path,
) -> None:
    plain = simulate(path, 0.01)["plain"]
    assert len(plain.plots) == len(plain.looks) == len(plain.plots.scan) == 0
    with pytest.raises(PlotfeedError, match="no shipped scene 'no-such-example'"):
        simulate("no-such-example", 1.0)


def test_the_face_has_what_it_says() -> None:
    assert set(dir(plotfeed)) == {*plotfeed.__all__, "__version__"}
    assert plotfeed.__version__
    assert plotfeed.__doc__
    assert all(getattr(plotfeed, name) for name in plotfeed.__all__)
    with pytest.raises(AttributeError, match="nonsense"):
        _ = plotfeed.nonsense

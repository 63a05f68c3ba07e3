"""`plotfeed sweep`: figures of a run, runs by processes that may die, and the tables of all."""

from __future__ import annotations

import asyncio
import csv
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from support.command import plotfeed, plotfeed_here, refusal, started
from support.scene_files import STILL, radar, scene_file, scene_text
from support.waiting import wait_until

from plotfeed.feeds.console import extras
from plotfeed.feeds.console.cluster import EngineError, connected
from plotfeed.feeds.engine.simulation import simulate
from plotfeed.feeds.lab import sweep
from plotfeed.feeds.lab.runs import Journal, RunJob, seed_of, spread
from plotfeed.feeds.lab.sweep import (
    SENSOR_COLUMNS,
    START_UTC_NS,
    TABLES,
    RunPlan,
    arrivals_ns,
    run_once,
)
from plotfeed.feeds.scene.levels import SweepLevel, levels_of
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.scene.varied_keys import VariedKey
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.models.tracks import NEVER, enough_ns
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

# One run's figures.

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
    file = scene_file(tmp_path, scene_text(drones=STILL))
    (far,) = runs(file, duration_s=10.0)
    (near,) = runs(file, duration_s=10.0, protect_enu_m=(800.0, 600.0, 110.0))
    np.testing.assert_allclose(column(far, "alert_distance_m"), np.hypot(1000.0, 150.0), atol=0.1)
    np.testing.assert_allclose(column(near, "alert_distance_m"), 40.0, atol=0.1)
    (never,) = runs(file, "sensor.radar.enabled=false", duration_s=10.0)
    assert (column(never, "alerted"), column(never, "alert_distance_m")) == (0, 0.0)
    assert never["drones"] == [[None, "still", 0, 0, None, None, None, None]]


# Runs by processes.

PROGRAM = """
import os, signal, sys
from pathlib import Path
from plotfeed.feeds.lab import runs
from plotfeed.feeds.lab.runs import spread

runs.TRIES = 2

def work(job):
    mark = Path(sys.argv[1]) / str(job)
    if job % 3 == 0 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid(), job * job

def dies(job):
    os.kill(os.getpid(), signal.SIGKILL)

if __name__ == "__main__":
    found = []
    for job, (process, result) in spread(work, range(4), processes=2):
        assert process != os.getpid()
        found.append((job, result))
    print("found", sorted(found))
    try:
        list(spread(dies, [7], processes=2))
    except Exception as error:
        print(type(error).__name__, error)
"""


def test_a_job_whose_process_was_killed_is_done_again_by_another(tmp_path: Path) -> None:
    program, marks = tmp_path / "program.py", tmp_path / "marks"
    program.write_text(PROGRAM)
    marks.mkdir()
    done = subprocess.run(
        [sys.executable, program, marks], capture_output=True, text=True, timeout=600, check=False
    )
    assert done.stdout.splitlines() == [
        f"found {[(job, job * job) for job in range(4)]}",
        "EngineError 2 processes died of one job: 7",
    ], done.stderr
    assert sorted(path.name for path in marks.iterdir()) == ["0", "3"]


def test_one_process_is_this_one_and_goes_job_by_job() -> None:
    begun: list[int] = []

    def work(job: int) -> int:
        begun.append(job)
        if job == 3:
            raise PlotfeedError("no three")
        return -job

    results = spread(work, range(5), processes=1)
    assert next(results) == (0, 0)
    assert begun == [0]
    assert [next(results), next(results)] == [(1, -1), (2, -2)]
    with pytest.raises(PlotfeedError, match="no three"):
        next(results)


def test_where_ray_is_not_installed_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda _: None)
    with pytest.raises(PlotfeedError, match=r"plotfeed\[fleet\]"), connected("127.0.0.1:1"):
        pass


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere", "127.0.0.1:ray"])
def test_no_cluster_there_is_told_of(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda _: "ray")
    said = r"^Ray.*(does not answer|expected HOST:PORT)"
    with pytest.raises(EngineError, match=said), connected(address):
        pass


TWO = [SweepLevel(number, "made", "made.toml", "", ()) for number in range(2)]


def test_what_is_missing_comes_a_run_of_all_levels_at_a_time(tmp_path: Path) -> None:
    with Journal(tmp_path / "journal.jsonl", {}) as kept:
        for level, run in [(1, 2), (1, 0), (0, 0), (0, 3)]:
            kept.take({"level": level, "run": run})
        missing = [(level.number, run) for level, run in kept.missing(TWO, 3)]
        assert missing == [(0, 1), (1, 1), (0, 2)]
        assert list(kept.of_first(3)) == [(0, 0), (1, 0), (1, 2)]
        assert list(kept.of_first(1)) == [(0, 0), (1, 0)]


def test_seeds_are_the_next_whole_numbers_and_begin_again_after_the_last() -> None:
    assert [seed_of(5, run) for run in range(3)] == [5, 6, 7]
    last = (1 << 63) - 1
    assert [seed_of(last, run) for run in range(2)] == [last, 0]


# The command.

VARY = ("--vary", "sensor.north.pfa=1e-6,1e-4", "--vary", "link.latency_ms=0:200:200")
SHORT = ("--duration", 4, "--runs", 3, "--processes", 1)
LEVELS, RUNS = 4, 3
MOST_S = 600  # Ray takes its time on a machine that is busy


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scene")
    return scene_file(folder, scene_text(sensors=radar("north") + radar("south"), port=1))


@pytest.fixture(scope="module")
def whole(file: Path) -> Path:
    """The folder of a sweep that nothing has interrupted."""
    folder = file.parent / "whole"
    done = plotfeed_here("sweep", file, *VARY, *SHORT, "--out", folder)
    assert done.returncode == 0, done.stderr
    return folder


def octets(folder: Path) -> dict[str, bytes]:
    """The tables."""
    return {name: (folder / f"{name}.parquet").read_bytes() for name in TABLES}


def journal(folder: Path) -> list[Any]:
    return [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]


def test_tables_have_a_row_for_each_run_and_sensor(whole: Path) -> None:
    runs = pq.read_table(whole / "runs.parquet").to_pylist()
    assert len(runs) == LEVELS * RUNS * 3
    keys = ("scene", "sensor.north.pfa", "link.latency_ms", "run", "seed", "sensor")
    assert list(runs[0])[:6] == list(keys)
    assert [runs[0][key] for key in keys] == ["test", 1e-6, 0, 0, 1, "north"]
    assert {row["seed"] - row["run"] for row in runs} == {1}
    assert {row["sensor"] for row in runs} == {"north", "south", None}
    drones = pq.read_table(whole / "drones.parquet").to_pylist()
    assert {row["drone"] for row in drones} == {"visitor"}
    distances = pq.read_table(whole / "distances.parquet").to_pylist()
    assert sum(row["looks"] for row in distances) == sum(r["looks"] for r in runs if r["sensor"])
    assert (whole / "sweep.png").stat().st_size > 10_000


def test_a_sweep_that_was_killed_goes_on_to_the_same_tables(
    file: Path, whole: Path, tmp_path: Path
) -> None:
    """By two processes in place of one."""
    folder, lines = tmp_path / "killed", 2
    command = ["sweep", file, *VARY, *SHORT, "--out", folder]
    path = folder / "journal.jsonl"
    with started(*command, "--runs", 2):  # more of them are asked for later
        wait_until(lambda: path.exists() and path.read_bytes().count(b"\n") > lines)
    with path.open("ab") as torn:  # as where it was killed while it wrote
        torn.write(b'{"level": 0, "run": 2, "sen')
    done = plotfeed(*command, "--processes", 2, "--json", wait_s=MOST_S)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["were_done"] >= lines
    assert len(journal(folder)) == 1 + LEVELS * RUNS
    assert octets(folder) == octets(whole)


def test_an_interrupted_sweep_says_how_to_go_on(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def until_ctrl_c(job: RunJob) -> dict[str, Any]:
        if job.run:
            raise KeyboardInterrupt
        return run_once(job)

    monkeypatch.setattr(sweep, "run_once", until_ctrl_c)
    done = plotfeed_here("sweep", file, *VARY, *SHORT, "--out", tmp_path)
    assert done.returncode == 130
    assert done.stderr.split("\n")[0].endswith(
        f"{LEVELS} of {LEVELS * RUNS} runs are kept in {tmp_path}/journal.jsonl; the same command "
        "goes on from there"
    )
    assert len(journal(tmp_path)) == 1 + LEVELS


def test_what_was_begun_otherwise_does_not_go_on(file: Path, whole: Path, tmp_path: Path) -> None:
    before = octets(whole)
    changed = tmp_path / "scene.toml"
    changed.write_text(file.read_text().replace("seed = 3", "seed = 4"))
    for scene, options, what in (
        (changed, VARY, "scenes"),
        (file, VARY[:2], "--vary"),
        (file, (*VARY, "--seed", 2), "--seed"),
        (file, (*VARY, "--alert-plots", 5), "--alert-plots"),
        (file, (*VARY, "--protect", "1,2"), "--protect"),
    ):
        said = refusal("sweep", scene, *options, *SHORT, "--out", whole)
        assert f"begun with other {what}; --force begins anew" in said
    assert octets(whole) == before


def test_two_sweeps_do_not_write_to_one_folder(file: Path, tmp_path: Path) -> None:
    fcntl = pytest.importorskip("fcntl")
    (tmp_path / "journal.jsonl").touch()
    with (tmp_path / "journal.jsonl").open("ab") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        said = refusal("sweep", file, *SHORT, "--out", tmp_path)
    assert "another process works on it" in said


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_one_table_can_be_asked_for(file: Path, whole: Path, tmp_path: Path, suffix: str) -> None:
    target = tmp_path / f"runs{suffix}"
    arguments = ("sweep", file, *VARY, *SHORT, "--out", target)
    assert plotfeed_here(*arguments).returncode == 0
    assert os.listdir(tmp_path) == [target.name]  # noqa: PTH208
    if suffix == ".parquet":
        assert target.read_bytes() == octets(whole)["runs"]
    else:
        rows = list(csv.DictReader(target.read_text().splitlines()))
        of = pq.read_table(whole / "runs.parquet").to_pylist()
        assert [row["plots"] for row in rows] == [str(row["plots"]) for row in of]
        assert [float(row["sensor.north.pfa"]) for row in rows] == [
            row["sensor.north.pfa"] for row in of
        ]
    assert "is there already; --force" in refusal(*arguments)


def test_scenes_are_compared(file: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    weak = file.read_text().replace("power_w = 500.0", "power_w = 0.005")
    other.write_text(weak.replace('name = "test"', 'name = "weak"'))
    done = plotfeed_here("sweep", file, other, *SHORT, "--out", tmp_path / "both", "--json")
    figures = json.loads(done.stdout)["figures"]
    together = {each["scene"]: each for each in figures if each["sensor"] is None}
    assert list(together) == ["test", "weak"]
    assert together["weak"]["pd"]["value"] < together["test"]["pd"]["value"]
    assert together["test"]["alert_change_m"]["value"] == 0.0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--vary", "sensor.east.pfa=1e-5"), "no sensor 'east': expected one of north"),
        (("--vary", "sensor.north.pfa=5"), "--vary sensor.north.pfa=5: sensor.north.pfa: "),
        (("--vary", "link.rate_kbit_s=5"), "a sweep sends no octets"),
        (("--vary", "mqtt.port=5"), "a sweep sends no octets"),
        (("--vary", "scene.seed=5"), "--seed and --runs draw anew"),
        (("--protect", "here"), "expected EAST,NORTH"),
        (("--chart", "sweep.bmp"), "expected a name that ends in"),
        (("--ray", "127.0.0.1:1", "--processes", "2"), "the cluster of --ray has its own"),
    ],
)
def test_what_cannot_be_is_one_line(
    file: Path, tmp_path: Path, options: tuple[str, ...], said: str
) -> None:
    assert said in refusal("sweep", file, *options, "--out", tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_what_others_have_written_there_stays(file: Path, tmp_path: Path) -> None:
    for name, said in (
        ("runs.parquet", "runs.parquet: is there already"),
        ("journal.jsonl", "is no journal of runs"),
    ):
        (tmp_path / name).write_text("mine\nalone\n")
        assert said in refusal("sweep", file, *SHORT, "--out", tmp_path)
        assert (tmp_path / name).read_text() == "mine\nalone\n"

"""`plotfeed sweep`: the same tables whatever ends it and however many work, and clear refusals."""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from support.command import plotfeed, plotfeed_here, started
from support.scene_files import radar, scene_file, scene_text
from support.waiting import wait_until

from plotfeed.feeds.lab import sweep
from plotfeed.feeds.lab.runs import RunJob
from plotfeed.feeds.lab.sweep import TABLES, run_once

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
    at = {tuple(row[key] for key in keys): row for row in runs}
    for row in runs:  # the link changes nothing that a sensor sees
        other = at[*[{"link.latency_ms": 0}.get(key, row[key]) for key in keys]]
        assert (row["plots"], row["detected"]) == (other["plots"], other["detected"])
    drones = pq.read_table(whole / "drones.parquet").to_pylist()
    assert {row["drone"] for row in drones} == {"visitor"}
    distances = pq.read_table(whole / "distances.parquet").to_pylist()
    assert sum(row["looks"] for row in distances) == sum(r["looks"] for r in runs if r["sensor"])
    assert (whole / "sweep.png").stat().st_size > 10_000


def test_a_sweep_killed_at_any_time_goes_on_and_its_tables_are_the_same(
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


def test_what_was_begun_otherwise_is_not_gone_on_with(
    file: Path, whole: Path, tmp_path: Path
) -> None:
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
        done = plotfeed_here("sweep", scene, *options, *SHORT, "--out", whole)
        assert done.returncode == 2
        assert f"begun with other {what}; --force begins anew" in done.stderr
        assert len(done.stderr.splitlines()) == 1
    assert octets(whole) == before


def test_two_sweeps_do_not_write_to_one_folder(file: Path, tmp_path: Path) -> None:
    fcntl = pytest.importorskip("fcntl")
    (tmp_path / "journal.jsonl").touch()
    with (tmp_path / "journal.jsonl").open("ab") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        done = plotfeed_here("sweep", file, *SHORT, "--out", tmp_path)
    assert done.returncode == 2
    assert "another process works on it" in done.stderr


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
    again = plotfeed_here(*arguments)
    assert again.returncode == 2
    assert "is there already; --force" in again.stderr


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
    done = plotfeed_here("sweep", file, *options, "--out", tmp_path / "none")
    assert done.returncode == 2
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "none").exists()


def test_what_others_have_written_there_stays(file: Path, tmp_path: Path) -> None:
    (tmp_path / "runs.parquet").write_text("mine")
    done = plotfeed_here("sweep", file, *SHORT, "--out", tmp_path)
    assert done.returncode == 2
    assert "runs.parquet: is there already" in done.stderr
    assert (tmp_path / "runs.parquet").read_text() == "mine"
    (tmp_path / "journal.jsonl").write_text("mine\nalone\n")
    done = plotfeed_here("sweep", file, *SHORT, "--out", tmp_path)
    assert "is no journal of runs" in done.stderr
    assert (tmp_path / "journal.jsonl").read_text() == "mine\nalone\n"

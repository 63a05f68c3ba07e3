"""Runs: each is done, also one whose process dies; what a journal lacks; errors are told."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from plotfeed.feeds.console import extras
from plotfeed.feeds.console.cluster import EngineError, connected
from plotfeed.feeds.lab.runs import Journal, seed_of, spread
from plotfeed.feeds.scene.levels import SweepLevel
from plotfeed.proto.errors import PlotfeedError

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
def test_a_cluster_that_is_not_there_is_told_of(address: str) -> None:
    pytest.importorskip("ray")
    said = r"^Ray.*(does not answer|expected HOST:PORT)"
    with pytest.raises(EngineError, match=said), connected(address):
        pass


LEVELS = [SweepLevel(number, "made", "made.toml", "", ()) for number in range(2)]


def test_what_is_missing_is_what_was_asked_and_not_kept_a_run_of_all_levels_at_a_time(
    tmp_path: Path,
) -> None:
    with Journal(tmp_path / "journal.jsonl", {}) as kept:
        for level, run in [(1, 2), (1, 0), (0, 0), (0, 3)]:
            kept.take({"level": level, "run": run})
        missing = [(level.number, run) for level, run in kept.missing(LEVELS, 3)]
        assert missing == [(0, 1), (1, 1), (0, 2)]
        assert list(kept.of_first(3)) == [(0, 0), (1, 0), (1, 2)]
        assert list(kept.of_first(1)) == [(0, 0), (1, 0)]


def test_seeds_are_the_next_whole_numbers_and_begin_again_after_the_last() -> None:
    assert [seed_of(5, run) for run in range(3)] == [5, 6, 7]
    last = (1 << 63) - 1
    assert [seed_of(last, run) for run in range(2)] == [last, 0]

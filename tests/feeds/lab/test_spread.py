"""Jobs that are spread: each is done, also one whose process dies, and errors are told."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from plotfeed.feeds.lab.runs import spread
from plotfeed.proto.errors import PlotfeedError

PROGRAM = """
import os, signal, sys
from pathlib import Path
from plotfeed.feeds.lab.runs import spread

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
    for job, (process, result) in spread(work, range(8), processes=2):
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
        f"found {[(job, job * job) for job in range(8)]}",
        "EngineError 4 processes died of one job: 7",
    ], done.stderr
    assert sorted(path.name for path in marks.iterdir()) == ["0", "3", "6"]


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

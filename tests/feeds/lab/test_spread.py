"""Jobs that are spread: each is done, also one whose process dies, and errors are told."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from support.fleet_process import skip_without_ray

from plotfeed.feeds.lab.runs import spread
from plotfeed.proto.errors import PlotfeedError

MOST_S = 600
"""Ray takes its time on a machine that is busy."""
PROGRAM = """
import os, signal, sys
from pathlib import Path
from plotfeed.feeds.lab.runs import spread

folder = Path(sys.argv[1])

def work(job):
    mark = folder / str(job)
    if job % 3 == 0 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid(), job * job

found = []
for job, (process, result) in spread(work, range(8), processes=2):
    assert process != os.getpid()
    found.append((job, result))
print("found", sorted(found))
"""


def test_a_job_whose_process_was_killed_is_done_again_by_another(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(tmp_path)],
        capture_output=True, text=True, timeout=MOST_S, check=False,
    )  # fmt: skip
    skip_without_ray(done.stderr)
    found = [line for line in done.stdout.splitlines() if line.startswith("found")]  # Ray's beside
    assert found == [f"found {[(job, job * job) for job in range(8)]}"], done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0", "3", "6"]


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

"""Runs a minute of a sweep, by one process and by two, in turns in one run.

    python tools/benchmarks/bench_sweep.py [REPEATS]

The scene is section-4, 30 s of it: four sensors and a drone. A ratio is that of two processes over
one of the same turn; starting Ray is left out, as the time from the first run that is done to the
last is measured.
"""

from __future__ import annotations

import statistics
import sys
import time
from importlib.resources import as_file, files
from pathlib import Path

from aims import aim, ratios, spread, table

from plotfeed.feeds.lab.runs import RunJob
from plotfeed.feeds.lab.runs import spread as spread_over
from plotfeed.feeds.lab.sweep import RunPlan, run_once
from plotfeed.feeds.scene.levels import SweepLevel, levels_of
from plotfeed.feeds.scene.varied_keys import VariedKey

REPEATS, RUNS = 3, 30
AIM = 1.8
PLAN = RunPlan(
    duration_s=30.0, protect_enu_m=(0.0, 0.0, 0.0), alert_plots=3, alert_within_s=10.0, bin_m=200.0
)


def runs_a_minute(levels: list[SweepLevel], processes: int) -> float:
    """From the first run that is done to the last."""
    every = ((level, run) for run in range(RUNS) for level in levels)
    jobs = [RunJob(level=level, run=run, seed=run, plan=PLAN) for level, run in every]
    done_s = [time.monotonic() for _ in spread_over(run_once, jobs, processes=processes)]
    return 60 * (len(done_s) - 1) / (done_s[-1] - done_s[0])


def main(repeats: int) -> None:
    """Measures and prints a table."""
    with as_file(files("plotfeed.feeds.scene.examples") / "section-4.toml") as file:
        levels = levels_of([Path(file)], [VariedKey.parse("sensor.active.pfa=1e-6,1e-5")])
        by = {processes: [] for processes in (1, 2)}
        for _ in range(repeats):
            for processes, found in by.items():
                found.append(runs_a_minute(levels, processes))
    print(f"Median (least to most) of {repeats} repeats of {RUNS * len(levels)} runs.\n")
    rows = ((n, spread(each, ",.0f"), spread(ratios(each, by[1]))) for n, each in by.items())
    table(("processes", "runs a minute", "times one process"), rows, 0)
    times = ratios(by[2], by[1])
    found = f"{spread(times)} times"
    print("\n" + aim("a sweep by two processes", f"at least {AIM} times one", found,
                     is_met=statistics.median(times) >= AIM))  # fmt: skip


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else REPEATS)

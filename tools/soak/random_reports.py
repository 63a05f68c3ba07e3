"""Judges random scenes by the report, and writes the table of docs/report.md: who was called wrong.

    make verdicts ARGS="--scenes 200"

In simulated time, a minute of each; some two seconds of processor time a scene.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from scipy import stats

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[2] / "docs" / "commands"))

from pages import between, table
from support.random_scenes import LINKS, SECONDS, JudgedScene, judged_scene

from plotfeed.feeds.lab.judge import FALSE_RATES
from plotfeed.feeds.scene.sensors import SENSORS
from plotfeed.models.verdicts import share_interval

PAGE = Path(__file__).parents[2] / "docs" / "report.md"
SUBJECTS = ("detection", "errors", "false alarms", LINKS)


def text_of(scenes: list[JudgedScene]) -> str:
    """The table, and the line below it."""
    judged: Counter[tuple[str, str]] = Counter()
    plots: Counter[str] = Counter()
    sensors: Counter[str] = Counter()
    wrong: Counter[str] = Counter()
    for scene in scenes:
        judged += scene.judged()
        plots += scene.plots
        sensors += Counter(scene.kinds.values())
        wrong += Counter(line.partition("(")[2].partition(")")[0] for line in scene.wrong)
    rows = [
        (f"`{kind}`", sensors[kind], plots[kind], *(judged[kind, s] for s in SUBJECTS), wrong[kind])
        for kind in sorted(SENSORS)
    ]
    rows.append(("cooperative drones", "", "", "", "", "", judged[LINKS, LINKS], wrong["-"]))
    head = ("type", *(f">{name}" for name in ("sensors", "plots", *SUBJECTS, "wrong")))
    rate = FALSE_RATES["asked"]
    called = sum(bool(scene.wrong) for scene in scenes)
    low, high = share_interval(called, len(scenes))
    p = float(stats.binomtest(called, len(scenes), rate, alternative="greater").pvalue)
    told = (
        f"Of {len(scenes)} scenes of {SECONDS:.0f} s the report calls {called} wrong "
        f"(95 % interval {100 * low:.1f} to {100 * high:.1f} %); stated is "
        f"{100 * rate:g} %, and by a binomial test so many or more have p = {p:.2g}. "
        f"Chance decides {judged.total()} figures. {plots.total()} plots are compared; "
        f"{sum(scene.not_compared for scene in scenes)} are not, since noise decides whether they "
        "are there."
    )
    return "\n".join([*table(head, rows), "", told])


def main() -> None:
    """Run, report and count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--processes", type=int, default=2)
    asked = parser.parse_args()
    scenes = []
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(asked.processes) as workers:
        judge = partial(judged_scene, folder=Path(folder))
        for scene in workers.map(judge, range(asked.scenes)):
            scenes.append(scene)
            print(scene.seed, len(scene.figures), scene.plots.total(), *scene.wrong, flush=True)
    between(PAGE, "random", text_of(scenes))


if __name__ == "__main__":
    main()

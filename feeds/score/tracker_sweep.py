"""`plotfeed score SCENE --tracker`: a tracker at each level of what is varied, and its curve."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.console.printed import finite, say
from plotfeed.feeds.console.process import refuse_if_there
from plotfeed.feeds.score.score_curve import CurvePoint, curve_lines, draw_curve
from plotfeed.feeds.score.score_figures import FIGURE_NAMES
from plotfeed.feeds.score.score_settings import ScoreSettings
from plotfeed.feeds.score.tracker_run import (
    TrackerCommand,
    TrackerJob,
    TrackerPlan,
    of_trackers,
    run_tracker,
)
from plotfeed.feeds.sweep.journal import NAME, Journal, keep_all, seed_of
from plotfeed.feeds.sweep.levels import SweepLevel, digests, levels_of
from plotfeed.feeds.sweep.sweep_summary import Results
from plotfeed.feeds.sweep.sweep_tables import level_columns, usual_suffix, write_table
from plotfeed.feeds.sweep.varied_keys import VariedKey
from plotfeed.proto.errors import PlotfeedError

PICTURE = "curve.png"


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerSettings:
    """What is asked for, in the words of the command's options."""

    trackers: Sequence[str]
    vary: Sequence[str]
    runs: int
    seed: int
    duration: float | None
    speed: float
    patience: float
    topic: str | None
    folder: Path
    processes: int
    ray: str | None
    force: bool
    as_json: bool


def score_tracker(scene: Path, settings: TrackerSettings, how: ScoreSettings) -> int:
    """Run what is not done yet, write the table and the picture; the exit code.

    That is 1 where a tracker failed in any run. Raises `PlotfeedError`, and `OSError`.
    """
    trackers = [TrackerCommand.parse(text) for text in settings.trackers]
    names = [tracker.name for tracker in trackers]
    if len(set(names)) < len(names):
        raise PlotfeedError("--tracker: several need names of their own: NAME=COMMAND")
    if settings.ray is not None:
        need_extra("ray", "--ray", "fleet", load=False)
    of_scene = levels_of([scene], [VariedKey.parse(text) for text in settings.vary])
    told = _told(of_scene, trackers, settings, how)
    levels = of_trackers(of_scene, names)
    if not (settings.folder / NAME).exists():
        for path in _files(settings):
            refuse_if_there(path, force=settings.force)
    with Journal(settings.folder / NAME, told, anew=settings.force) as kept:
        before = _run(kept, levels, trackers, settings, how)
        done = kept.of_first(settings.runs)
        points = [CurvePoint.of(level, names[level.number % len(names)], done) for level in levels]
        written = list(_write(levels, points, done, settings))
    _print(points, written, before, settings)
    return 1 if any(point.failures for point in points) else 0


def _told(
    levels: Sequence[SweepLevel],
    trackers: Sequence[TrackerCommand],
    settings: TrackerSettings,
    how: ScoreSettings,
) -> dict[str, Any]:
    """What the journal must have begun with; more runs may be asked."""
    return {
        "plotfeed": version("plotfeed"),
        "scenes": digests(levels),
        "--vary": [list(map(list, level.changes)) for level in levels],
        "--tracker": [[tracker.name, *tracker.words] for tracker in trackers],
        "--seed": settings.seed,
        "--duration": settings.duration,
        "--speed": settings.speed,
        "--topic": settings.topic,
        "settings of the score": asdict(how),
    }


def _run(
    kept: Journal,
    levels: Sequence[SweepLevel],
    trackers: Sequence[TrackerCommand],
    settings: TrackerSettings,
    how: ScoreSettings,
) -> int:
    """Do what is not done yet; how many runs were."""
    plan = TrackerPlan(
        duration_s=settings.duration,
        speed=settings.speed,
        patience_s=settings.patience,
        topic=settings.topic,
        settings=how,
    )
    jobs = [
        TrackerJob(
            level=level,
            run=run,
            seed=seed_of(settings.seed, run),
            tracker=trackers[level.number % len(trackers)],
            plan=plan,
        )
        for level, run in kept.missing(levels, settings.runs)
    ]
    before = len(levels) * settings.runs - len(jobs)
    processes = None if settings.ray else min(settings.processes, max(len(jobs), 1))
    keep_all(kept, run_tracker, jobs, before, address=settings.ray, processes=processes)
    return before


def _files(settings: TrackerSettings) -> list[Path]:
    """The table, and the picture where it can be drawn."""
    picture = [settings.folder / PICTURE] if find_spec("matplotlib") else []
    return [settings.folder / f"scores{usual_suffix()}", *picture]


def _write(
    levels: Sequence[SweepLevel],
    points: Sequence[CurvePoint],
    done: Results,
    settings: TrackerSettings,
) -> Iterator[Path]:
    own = {"failure": str, **dict.fromkeys(FIGURE_NAMES, float)}
    rows = [
        (key, [[run["failure"] or None, *(run["figures"][name] for name in FIGURE_NAMES)]])
        for key, run in sorted(done.items())
    ]
    table, *pictures = _files(settings)
    first = "tracker" if len(settings.trackers) > 1 else "scene"
    write_table(table, *level_columns(levels, done, rows, own, first=first))
    yield table
    for picture in pictures:
        draw_curve(picture, points)
        yield picture


def _print(
    points: Sequence[CurvePoint], written: Sequence[Path], before: int, settings: TrackerSettings
) -> None:
    if settings.as_json:
        told = {
            "runs": settings.runs,
            "were_done": before,
            "points": [point.as_json() for point in points],
            "files": [str(path) for path in written],
        }
        say(json.dumps(finite(told)))
        return
    for line in curve_lines(points):
        say(line)
    for path in written:
        say(f"written: {path}")
    if before:
        say(f"{before} runs were done before")

"""`plotfeed sweep`: its runs handed out, kept as they are done, and what comes of them."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from math import ceil, log10
from pathlib import Path
from typing import Any

from plotfeed.feeds.console.extras import check_picture, need_extra
from plotfeed.feeds.console.printed import finite, say
from plotfeed.feeds.console.process import refuse_if_there
from plotfeed.feeds.scene.fields import Enu
from plotfeed.feeds.sweep.journal import NAME, Journal, keep_all, seed_of
from plotfeed.feeds.sweep.levels import SweepLevel, digests, levels_of, scene_of
from plotfeed.feeds.sweep.one_run import RunJob, RunPlan, run_once
from plotfeed.feeds.sweep.sweep_summary import LevelFigures, Results, figures_of, lines_of
from plotfeed.feeds.sweep.sweep_tables import (
    CSV,
    PARQUET,
    TABLES,
    check_suffix,
    table_of,
    usual_suffix,
    write_table,
)
from plotfeed.feeds.sweep.varied_keys import VariedKey
from plotfeed.proto.errors import PlotfeedError

PICTURE = "sweep.png"
CLASSES = 40
"""Of distance, at least, up to the furthest range."""
NOT_SENT = ("asterix", "http", "mqtt", "page", "sapient", "tak", "udp", "websocket")
"""Tables of a scene that make no difference where nothing is sent."""
NOT_FELT = (
    "bias.time_offset_s",
    "link.corrupt",
    "link.overhead_octets",
    "link.queue_messages",
    "link.rate_kbit_s",
    "report",
    "sac",
    "sic",
)
"""Ends of paths of keys that make none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepSettings:
    """What a sweep is asked to do, in the words of the command's options."""

    vary: Sequence[str]
    runs: int
    seed: int
    duration: float | None
    out: Path
    chart: Path | None
    protect: str | None
    """EAST,NORTH,UP of the site, metres; without it, the site."""
    alert_plots: int
    alert_within: float
    """Seconds."""
    processes: int | None
    ray: str | None
    force: bool
    as_json: bool

    @property
    def is_one_table(self) -> bool:
        """Whether one file is asked for, and not a folder."""
        return self.out.suffix in (PARQUET, CSV)

    @property
    def folder(self) -> Path:
        """Where the journal is; of one file it is hidden, and goes when that is written."""
        return self.out.with_name(f".{self.out.name}.sweep") if self.is_one_table else self.out

    def tables(self) -> dict[str, Path]:
        """Files of tables, by name."""
        if self.is_one_table:
            return {"runs": self.out}
        return {name: self.out / f"{name}{usual_suffix()}" for name in TABLES}

    def picture(self) -> Path | None:
        """The file of the chart, if there is one."""
        if self.chart is None and not self.is_one_table and find_spec("matplotlib"):
            return self.out / PICTURE
        return self.chart


def run_sweep(files: Sequence[Path], settings: SweepSettings) -> int:
    """Run what is not done yet, write tables and the chart; the exit code.

    Raises `PlotfeedError`, and `OSError`.
    """
    varied = [VariedKey.parse(text) for text in settings.vary]
    for key in varied:
        _check_felt(key.path)
    _check(settings)
    levels = levels_of(files, varied)
    plan = RunPlan(
        duration_s=settings.duration,
        protect_enu_m=place_of(settings.protect),
        alert_plots=settings.alert_plots,
        alert_within_s=settings.alert_within,
        bin_m=_class_m(levels),
    )
    journal = settings.folder / NAME
    if not journal.exists():
        for path in settings.tables().values():
            refuse_if_there(path, force=settings.force)
    with Journal(journal, _told(levels, varied, settings, plan), anew=settings.force) as kept:
        before = _run(kept, levels, settings, plan)
        done = kept.of_first(settings.runs)
        figures = figures_of(levels, done)
        written = list(_write(levels, figures, done, settings))
    if settings.is_one_table:
        shutil.rmtree(settings.folder)
    _print(levels, figures, written, before, settings)
    return 0


def place_of(text: str | None) -> Enu:
    """A place from the site, metres east, north and up; raises `PlotfeedError`."""
    if text is None:
        return 0.0, 0.0, 0.0
    try:
        east_m, north_m, *up_m = (float(part) for part in text.split(","))
        (height_m,) = up_m or [0.0]
    except ValueError:
        raise PlotfeedError(f"--protect {text}: expected EAST,NORTH or EAST,NORTH,UP") from None
    return east_m, north_m, height_m


def _check_felt(path: str) -> None:
    if path.partition(".")[0] in NOT_SENT or any(
        path == end or path.endswith(f".{end}") for end in NOT_FELT
    ):
        raise PlotfeedError(
            f"--vary {path}: a sweep sends no octets, so that it makes no difference there; "
            "plotfeed run and score send them"
        )
    if path in ("scene.seed", "scene.name"):
        raise PlotfeedError(f"--vary {path}: the sweep's own; --seed and --runs draw anew")


def _check(settings: SweepSettings) -> None:
    """Raise `PlotfeedError` for what would be known only after all runs."""
    if settings.is_one_table:
        check_suffix(settings.out)
        refuse_if_there(settings.out, force=settings.force)
    elif settings.out.exists() and not settings.out.is_dir():
        raise PlotfeedError(f"{settings.out}: expected a folder, or a name that ends in .parquet")
    if settings.chart is not None:
        check_picture(settings.chart)
        refuse_if_there(settings.chart, force=settings.force)
    if settings.ray is not None:
        if settings.processes is not None:
            raise PlotfeedError("--processes: the cluster of --ray has its own")
        need_extra("ray", "--ray", "fleet", load=False)


def _class_m(levels: Sequence[SweepLevel]) -> float:
    """A width of classes, 1, 2 or 5 times a power of ten, by the furthest range of all sensors."""
    most_m = max(sensor.range_max_m for level in levels for sensor in scene_of(level).sensor)
    power: float = 10.0 ** ceil(log10(most_m / CLASSES) - 1)
    return max(power * factor for factor in (1, 2, 5) if power * factor <= most_m / CLASSES)


def _told(
    levels: Sequence[SweepLevel],
    varied: Sequence[VariedKey],
    settings: SweepSettings,
    plan: RunPlan,
) -> dict[str, Any]:
    """What a journal must have begun with, by what the user calls it; more runs may be asked."""
    return {
        "plotfeed": version("plotfeed"),
        "scenes": digests(levels),
        "--vary": {key.path: list(key.values) for key in varied},
        "--seed": settings.seed,
        "--duration": settings.duration,
        "--protect": list(plan.protect_enu_m),
        "--alert-plots": plan.alert_plots,
        "--alert-within": plan.alert_within_s,
    }


def _run(
    kept: Journal, levels: Sequence[SweepLevel], settings: SweepSettings, plan: RunPlan
) -> int:
    """Do what is not done yet; how many runs were."""
    jobs = [
        RunJob(level=level, run=run, seed=seed_of(settings.seed, run), plan=plan)
        for level, run in kept.missing(levels, settings.runs)
    ]
    before = len(levels) * settings.runs - len(jobs)
    processes = processes_of(settings, len(jobs)) if jobs else 1
    keep_all(kept, run_once, jobs, before, address=settings.ray, processes=processes)
    return before


def processes_of(settings: SweepSettings, jobs: int) -> int | None:
    """Processes to be started here; None where a cluster has them."""
    if settings.ray is not None:
        return None
    if settings.processes is not None:
        return min(settings.processes, jobs)
    if not find_spec("ray"):
        say("plotfeed: one process, as ray is missing: pip install 'plotfeed[fleet]'", err=True)
        return 1
    return min(os.cpu_count() or 1, jobs)


def _write(
    levels: Sequence[SweepLevel],
    figures: Sequence[LevelFigures],
    done: Results,
    settings: SweepSettings,
) -> Iterator[Path]:
    for name, path in settings.tables().items():
        write_table(path, *table_of(name, levels, done))
        yield path
    picture = settings.picture()
    if picture is not None:
        from plotfeed.feeds.sweep.sweep_pictures import draw_sweep

        draw_sweep(picture, levels, figures, done)
        yield picture


def _print(
    levels: Sequence[SweepLevel],
    figures: Sequence[LevelFigures],
    written: Sequence[Path],
    before: int,
    settings: SweepSettings,
) -> None:
    if settings.as_json:
        told = {
            "levels": len(levels),
            "runs": settings.runs,
            "were_done": before,
            "figures": [each.as_json() for each in figures],
            "files": [str(path) for path in written],
        }
        say(json.dumps(finite(told)))
        return
    were = f", {before} of which were done" if before else ""
    say(f"{len(levels)} level(s), {settings.runs} run(s) of each{were}\n")
    for line in lines_of(figures):
        say(line)
    say("\nIn brackets: 95 % intervals, by the bootstrap over runs.")
    for path in written:
        say(f"written: {path}")
    if settings.picture() is None and not settings.is_one_table:
        say("no chart: pip install 'plotfeed[charts]'")

"""`plotfeed sweep` and `plotfeed score SCENE --tracker`: runs at levels, tables and curves."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from math import ceil, log10
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.console.extras import check_picture, need_extra
from plotfeed.feeds.console.printed import aligned, printable, say
from plotfeed.feeds.console.process import refuse_if_there
from plotfeed.feeds.lab.lab_settings import SweepSettings, TrackerSettings
from plotfeed.feeds.lab.pictures import (
    LEVELS_DRAWN,
    LevelAxis,
    draw_by_level,
    figure_of,
    finish,
    plain_text,
    save_picture,
    shades,
)
from plotfeed.feeds.lab.runs import (
    NAME,
    Journal,
    SweepLevel,
    VariedKey,
    digests,
    levels_of,
    scene_of,
)
from plotfeed.feeds.lab.runs import (
    finish as finish_runs,
)
from plotfeed.feeds.lab.scoring import FIGURE_NAMES, ScoreSettings
from plotfeed.feeds.lab.sweep import (
    ERRORS,
    TOGETHER,
    LevelFigures,
    Results,
    RunPlan,
    detection_by_distance,
    figures_of,
    interval_text,
    lines_of,
    run_once,
)
from plotfeed.feeds.lab.tables import (
    TABLES,
    check_suffix,
    level_columns,
    table_of,
    write_table,
)
from plotfeed.feeds.lab.trackers import (
    TrackerCommand,
    TrackerPlan,
    of_trackers,
    run_tracker,
)
from plotfeed.feeds.scene.fields import Enu
from plotfeed.models.bootstrap import Interval, mean_interval
from plotfeed.proto.errors import PlotfeedError

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
        for path in settings.tables(TABLES).values():
            refuse_if_there(path, force=settings.force)
    told = {
        "plotfeed": version("plotfeed"),
        "scenes": digests(levels),
        "--vary": {key.path: list(key.values) for key in varied},
        "--seed": settings.seed,
        "--duration": settings.duration,
        "--protect": list(plan.protect_enu_m),
        "--alert-plots": plan.alert_plots,
        "--alert-within": plan.alert_within_s,
    }
    with Journal(journal, told, anew=settings.force) as kept:
        before = finish_runs(kept, run_once, levels, settings, plan)
        done = kept.of_first(settings.runs)
        figures = figures_of(levels, done)
        for name, path in settings.tables(TABLES).items():
            write_table(path, *table_of(name, levels, done))
        picture = settings.picture()
        if picture is not None:
            draw_sweep(picture, levels, figures, done)
    if settings.is_one_table:
        shutil.rmtree(settings.folder)
    counts = {"levels": len(levels), "runs": settings.runs, "were_done": before}
    settings.tell(
        counts | {"figures": [each.as_json() for each in figures]},
        _sweep_lines(figures, counts),
        [*settings.tables(TABLES).values(), *([picture] if picture else [])],
    )
    if picture is None and not settings.is_one_table and not settings.as_json:
        say("no chart: pip install 'plotfeed[charts]'")
    return 0


def _sweep_lines(figures: Sequence[LevelFigures], counts: Mapping[str, int]) -> Iterator[str]:
    were = f", {counts['were_done']} of which were done" if counts["were_done"] else ""
    yield f"{counts['levels']} level(s), {counts['runs']} run(s) of each{were}\n"
    yield from lines_of(figures)
    yield "\nIn brackets: 95 % intervals, by the bootstrap over runs."


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


INCHES_WIDE, INCHES_A_ROW = 15.0, 3.7
MOST_SENSORS = 6
"""That are drawn."""
FEWEST_LOOKS = 5
"""In a class of distance that is drawn."""
UNITS = {"range_rms_m": "range, m", "azimuth_rms_deg": "azimuth, degrees"}
UNITS["elevation_rms_deg"] = "elevation, degrees"


def draw_sweep(
    path: Path, levels: Sequence[SweepLevel], figures: Sequence[LevelFigures], results: Results
) -> None:
    """Write the picture, in the format that its name says."""
    sensors = list(dict.fromkeys(each.sensor for each in figures if each.sensor is not None))
    shown, axis = sensors[:MOST_SENSORS], LevelAxis(levels)
    by = {(each.level.number, each.sensor): each for each in figures}
    size = INCHES_WIDE, INCHES_A_ROW * (1 + len(shown))
    with figure_of(size, _sweep_title(levels, figures, len(sensors) - len(shown))) as figure:
        grid = figure.subplots(1 + len(shown), 3, squeeze=False)
        _draw_figure(grid[0, 0], axis, by, None, ("Drones told of", "share", lambda f: f.alerted))
        _draw_figure(grid[0, 1], axis, by, None, ALERT)
        alarms = "False alarms", "in a run", lambda f: f.false_alarms
        _draw_figure(grid[0, 2], axis, by, None, alarms)
        for row, sensor in enumerate(shown, 1):
            _detection_by_distance(grid[row, 0], axis, levels, sensor, results)
            _draw_figure(grid[row, 1], axis, by, sensor, ALERT)
            error = _told_error(by, sensor)
            unit = f"rms of {UNITS[error]}"
            errors = "Error of plots", unit, lambda f, error=error: f.errors[error]
            _draw_figure(grid[row, 2], axis, by, sensor, errors)
        save_picture(figure, path)


ALERT = "Alert", "metres from what is protected", attrgetter("alert_distance_m")


def _told_error(by: Mapping[Any, LevelFigures], sensor: str) -> str:
    """The first error that the sensor has at all: those of bearings alone have none of range."""
    of = [each for (_, name), each in by.items() if name == sensor]
    told = (e for e in ERRORS if any(np.isfinite(each.errors[e].value) for each in of))
    return next(told, ERRORS[0])


def _draw_figure(
    axes: Any,
    axis: LevelAxis,
    by: Mapping[tuple[int, str | None], LevelFigures],
    sensor: str | None,
    what: tuple[str, str, Callable[[LevelFigures], Interval]],
) -> None:
    """A figure of a sensor: its title, its unit, and where it is found."""
    title, unit, told_by = what
    found = {number: told_by(each) for (number, name), each in by.items() if name == sensor}
    draw_by_level(axes, axis, found, f"{title}: {printable(sensor or TOGETHER)}", unit)


def _detection_by_distance(
    axes: Any, axis: LevelAxis, levels: Sequence[SweepLevel], sensor: str, results: Results
) -> None:
    step = max(1, -(-len(levels) // LEVELS_DRAWN))
    chosen, drawn = levels[::step], False
    for level, colour in zip(chosen, shades(len(chosen)), strict=True):
        found = detection_by_distance(level, sensor, results)
        begins_m = [m for m, (looks, _) in found.items() if looks >= FEWEST_LOOKS]
        if begins_m:
            drawn = True
            row = next(row for result in results.values() for row in result["distances"])
            half_m = float(row[2] - row[1]) / 2
            shares = [found[m][1] / found[m][0] for m in begins_m]
            middles_km = [(m + half_m) / 1000 for m in begins_m]
            axes.plot(middles_km, shares, ".-", color=colour, lw=1.1, label=axis.name(level))
    if drawn:
        axes.set_ylim(-0.03, 1.03)
        axes.set_xlim(left=0)
        axes.legend(frameon=False, fontsize=8.5)
    title = f"Detection: {printable(sensor)}"
    finish(axes, title, "true distance, km", "share of looks", drawn=drawn)


def _sweep_title(
    levels: Sequence[SweepLevel], figures: Sequence[LevelFigures], left_out: int
) -> str:
    names = ", ".join(dict.fromkeys(level.scene for level in levels))
    runs = max((each.runs for each in figures), default=0)
    more = f"; {left_out} more sensors, not drawn" if left_out else ""
    return plain_text(f"{names}: {len(levels)} levels of {runs} runs, bars 95 % over runs{more}")


SHOWN = {
    "gospa_m": ("GOSPA, m", ".1f"),
    "completeness": ("completeness", ".3f"),
    "spuriousness": ("spuriousness", ".3f"),
    "position_rms_m": ("position rms, m", ".1f"),
    "latency_p95_s": ("latency p95, s", ".2f"),
    "initiation_median_s": ("initiation, s", ".1f"),
}
"""Figures of the printed table and the picture, with their titles and how they are printed."""
INCHES = (15.0, 8.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class CurvePoint:
    """A tracker at one level: means over runs, with intervals."""

    level: SweepLevel
    tracker: str
    runs: int
    failures: Sequence[str]
    """How it failed in runs in which it did."""
    figures: Mapping[str, Interval]

    @classmethod
    def of(cls, level: SweepLevel, tracker: str, results: Results) -> CurvePoint:
        """The runs of a level, as its journal has them."""
        runs = [result for (number, _), result in results.items() if number == level.number]
        found = {}
        for name in SHOWN:
            values = [run["figures"][name] for run in runs]
            found[name] = mean_interval([np.nan if value is None else value for value in values])
        failures = [run["failure"] for run in runs if run["failure"]]
        return cls(level=level, tracker=tracker, runs=len(runs), failures=failures, figures=found)

    def as_json(self) -> dict[str, Any]:
        """Figures by name, as value, low and high."""
        changes = self.level.changes
        return {
            "tracker": self.tracker,
            "values": dict(zip((path for path, _ in changes), self.level.values, strict=True)),
            "runs": self.runs,
            "failures": list(self.failures),
            "figures": {name: figure._asdict() for name, figure in self.figures.items()},
        }


def curve_lines(points: Sequence[CurvePoint]) -> Iterator[str]:
    """Points as a table for people, and how trackers failed."""
    several = len({point.tracker for point in points}) > 1
    paths = [path for path, _ in points[0].level.changes]
    head = [*(["tracker"] if several else []), *paths, "runs", "failed"]
    rows = [[*head, *(title for title, _ in SHOWN.values())]]
    for point in points:
        row = [*([point.tracker] if several else []), *(v for _, v in point.level.changes)]
        row += [str(point.runs), str(len(point.failures))]
        rows.append(row + [interval_text(point.figures[name], SHOWN[name][1]) for name in SHOWN])
    left = len(paths) + several
    sides = "<" * left + ">" * (len(rows[0]) - left)
    yield from (line.rstrip() for line in aligned(rows, sides))
    yield ""
    yield "In brackets: 95 % intervals, by the bootstrap over runs."
    first: dict[str, str] = {}
    for point in points:
        for failure in point.failures:
            first.setdefault(failure, str(point.level))
    yield from (f"failed: {failure} ({where})" for failure, where in first.items())


def draw_curve(path: Path, points: Sequence[CurvePoint]) -> None:
    """Write the picture, in the format that its name says."""
    axis = LevelAxis([point.level for point in points])
    with figure_of(INCHES, _title(points)) as figure:
        for axes, (name, (title, _)) in zip(figure.subplots(2, 3).flat, SHOWN.items(), strict=True):
            found = {point.level.number: point.figures[name] for point in points}
            draw_by_level(axes, axis, found, title, "")
        save_picture(figure, path)


def _title(points: Sequence[CurvePoint]) -> str:
    names = ", ".join(dict.fromkeys(point.tracker for point in points))
    failed = sum(len(point.failures) for point in points)
    runs = sum(point.runs for point in points)
    more = f"; failed in {failed}" if failed else ""
    return plain_text(f"{names}: {runs} runs, bars 95 % over those of a level{more}")


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
    told = {
        "plotfeed": version("plotfeed"),
        "scenes": digests(of_scene),
        "--vary": [list(map(list, level.changes)) for level in of_scene],
        "--tracker": [[tracker.name, *tracker.words] for tracker in trackers],
        "--seed": settings.seed,
        "--duration": settings.duration,
        "--speed": settings.speed,
        "--topic": settings.topic,
        "settings of the score": asdict(how),
    }
    levels = of_trackers(of_scene, names)
    if not (settings.folder / NAME).exists():
        for path in settings.files():
            refuse_if_there(path, force=settings.force)
    plan = TrackerPlan(
        duration_s=settings.duration,
        speed=settings.speed,
        patience_s=settings.patience,
        topic=settings.topic,
        settings=how,
        trackers=trackers,
    )
    with Journal(settings.folder / NAME, told, anew=settings.force) as kept:
        before = finish_runs(kept, run_tracker, levels, settings, plan)
        done = kept.of_first(settings.runs)
        points = [CurvePoint.of(level, plan.of(level).name, done) for level in levels]
        _write_scores(levels, points, done, settings)
    counts = {"runs": settings.runs, "were_done": before}
    told = counts | {"points": [point.as_json() for point in points]}
    settings.tell(told, curve_lines(points), settings.files())
    if before and not settings.as_json:
        say(f"{before} runs were done before")
    return 1 if any(point.failures for point in points) else 0


def _write_scores(
    levels: Sequence[SweepLevel],
    points: Sequence[CurvePoint],
    done: Results,
    settings: TrackerSettings,
) -> None:
    own = {"failure": str, **dict.fromkeys(FIGURE_NAMES, float)}
    rows = [
        (key, [[run["failure"] or None, *(run["figures"][name] for name in FIGURE_NAMES)]])
        for key, run in sorted(done.items())
    ]
    table, *pictures = settings.files()
    first = "tracker" if len(settings.trackers) > 1 else "scene"
    write_table(table, *level_columns(levels, done, rows, own, first=first))
    for picture in pictures:
        draw_curve(picture, points)

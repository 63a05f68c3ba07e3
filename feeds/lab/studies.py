"""`plotfeed sweep` and `plotfeed score SCENE --tracker`: runs at levels, tables and curves."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from html import escape
from importlib.metadata import version
from math import ceil, log10
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from plotfeed.feeds.console.extras import check_picture, need_extra
from plotfeed.feeds.console.printed import finite, printable, say
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
    svg_of,
)
from plotfeed.feeds.lab.possible import POSSIBLE
from plotfeed.feeds.lab.runs import (
    NAME,
    Journal,
    SweepLevel,
    VariedKey,
    digests,
    levels_of,
    scene_of,
)
from plotfeed.feeds.lab.runs import finish as finish_runs
from plotfeed.feeds.lab.score import (
    LIMITS,
    NO_PROFILE,
    LimitVerdict,
    ScoreLimit,
    ScoreProfile,
    closing,
    judged_figure,
    junit_of,
    mark_of,
    page,
    write_new,
)
from plotfeed.feeds.lab.scoring import COUNTS, FIGURE_NAMES, ScoreSettings
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
    Table,
    check_suffix,
    level_columns,
    of_cells,
    table_of,
    write_table,
)
from plotfeed.feeds.lab.trackers import TrackerCommand, TrackerPlan, of_trackers, run_tracker
from plotfeed.feeds.scene.fields import Enu
from plotfeed.models.state import Floats
from plotfeed.models.verdicts import (
    POCOCK,
    RISK,
    Interval,
    breaking_level,
    look_risk,
    mean_interval,
    seeds_interval,
)
from plotfeed.proto.errors import PlotfeedError

# Of distance, at least, up to the furthest range.
CLASSES = 40
# Tables of a scene that make no difference where nothing is sent.
NOT_SENT = ("asterix", "http", "mqtt", "page", "sapient", "tak", "udp", "websocket")
# Ends of paths of keys that make none.
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


def run_sweep(files: Sequence[Path], settings: SweepSettings) -> int:
    """Run what is not done yet, write tables and the chart; the exit code.

    Raises `PlotfeedError`, and `OSError`.
    """
    varied = [VariedKey.parse(text) for text in settings.vary]
    for key in varied:
        _check_felt(key.path)
    _check(settings)
    levels = levels_of(files, varied)
    # Classes of distance are 1, 2 or 5 times a power of ten wide, by the furthest range of all.
    widest_m = max(s.range_max_m for level in levels for s in scene_of(level).sensor) / CLASSES
    power: float = 10.0 ** ceil(log10(widest_m) - 1)
    plan = RunPlan(
        duration_s=settings.duration,
        protect_enu_m=place_of(settings.protect),
        alert_plots=settings.alert_plots,
        alert_within_s=settings.alert_within,
        bin_m=max(power * factor for factor in (1, 2, 5) if power * factor <= widest_m),
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
        before = len(kept.of_first(settings.runs))
        finish_runs(kept, run_once, levels, settings, plan, runs=settings.runs)
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
    were = f", {before} of which were done" if before else ""
    settings.tell(
        counts | {"figures": [each.as_json() for each in figures]},
        (
            f"{len(levels)} level(s), {settings.runs} run(s) of each{were}\n",
            *lines_of(figures),
            "\nIn brackets: 95 % intervals, by the bootstrap over runs.",
        ),
        [*settings.tables(TABLES).values(), *([picture] if picture else [])],
    )
    if picture is None and not settings.is_one_table and not settings.as_json:
        say("no chart: pip install 'plotfeed[charts]'")
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


INCHES_WIDE, INCHES_A_ROW = 15.0, 3.7
# That are drawn.
MOST_SENSORS = 6
# In a class of distance that is drawn.
FEWEST_LOOKS = 5
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
    names = ", ".join(dict.fromkeys(level.scene for level in levels))
    runs = max((each.runs for each in figures), default=0)
    more = f"; {left} more sensors, not drawn" if (left := len(sensors) - len(shown)) else ""
    title = f"{names}: {len(levels)} levels of {runs} runs, bars 95 % over runs{more}"
    with figure_of(size, plain_text(title)) as figure:
        grid = figure.subplots(1 + len(shown), 3, squeeze=False)
        _draw_figure(grid[0, 0], axis, by, None, ("Drones told of", "share", lambda f: f.alerted))
        _draw_figure(grid[0, 1], axis, by, None, ALERT)
        alarms = "False alarms", "in a run", lambda f: f.false_alarms
        _draw_figure(grid[0, 2], axis, by, None, alarms)
        for row, sensor in enumerate(shown, 1):
            _detection_by_distance(grid[row, 0], axis, levels, sensor, results)
            _draw_figure(grid[row, 1], axis, by, sensor, ALERT)
            # The first error that the sensor has: those of bearings alone have none of range.
            own = [each for (_, name), each in by.items() if name == sensor]
            told = (e for e in ERRORS if any(np.isfinite(each.errors[e].value) for each in own))
            error = next(told, ERRORS[0])
            unit = f"rms of {UNITS[error]}"
            errors = "Error of plots", unit, lambda f, error=error: f.errors[error]
            _draw_figure(grid[row, 2], axis, by, sensor, errors)
        save_picture(figure, path)


ALERT = "Alert", "metres from what is protected", attrgetter("alert_distance_m")


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


# Figures of the printed table and the picture, with their titles and how they are printed: as known
# at the time, so that lateness costs.
SHOWN = {
    "known_gospa_m": ("GOSPA, m", ".1f"),
    "gospa_feed_m": ("by feed", ".1f"),
    "gospa_link_m": ("by link", ".1f"),
    "gospa_tracker_m": ("by tracker", ".1f"),
    "known_completeness": ("completeness", ".3f"),
    "known_spuriousness": ("spuriousness", ".3f"),
    "known_position_accuracy_m": ("mean error, m", ".1f"),
    "latency_p95_s": ("latency p95, s", ".2f"),
    "initiation_median_s": ("initiation, s", ".1f"),
}
INCHES = (15.0, 11.0)
# A machine that is later than this, or than such a share of what is varied, tells of itself.
LATE_S, LATE_SHARE = 0.1, 0.1
# Of which verdicts the risk is told: those of all levels together are wrong more often.
AT_A_LEVEL = "at each level "


class CurvePoint(NamedTuple):
    """A tracker at one level: means over runs, with intervals, and verdicts on the limits."""

    level: SweepLevel
    tracker: str
    runs: int
    failures: Sequence[str]  # How it failed in runs in which it did
    unscored: Sequence[str]  # Why there was nothing to score, in runs without a drone in cover
    late_s: float  # By how much the machine itself was late
    figures: Mapping[str, Interval]
    limits: Floats  # Figures of limits, (limits, runs)
    verdicts: Sequence[LimitVerdict]

    @classmethod
    def of(
        cls, level: SweepLevel, tracker: str, results: Results, asked: Sequence[ScoreLimit],
        looks: int,
    ) -> CurvePoint:  # fmt: skip
        """The runs of a level, as its journal has them, judged at each of so many looks."""
        runs = [result for (number, _), result in results.items() if number == level.number]

        def column(of: str, name: Any) -> Floats:
            return np.array([run[of][name] for run in runs], np.float64)

        limits = np.array([column("limits", n) for n in range(len(asked))]).reshape(-1, len(runs))
        risk = look_risk(looks, RISK / max(len(asked), 1))
        verdicts = []
        for n, (limit, values) in enumerate(zip(asked, limits, strict=True)):
            figure = judged_figure(limit, is_known=True)
            is_count = figure.removeprefix("known_").removeprefix("space_") in COUNTS
            found = seeds_interval(values, risk, column("trials", n), are_counts=is_count)
            verdicts.append(LimitVerdict.of_interval(limit, figure, found, len(runs), "many runs"))
        return cls(
            level,
            tracker,
            len(runs),
            [run["failure"] for run in runs if run["failure"]],
            [run["unscored"] for run in runs if run.get("unscored")],
            float(np.mean([run["late_s"] for run in runs])) if runs else np.nan,
            {name: mean_interval(column("figures", name)) for name in SHOWN},
            limits,
            verdicts,
        )

    @property
    def is_scored(self) -> bool:
        """Whether there was anything to score in any run."""
        return len(self.unscored) < self.runs

    @property
    def is_decided(self) -> bool:
        """Whether more runs would change no verdict."""
        is_known = self.is_scored and bool(self.verdicts)
        return is_known and all(v.status != "undecided" for v in self.verdicts)

    def as_json(self) -> dict[str, Any]:
        """Figures by name, as value, low and high."""
        return {
            "tracker": self.tracker,
            "values": self.level.by_path(),
            "runs": self.runs,
            "failures": list(self.failures),
            "unscored": list(self.unscored),
            "late_s": self.late_s,
            "figures": {name: figure._asdict() for name, figure in self.figures.items()},
            "limits": [asdict(verdict) for verdict in self.verdicts],
        }


@dataclass(frozen=True, kw_only=True)
class Survival:
    """Up to which level a tracker keeps a limit."""

    limit: str
    tracker: str
    key: str
    others: str  # What else is so on the way
    level: Interval
    # By how much the machine was late on the way, where that is too much to tell the level.
    late_s: float

    def __str__(self) -> str:
        where = f" ({self.others})" if self.others else ""
        head = f"{self.tracker}, {self.limit}{where}:"
        if self.late_s:
            return f"{head} not told: the machine itself was late by {self.late_s:.2g} s"
        value, low, high = (
            "no level" if x == -np.inf else "all levels" if x == np.inf else f"{x:.4g}"
            for x in self.level
        )
        if not np.isfinite(self.level.value):
            return f"{head} holds at {value} of {self.key} ({low} to {high})"
        return f"{head} holds to {value} of {self.key} ({low} to {high})"


def survivals(points: Sequence[CurvePoint], asked: Sequence[ScoreLimit]) -> Iterator[Survival]:
    """Breaking levels of each limit and tracker, along the first key of numbers that is varied."""
    for tracker in dict.fromkeys(point.tracker for point in points):
        own = (point for point in points if point.tracker == tracker and point.is_scored)
        of = {point.level.number: point for point in own}
        axis = LevelAxis([point.level for point in of.values()]) if len(of) > 1 else None
        if axis is None or axis.key is None:
            continue
        for others, levels in axis.lines.items():
            on = [of[level.number] for level in levels]
            at = np.array([axis.at(level) for level in levels])
            late_s = max(point.late_s for point in on)
            unit_s = 1e-3 if axis.title.endswith("_ms") else 1.0 if axis.title.endswith("_s") else 0
            may_s = LATE_SHARE * float(np.ptp(at)) * unit_s or LATE_S
            runs = min(point.runs for point in on)
            for n, limit in enumerate(asked):
                bound = limit.at_least if limit.at_most is None else limit.at_most
                values = np.array([point.limits[n, :runs] for point in on])
                yield Survival(
                    limit=limit.title,
                    tracker=tracker,
                    key=axis.title,
                    others=others,
                    level=breaking_level(at, values, bound or 0.0, rises=limit.at_most is not None),
                    late_s=late_s if late_s > may_s else 0.0,
                )


def curve_table(points: Sequence[CurvePoint]) -> Table:
    """Points as a table."""
    several = len({point.tracker for point in points}) > 1
    paths = [path for path, _ in points[0].level.changes]
    head = [*(["tracker"] if several else []), *paths, "runs", "failed"]
    rows = []
    for point in points:
        row = [*([point.tracker] if several else []), *(v for _, v in point.level.changes)]
        row += [str(point.runs), str(len(point.failures))]
        rows.append(row + [interval_text(point.figures[name], SHOWN[name][1]) for name in SHOWN])
    left = len(paths) + several
    heads = [*head, *(title for title, _ in SHOWN.values())]
    sides = "<" * left + ">" * (len(heads) - left)
    title = "Scores as known at the time; in brackets 95 % intervals, by the bootstrap over runs"
    return Table(title, of_cells(heads, sides), rows)


def limit_table(points: Sequence[CurvePoint]) -> Table:
    """Verdicts at all levels."""
    rows = [
        (str(point.level), *(column.cell(verdict) for column in LIMITS))
        for point in points
        for verdict in point.verdicts
    ]
    sides = "".join(">" if column.form else "<" for column in LIMITS)
    columns = of_cells(["at", *(column.head for column in LIMITS)], f"<{sides}")
    return Table("Limits at each level", columns, rows)


def curve_lines(points: Sequence[CurvePoint], survived: Sequence[Survival]) -> Iterator[str]:
    """Points as tables for people, what they survive, and how trackers failed."""
    yield from (line.rstrip() for line in curve_table(points).lines())
    if any(point.verdicts for point in points):
        yield from limit_table(points).lines()
    yield ""
    yield from map(str, survived)
    first: dict[str, str] = {}
    for point in points:
        if point.late_s > LATE_S:
            yield f"the machine itself was late by {point.late_s:.2g} s ({point.level})"
        if point.unscored:
            of = f"{len(point.unscored)} of {point.runs} runs"
            yield f"nothing was scored in {of}: {point.unscored[0]} ({point.level})"
        for failure in point.failures:
            first.setdefault(failure, str(point.level))
    yield from (f"failed: {failure} ({where})" for failure, where in first.items())


@contextmanager
def curve_figure(points: Sequence[CurvePoint]) -> Iterator[Any]:
    """The picture."""
    axis = LevelAxis([point.level for point in points])
    names = ", ".join(dict.fromkeys(point.tracker for point in points))
    failed, runs = sum(len(point.failures) for point in points), sum(p.runs for p in points)
    more = f"; failed in {failed}" if failed else ""
    title = f"{names}: {runs} runs, bars 95 % over those of a level{more}"
    with figure_of(INCHES, plain_text(title)) as figure:
        for axes, (name, (title, _)) in zip(figure.subplots(3, 3).flat, SHOWN.items(), strict=True):
            found = {point.level.number: point.figures[name] for point in points}
            draw_by_level(axes, axis, found, title, "")
        yield figure


def score_tracker(
    scene: Path, settings: TrackerSettings, how: ScoreSettings, profile: ScoreProfile | None = None
) -> int:
    """Run what is not done yet, write the table and the pictures; the exit code.

    With a profile, levels at which all its limits are decided take no more runs, which is looked at
    after each fifth of those asked for. The code is 1 where a tracker failed in any run, or a limit
    is broken at any level. Raises `PlotfeedError`, and `OSError`.
    """
    trackers = [TrackerCommand.parse(text) for text in settings.trackers]
    names = [tracker.name for tracker in trackers]
    if len(set(names)) < len(names):
        raise PlotfeedError("--tracker: several need names of their own: NAME=COMMAND")
    if settings.ray is not None:
        need_extra("ray", "--ray", "fleet", load=False)
    of_scene = levels_of([scene], [VariedKey.parse(text) for text in settings.vary])
    asked = [] if profile is None else profile.limit
    told = {
        "plotfeed": version("plotfeed"),
        "scenes": digests(of_scene),
        "--vary": [list(map(list, level.changes)) for level in of_scene],
        "--tracker": [[tracker.name, *tracker.words] for tracker in trackers],
        "--seed": settings.seed,
        "--duration": settings.duration,
        "--speed": settings.speed,
        "--topic": settings.topic,
        "--profile": [limit.model_dump() for limit in asked],
        "settings of the score": how.model_dump(),
    }
    levels = of_trackers(of_scene, names)
    given = [path for path in (settings.out, settings.junit) if path is not None]
    is_new = not (settings.folder / NAME).exists()
    for path in [*given, *(settings.files() if is_new else [])]:
        refuse_if_there(path, force=settings.force)
    if settings.out is not None:
        need_extra("matplotlib.figure", "a chart", "charts")
    plan = TrackerPlan(
        duration_s=settings.duration,
        speed=settings.speed,
        patience_s=settings.patience,
        topic=settings.topic,
        settings=how,
        limits=asked,
        trackers=trackers,
    )
    looks = min(len(POCOCK), settings.runs) if asked else 1

    def points_by(runs: int) -> list[CurvePoint]:
        done = kept.of_first(runs)
        return [CurvePoint.of(lv, plan.of(lv).name, done, asked, looks) for lv in levels]

    with Journal(settings.folder / NAME, told, anew=settings.force) as kept:
        before, open_levels = len(kept.of_first(settings.runs)), levels
        decided_by: dict[int, CurvePoint] = {}
        for look in range(1, looks + 1):
            runs = -(-settings.runs * look // looks)
            finish_runs(kept, run_tracker, open_levels, settings, plan, runs=runs)
            now = {p.level.number: p for p in points_by(runs) if p.level in open_levels}
            decided_by |= now
            open_levels = [level for level in open_levels if not now[level.number].is_decided]
            if not open_levels:
                break
        points = [decided_by[level.number] for level in levels]
        if not any(point.is_scored for point in points):
            raise PlotfeedError(points[0].unscored[0])
        done = {
            key: run for key, run in kept.of_first(settings.runs).items()
            if key[1] < decided_by[key[0]].runs
        }  # fmt: skip
        _write_scores(levels, points, done, settings)
    survived = list(survivals(points, asked))
    failures = [failure for point in points for failure in point.failures]
    verdicts = [
        replace(verdict, name=f"{verdict.name} ({point.level})")
        for point in points
        for verdict in point.verdicts
    ]
    _write_verdicts(points, survived, verdicts, profile, settings)
    counts = {"runs": settings.runs, "were_done": before}
    told = counts | {
        "points": [point.as_json() for point in points],
        "survives": [asdict(each) | {"level": each.level._asdict()} for each in survived],
    }
    lines = [*curve_lines(points, survived)]
    if verdicts and not failures:
        lines.append(closing("", verdicts, AT_A_LEVEL))
    settings.tell(told, lines, [*settings.files(), *given])
    if before and not settings.as_json:
        say(f"{before} runs were done before")
    return 1 if failures or mark_of("", verdicts) == "broken" else 0


def _write_scores(
    levels: Sequence[SweepLevel],
    points: Sequence[CurvePoint],
    done: Results,
    settings: TrackerSettings,
) -> None:
    names = [*FIGURE_NAMES, *POSSIBLE]
    own = {"failure": str, "late_s": float, **dict.fromkeys(names, float)}
    rows = [
        (
            key,
            [[run["failure"] or None, run["late_s"], *finite([run["figures"][n] for n in names])]],
        )
        for key, run in sorted(done.items())
    ]
    table, *pictures = settings.files()
    first = "tracker" if len(settings.trackers) > 1 else "scene"
    write_table(table, *level_columns(levels, done, rows, own, first=first))
    for picture in pictures:
        with curve_figure(points) as figure:
            save_picture(figure, picture)


def _write_verdicts(
    points: Sequence[CurvePoint],
    survived: Sequence[Survival],
    verdicts: Sequence[LimitVerdict],
    profile: ScoreProfile | None,
    settings: TrackerSettings,
) -> None:
    """The page for who signs, and JUnit's file."""
    title = NO_PROFILE if profile is None else profile.profile.title
    failure = next((failure for point in points for failure in point.failures), "")
    if settings.junit is not None:
        write_new(settings.junit, junit_of(title, verdicts, failure, 0.0), force=settings.force)
    if settings.out is not None:
        parts = [f"<p>{escape(printable(str(each)))}</p>\n" for each in survived]
        parts += [limit_table(points).html()] if verdicts else []
        with curve_figure(points) as figure:
            parts += [svg_of(figure), curve_table(points).html()]
        told = closing(failure, verdicts, AT_A_LEVEL), mark_of(failure, verdicts)
        text = page(printable(f"Trackers: {title}"), *told, parts)
        write_new(settings.out, text, force=settings.force)

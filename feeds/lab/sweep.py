"""`plotfeed sweep`: runs in simulated time at levels of a scene's keys, their figures and chart."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import chain
from math import ceil, isfinite, log10
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.console.extras import check_picture, need_extra
from plotfeed.feeds.console.printed import aligned, printable, say
from plotfeed.feeds.console.process import refuse_if_there
from plotfeed.feeds.engine.simulation import SimulatedSensor, Simulation, simulate
from plotfeed.feeds.lab import pictures
from plotfeed.feeds.lab.lab_settings import SweepSettings, tell
from plotfeed.feeds.lab.runs import NAME, Journal, RunJob, digests, finish_runs
from plotfeed.feeds.lab.tables import Table, TextColumn, check_suffix, write_table
from plotfeed.feeds.link.uplink import Uplink
from plotfeed.feeds.messages.message import HELD_NS, Message
from plotfeed.feeds.scene.changes import changed, in_force, instants_ns
from plotfeed.feeds.scene.fields import Enu, site_frame
from plotfeed.feeds.scene.levels import SweepLevel, levels_of, scene_of
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.varied_keys import VariedKey
from plotfeed.models.frames import wrap_180
from plotfeed.models.state import FALSE_ALARM, OTHER, Bools, Floats, Ints
from plotfeed.models.tracks import NEVER, enough_ns
from plotfeed.models.verdicts import NOTHING, Interval, mean_interval, ratio_interval
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

START_UTC_NS = 1_767_225_600 * NS  # 2026-01-01T00:00:00Z: when scenes begin that do not say when
USUAL_S = 60.0  # How long runs last of scenes that do not say for how long
Row = list[Any]

SENSOR_COLUMNS: Mapping[str, type] = {
    "sensor": str,
    "looks": int,
    "expected": float,
    "detected": int,
    "plots": int,
    "false_alarms": int,
    "arrived": int,
    "delay_ms": float,
    "range_rms_m": float,
    "azimuth_rms_deg": float,
    "elevation_rms_deg": float,
    "drones": int,
    "alerted": int,
    "alert_distance_m": float,
}
DRONE_COLUMNS: Mapping[str, type] = {
    "sensor": str,
    "drone": str,
    "looks": int,
    "detected": int,
    "first_s": float,
    "first_distance_m": float,
    "alert_s": float,
    "alert_distance_m": float,
}
DISTANCE_COLUMNS: Mapping[str, type] = {
    "sensor": str,
    "from_m": float,
    "to_m": float,
    "looks": int,
    "expected": float,
    "detected": int,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class RunPlan:
    """What runs of all levels have in common."""

    duration_s: float | None  # Seconds; None is as long as each scene says
    protect_enu_m: Enu  # The place that is protected, from the site: distances of alerts are to it
    alert_plots: int  # How many plots of a drone are an alert
    alert_within_s: float  # Seconds within which they must arrive
    bin_m: float  # Width of the classes of distance


def span_of(scene: Scene, duration_s: float | None) -> tuple[int, float]:
    """When runs of a scene begin, UTC in nanoseconds, and how many seconds they last."""
    told = scene.scene
    start_utc_ns = START_UTC_NS if told.start_utc_ns is None else told.start_utc_ns
    return start_utc_ns, duration_s or told.duration_s or USUAL_S


def run_once(job: RunJob) -> dict[str, Any]:
    """Rows of a run for each table, as JSON holds them; raises `PlotfeedError`."""
    scene, plan = scene_of(job.level), job.plan
    start_ns, duration_s = span_of(scene, plan.duration_s)
    found = simulate(scene, duration_s, seed=job.seed, start_utc_ns=start_ns)
    end_ns = start_ns + round(duration_s * NS)
    figures = _RunFigures(scene, plan, found, end_ns)
    for seen in found.values():
        figures.take(seen, arrivals_ns(seen, job.seed, start_ns))
    figures.take_together()
    rows = {"sensors": figures.sensors, "drones": figures.drones, "distances": figures.distances}
    return {"level": job.level.number, "run": job.run, "seed": job.seed} | rows


def arrivals_ns(seen: SimulatedSensor, seed: int, start_ns: int) -> Ints:
    """When the message of each sector leaves its sensor's link, (m,); `NEVER` if it is lost.

    A message a sector, due at its end, without octets: the link's delays, losses, order and
    outages count, and changes of it by events, as in a session of a sensor with one format.
    """
    sensor, due_ns = seen.sensor, seen.sectors.end_ns
    links: list[tuple[int, LinkSettings | None]] = [
        (start_ns + after_ns, changed(sensor, *in_force(sensor.event, after_ns)).link)
        for after_ns in instants_ns(sensor.event)
    ]
    if sensor.link is None and all(link is None for _, link in links):
        return due_ns
    uplink, later = Uplink(_without_octets(sensor.link), seed, sensor.id), [*reversed(links)]
    left: list[Message] = []
    for t_utc_ns in due_ns.tolist():
        while later and later[-1][0] <= t_utc_ns:
            at_ns, link = later.pop()
            left += uplink.change(_without_octets(link), at_ns)
        left += uplink.passed([Message("", b"", "", t_utc_ns)])
    found = np.full(len(due_ns), NEVER, np.int64)
    for one in left:
        if not one.fate and one.leaves_utc_ns != HELD_NS:
            found[one.number] = min(found[one.number], one.leaves_utc_ns)
    return found


def _without_octets(link: LinkSettings | None) -> LinkSettings | None:
    octets = {"rate_kbit_s": None, "corrupt": 0.0}
    return None if link is None else link.model_copy(update=octets)


class _RunFigures:
    """The rows of one run's tables, sensor by sensor, and of all sensors together."""

    def __init__(self, scene: Scene, plan: RunPlan, found: Simulation, end_ns: int) -> None:
        self.sensors: list[Row] = []
        self.drones: list[Row] = []
        self.distances: list[Row] = []
        self._plan, self._found, self._end_ns = plan, found, end_ns
        self._frame = site_frame(scene.scene.site)
        self._is_drone = np.array([OTHER not in name for name in found.drones], np.bool_)
        # Drones and times of plots that arrived, of each sensor.
        self._arrived: list[tuple[Ints, Ints]] = []
        self._totals = np.zeros(6)
        self._looks = np.zeros((2, len(found.drones)), np.int64)

    def take(self, seen: SimulatedSensor, arrival_ns: Ints) -> None:
        """Count what a sensor saw, and what of it arrived when."""
        looks, plots = seen.looks.rows(self._is_drone[seen.looks.drone]), seen.plots
        is_false = plots.drone == FALSE_ALARM
        is_hit: Bools = ~is_false
        is_hit[is_hit] = self._is_drone[plots.drone[is_hit]]
        sectors, count = seen.sectors, seen.sensor.scan.sectors
        numbers = sectors.scan * count + sectors.index
        sector = np.searchsorted(numbers, plots.scan * count + plots.sector)
        left_ns = arrival_ns[sector]
        is_there = left_ns <= self._end_ns
        delays_ns = (left_ns - sectors.end_ns[sector])[is_there]
        counts = [len(looks), looks.pd.sum(), looks.detected.sum(), len(plots)]
        counts += [is_false.sum(), is_there.sum()]
        self._totals += counts
        hits = plots.rows(is_hit)
        errors = [
            float(delays_ns.mean() / 1e6) if len(delays_ns) else None,
            _rms(hits.range_m - hits.true_range_m),
            _rms(wrap_180(hits.azimuth_deg - hits.true_azimuth_deg)),
            _rms(hits.elevation_deg - hits.true_elevation_deg),
        ]
        drones = looks.drone, looks.drone[looks.detected]
        by_drone = np.array([np.bincount(each, minlength=len(self._is_drone)) for each in drones])
        self._looks += by_drone
        self._arrived.append((plots.drone[is_hit & is_there], left_ns[is_hit & is_there]))
        self._add(seen.sensor.id, counts, errors, by_drone, self._arrived[-1])
        bin_m, number = self._plan.bin_m, (looks.range_m // self._plan.bin_m).astype(np.int64)
        of_bins = [np.bincount(number, weights) for weights in (None, looks.pd, looks.detected)]
        for i in np.flatnonzero(of_bins[0]).tolist():
            many, expected, detected = (of[i] for of in of_bins)
            told = [i * bin_m, (i + 1) * bin_m, int(many), float(expected), int(detected)]
            self.distances.append([seen.sensor.id, *told])

    def take_together(self) -> None:
        """Count what all sensors saw."""
        whose, when_ns = (np.concatenate([each[i] for each in self._arrived]) for i in (0, 1))
        self._add(None, self._totals, [None] * 4, self._looks, (whose, when_ns))

    def _add(
        self,
        sensor: str | None,
        counts: Any,
        errors: Sequence[float | None],
        by_drone: Ints,
        arrived: tuple[Ints, Ints],
    ) -> None:
        """Rows of a sensor, and of the drones that it looked at."""
        plan, n = self._plan, len(self._is_drone)
        within_ns = round(plan.alert_within_s * NS)
        first = self._told(enough_ns(*arrived, 1, 0, n))
        alert = self._told(enough_ns(*arrived, plan.alert_plots, within_ns, n))
        drones = np.flatnonzero(self._is_drone)
        alerted = int(np.isfinite(alert[0][drones]).sum())
        usual_m = float(np.median(np.nan_to_num(alert[1][drones]))) if len(drones) else None
        looks, expected, *rest = (float(count) for count in counts)
        row = [sensor, int(looks), expected, *map(int, rest), *errors]
        self.sensors.append([*row, len(drones), alerted, usual_m])
        seen = drones if sensor is None else drones[by_drone[0][drones] > 0]
        for i in seen.tolist():
            each = [float(column[i]) for column in (*first, *alert)]
            times = [value if np.isfinite(value) else None for value in each]
            self.drones.append([sensor, self._found.drones[i], *by_drone[:, i].tolist(), *times])

    def _told(self, t_utc_ns: Ints) -> tuple[Floats, Floats]:
        """Seconds after the beginning, and how far each drone then was from what is protected.

        NaN where it never was so, or the drone was there no more.
        """
        after_s, distance_m = np.full((2, len(t_utc_ns)), np.nan)
        which = np.flatnonzero(t_utc_ns != NEVER)
        if len(which):
            places_m = self._frame.from_ecef(self._found.place_ecef_m(which, t_utc_ns[which]))
            away_m = np.linalg.norm(places_m - np.array(self._plan.protect_enu_m), axis=1)
            there = which[np.isfinite(away_m)]
            distance_m[there] = away_m[np.isfinite(away_m)]
            after_s[there] = (t_utc_ns[there] - self._found.start_utc_ns) / NS
        return after_s, distance_m


def _rms(errors: Floats) -> float | None:
    errors = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else None


Results = Mapping[tuple[int, int], Mapping[str, Any]]  # Of runs, by level and run
TOGETHER = "all"  # What tables for people call all sensors together
ERRORS = ("range_rms_m", "azimuth_rms_deg", "elevation_rms_deg")
# Figures of a level by name: their titles and forms, with % for shares.
SHOWN = {
    "pd": ("Pd", ".3f"),
    "alerted": ("alerted, %", "%"),
    "alert_distance_m": ("alert at, m", ".0f"),
    "alert_change_m": ("change, m", "+.0f"),
    "false_alarms": ("false alarms", ".2f"),
    "range_rms_m": ("range, m", ".3g"),
    "azimuth_rms_deg": ("azimuth, deg", ".3g"),
    "elevation_rms_deg": ("elevation", ".3g"),
}


class LevelFigures:
    """One sensor at one level, or all together, in runs; intervals are over these.

    `figures` has the share of looks at drones that detected them, false alarms in a run, the share
    of drones with an alert, the mean of runs of the median distance at the alert (0 of a drone
    without one), how much that is more than at the first level, run by run with the same seed, and
    root mean squares of errors of plots.
    """

    def __init__(
        self,
        level: SweepLevel,
        sensor: str | None,
        rows: Mapping[int, Sequence[Any]],
        first: Mapping[int, Sequence[Any]] | None,
    ) -> None:
        """`rows` are by runs, and `first` those of the first level."""
        of, before = _columns_of(rows), None if first is None else _columns_of(first)
        self.level, self.runs = level, len(rows)
        self.sensor = sensor  # None of all together
        looks, plots = of["looks"].sum(), of["plots"].sum()
        self.expected_pd = float(of["expected"].sum() / looks) if looks else np.nan
        # Share of plots that passed the link before the end.
        self.arrived = float(of["arrived"].sum() / plots) if plots else np.nan
        change = NOTHING
        if before is not None and first is not None and first.keys() == rows.keys():
            change = mean_interval(of["alert_distance_m"] - before["alert_distance_m"])
        self.figures = {
            "pd": ratio_interval(of["detected"], of["looks"]),
            "false_alarms": mean_interval(of["false_alarms"]),
            "alerted": ratio_interval(of["alerted"], of["drones"]),
            "alert_distance_m": mean_interval(of["alert_distance_m"]),
            "alert_change_m": change,
        }
        for name in ERRORS:  # of all plots of all runs, as far as they are known
            many = np.where(np.isnan(of[name]), 0.0, of["detected"])
            squares = ratio_interval(of[name] ** 2 * of["detected"], many)
            self.figures[name] = Interval(*np.sqrt(squares).tolist())

    def as_json(self) -> dict[str, Any]:
        """Figures by name, intervals as value, low and high."""
        return {
            "level": self.level.number,
            "scene": self.level.scene,
            "values": self.level.by_path(),
            "sensor": self.sensor,
            "runs": self.runs,
            "expected_pd": self.expected_pd,
            "arrived": self.arrived,
            **{name: interval._asdict() for name, interval in self.figures.items()},
        }


def _columns_of(rows: Mapping[int, Sequence[Any]]) -> dict[str, Floats]:
    """What a sensor's rows of runs hold, by the name of the column."""
    columns = np.array([*rows.values()], np.float64).T
    return dict(zip(list(SENSOR_COLUMNS)[1:], columns, strict=True))


def figures_of(levels: Sequence[SweepLevel], results: Results) -> list[LevelFigures]:
    """Figures of every level that has a run: of all sensors together, and then of each."""
    rows: dict[tuple[int, str | None], dict[int, list[Any]]] = {}  # By level and sensor, by run
    for (number, run), result in sorted(results.items()):
        for sensor, *row in result["sensors"]:
            rows.setdefault((number, sensor), {})[run] = row
    by_number = {level.number: level for level in levels}
    found = [
        LevelFigures(by_number[number], sensor, of, rows.get((levels[0].number, sensor)))
        for (number, sensor), of in rows.items()
    ]
    return sorted(found, key=lambda each: (each.level.number, each.sensor is not None))


def key_columns(rows: Sequence[Any], first: TextColumn) -> list[TextColumn]:
    """Columns of rows that have a level: of each key's value, and before these `first`.

    That one is left out where it is the same throughout.
    """

    def key(n: int) -> Callable[[Any], str]:
        return lambda row: str(row.level.changes[n][1])

    paths = [path for path, _ in rows[0].level.changes] if rows else []
    keys = [TextColumn(path, key(n)) for n, path in enumerate(paths)]
    return [*([first] if len(set(map(first.cell, rows))) > 1 else []), *keys]


def figure_columns(shown: Mapping[str, tuple[str, str]]) -> list[TextColumn]:
    """Columns of rows that have figures with intervals, by the names of those that are shown."""

    def figure(name: str, form: str) -> Callable[[Any], str]:
        return lambda row: interval_text(row.figures[name], form)

    return [TextColumn(title, figure(n, form), "s") for n, (title, form) in shown.items()]


def interval_text(figure: Interval, form: str) -> str:
    """A figure as people read it, % for a share in percent, with its interval in brackets."""
    if not isfinite(figure.value):
        return "-"
    form, factor = (".1f", 100.0) if form == "%" else (form, 1.0)
    value, low, high = (f"{number * factor:{form}}" for number in figure)
    return value if not isfinite(figure.low) or low == high else f"{value} ({low} to {high})"


# By name: where a run's result has its rows, and the columns of them.
TABLES: Mapping[str, tuple[str, Mapping[str, type]]] = {
    "runs": ("sensors", SENSOR_COLUMNS),
    "drones": ("drones", DRONE_COLUMNS),
    "distances": ("distances", DISTANCE_COLUMNS),
}


def level_rows(
    levels: Sequence[SweepLevel],
    results: Results,
    rows_of: Mapping[tuple[int, int], Sequence[Sequence[Any]]],
    own: Mapping[str, type],
    *,
    first: str = "scene",
) -> tuple[dict[str, type], list[Row]]:
    """What columns hold, and rows by level and run, with those of the level, run and seed before.

    `first` is what it is called that tells levels apart beside their keys.
    """
    kinds: dict[str, type] = {first: str}
    for n, (path, _) in enumerate(levels[0].changes):
        types = {type(level.values[n]) for level in levels}
        one = len(types) == 1 and types <= {bool, int}
        kinds[path] = next(iter(types)) if one else float if types <= {int, float} else str
    at, found = {level.number: level for level in levels}, []
    for key, rows in rows_of.items():
        level, result = at[key[0]], results[key]
        head: Row = [level.scene]
        for path, value in level.by_path().items():
            is_other = kinds[path] is str and not isinstance(value, str)
            head.append(json.dumps(value) if is_other else kinds[path](value))
        found += [[*head, result["run"], result["seed"], *row] for row in rows]
    return kinds | {"run": int, "seed": int} | dict(own), found


CLASSES = 40  # Of distance, at least, up to the furthest range
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
    _check(settings, varied)
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
            rows_of, own = TABLES[name]
            rows = {key: result[rows_of] for key, result in done.items()}
            write_table(path, *level_rows(levels, done, rows, own))
        picture = settings.picture()
        if picture is not None:
            draw_sweep(picture, levels, figures, done)
    if settings.is_one_table:
        shutil.rmtree(settings.folder)
    counts = {"levels": len(levels), "runs": settings.runs, "were_done": before}
    were = f", {before} of which were done" if before else ""
    columns = [
        *key_columns(figures, TextColumn("scene", "level.scene")),
        TextColumn("sensor", lambda each: each.sensor or TOGETHER, "s"),
        TextColumn("runs", "runs", "d"),
        *figure_columns(SHOWN),
    ]
    table = Table("", columns, figures)
    tell(
        counts | {"figures": [each.as_json() for each in figures]},
        (
            f"{len(levels)} level(s), {settings.runs} run(s) of each{were}\n",
            *map(str.rstrip, aligned([table.header, *table.cells()], table.sides)),
            "\nIn brackets: 95 % intervals, by the bootstrap over runs.",
        ),
        [*settings.tables(TABLES).values(), *([picture] if picture else [])],
        as_json=settings.as_json,
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


def _check(settings: SweepSettings, varied: Sequence[VariedKey]) -> None:
    """Raise `PlotfeedError` for what would be known only after all runs, or makes no difference."""
    for path in (key.path for key in varied):
        is_end = any(path == end or path.endswith(f".{end}") for end in NOT_FELT)
        if is_end or path.partition(".")[0] in NOT_SENT:
            raise PlotfeedError(
                f"--vary {path}: a sweep sends no octets, so that it makes no difference there; "
                "plotfeed run and score send them"
            )
        if path in ("scene.seed", "scene.name"):
            raise PlotfeedError(f"--vary {path}: the sweep's own; --seed and --runs draw anew")
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
MOST_SENSORS = 6  # That are drawn
FEWEST_LOOKS = 5  # In a class of distance that is drawn
DRAWN_ERRORS = ("rms of range, m", "rms of azimuth, degrees", "rms of elevation, degrees")


def draw_sweep(
    path: Path, levels: Sequence[SweepLevel], figures: Sequence[LevelFigures], results: Results
) -> None:
    """Write the picture, in the format that its name says."""
    sensors = list(dict.fromkeys(each.sensor for each in figures if each.sensor is not None))
    shown, axis = sensors[:MOST_SENSORS], pictures.LevelAxis(levels)
    size = INCHES_WIDE, INCHES_A_ROW * (1 + len(shown))
    names = ", ".join(dict.fromkeys(level.scene for level in levels))
    runs = max((each.runs for each in figures), default=0)
    more = f"; {left} more sensors, not drawn" if (left := len(sensors) - len(shown)) else ""
    title = f"{names}: {len(levels)} levels of {runs} runs, bars 95 % over runs{more}"
    with pictures.figure_of(size, pictures.plain_text(title)) as figure:
        grid = figure.subplots(1 + len(shown), 3, squeeze=False)

        def draw(row: int, column: int, what: str, unit: str, name: str) -> None:
            """A figure of the sensor of a row, or of all together in the first."""
            sensor = shown[row - 1] if row else None
            found = {f.level.number: f.figures[name] for f in figures if f.sensor == sensor}
            title = f"{what}: {printable(sensor or TOGETHER)}"
            pictures.draw_by_level(grid[row, column], axis, found, title, unit)

        draw(0, 0, "Drones told of", "share", "alerted")
        draw(0, 2, "False alarms", "in a run", "false_alarms")
        for row in range(1 + len(shown)):
            draw(row, 1, "Alert", "metres from what is protected", "alert_distance_m")
        for row, sensor in enumerate(shown, 1):
            _detection_by_distance(grid[row, 0], axis, levels, sensor, results)
            # The first error that the sensor has: those of bearings alone have none of range.
            own = [each.figures for each in figures if each.sensor == sensor]
            has = (n for n, e in enumerate(ERRORS) if any(isfinite(f[e].value) for f in own))
            first = next(has, 0)
            draw(row, 2, "Error of plots", DRAWN_ERRORS[first], ERRORS[first])
        pictures.save_picture(figure, path)


def _detection_by_distance(
    axes: Any, axis: pictures.LevelAxis, levels: Sequence[SweepLevel], sensor: str, results: Results
) -> None:
    chosen, drawn = levels[:: -(-len(levels) // pictures.LEVELS_DRAWN)], False
    for level, colour in zip(chosen, pictures.shades(len(chosen)), strict=True):
        runs = (run for (number, _), run in results.items() if number == level.number)
        counts: dict[float, Any] = {}  # Looks and detections, by the middle of a class of distance
        rows = chain.from_iterable(run["distances"] for run in runs)
        for name, from_m, to_m, looks, _, detected in rows:
            if name == sensor:
                middle_m = (from_m + to_m) / 2
                counts[middle_m] = counts.get(middle_m, 0) + np.array([looks, detected])
        told = {m: count for m, count in sorted(counts.items()) if count[0] >= FEWEST_LOOKS}
        if told:
            drawn = True
            shares = [detected / looks for looks, detected in told.values()]
            axes.plot(
                np.array([*told]) / 1000, shares, ".-", color=colour, lw=1.1, label=axis.name(level)
            )
    if drawn:
        axes.set_ylim(-0.03, 1.03)
        axes.set_xlim(left=0)
        axes.legend(frameon=False, fontsize=8.5)
    title = f"Detection: {printable(sensor)}"
    pictures.finish(axes, title, "true distance, km", "share of looks", drawn=drawn)

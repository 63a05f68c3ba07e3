"""Runs of a sweep in simulated time, and their figures: detections, alerts, errors, by sensor."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from plotfeed.feeds.console.printed import aligned
from plotfeed.feeds.engine.simulation import SimulatedSensor, Simulation, simulate
from plotfeed.feeds.lab.runs import RunJob, SweepLevel, scene_of
from plotfeed.feeds.link.impairment import HELD, Impairment
from plotfeed.feeds.scene.changes import changed, in_force, instants_ns
from plotfeed.feeds.scene.fields import Enu, site_frame
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.frames import wrap_180
from plotfeed.models.state import FALSE_ALARM, OTHER, Bools, Floats, Ints
from plotfeed.models.verdicts import NOTHING, Interval, mean_interval, ratio_interval
from plotfeed.proto.utc import NS

# 2026-01-01T00:00:00Z: when scenes begin that do not say when.
START_UTC_NS = 1_767_225_600 * NS
# How long runs last of scenes that do not say for how long.
USUAL_S = 60.0
NEVER = np.iinfo(np.int64).max
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
    passing = Impairment(_without_octets(sensor.link), seed, sensor.id)
    found = np.full(len(due_ns), NEVER, np.int64)
    held: list[int] = []
    later = iter([*links, (NEVER, None)])
    at_ns, link = next(later)

    def pass_on(i: int, t_utc_ns: int) -> None:
        outcome = passing.pass_on(t_utc_ns, 0)
        if outcome is HELD:
            if len(held) < passing.link.queue_messages:
                held.append(i)
        elif outcome.copies:
            found[i] = min(copy.due_utc_ns for copy in outcome.copies)

    for i, t_utc_ns in enumerate(due_ns.tolist()):
        while at_ns <= t_utc_ns:
            passing.change(_without_octets(link))
            again, held = held, []
            for waiting in again:
                pass_on(waiting, at_ns)
            at_ns, link = next(later)
        pass_on(i, t_utc_ns)
    return found


def _without_octets(link: LinkSettings | None) -> LinkSettings:
    octets = {"rate_kbit_s": None, "corrupt": 0.0}
    return LinkSettings() if link is None else link.model_copy(update=octets)


def enough_ns(drone: Ints, t_utc_ns: Ints, plots: int, within_ns: int, drones: int) -> Ints:
    """When each of so many drones has `plots` within that time, by rows (n,); else `NEVER`."""
    found = np.full(drones, NEVER, np.int64)
    order = np.lexsort((t_utc_ns, drone))
    drone, t_utc_ns = drone[order], t_utc_ns[order]
    last = slice(plots - 1, None)
    first = slice(0, max(len(drone) - plots + 1, 0))
    soon = (drone[last] == drone[first]) & (t_utc_ns[last] - t_utc_ns[first] <= within_ns)
    np.minimum.at(found, drone[last][soon], t_utc_ns[last][soon])
    return found


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
        looks = seen.looks.rows(self._is_drone[seen.looks.drone])
        plots = seen.plots
        is_hit: Bools = plots.drone != FALSE_ALARM
        is_hit[is_hit] = self._is_drone[plots.drone[is_hit]]
        sectors, count = seen.sectors, seen.sensor.scan.sectors
        sector = np.searchsorted(
            sectors.scan * count + sectors.index, plots.scan * count + plots.sector
        )
        left_ns = arrival_ns[sector]
        is_there = left_ns <= self._end_ns
        delays_ns = (left_ns - seen.sectors.end_ns[sector])[is_there]
        whose, when_ns = plots.drone[is_hit & is_there], left_ns[is_hit & is_there]
        counts = [len(looks), looks.pd.sum(), looks.detected.sum(), len(plots)]
        counts += [np.sum(plots.drone == FALSE_ALARM), is_there.sum()]
        self._totals += counts
        hits = plots.rows(is_hit)
        errors = [
            _rms(hits.range_m - hits.true_range_m),
            _rms(wrap_180(hits.azimuth_deg - hits.true_azimuth_deg)),
            _rms(hits.elevation_deg - hits.true_elevation_deg),
        ]
        delay_ms = float(delays_ns.mean() / 1e6) if len(delays_ns) else None
        n = len(self._is_drone)
        by_drone = np.bincount(looks.drone, minlength=n)
        detected = np.bincount(looks.drone[looks.detected], minlength=n)
        self._looks += [by_drone, detected]
        arrived = whose, when_ns
        self._arrived.append(arrived)
        self._add(seen.sensor.id, counts, [delay_ms, *errors], [by_drone, detected], arrived)
        self._add_distances(seen.sensor.id, looks.range_m, looks.pd, looks.detected)

    def take_together(self) -> None:
        """Count what all sensors saw."""
        whose, when_ns = (np.concatenate([each[i] for each in self._arrived]) for i in (0, 1))
        self._add(None, self._totals, [None] * 4, self._looks, (whose, when_ns))

    def _add(
        self,
        sensor: str | None,
        counts: Any,
        errors: Sequence[float | None],
        by_drone: Any,
        arrived: tuple[Ints, Ints],
    ) -> None:
        plan, n = self._plan, len(self._is_drone)
        first = self._told(enough_ns(*arrived, 1, 0, n))
        within_ns = round(plan.alert_within_s * NS)
        alert = self._told(enough_ns(*arrived, plan.alert_plots, within_ns, n))
        drones = np.flatnonzero(self._is_drone)
        alert_m = np.nan_to_num(alert[1][drones])
        looks, expected, *rest = (float(count) for count in counts)
        self.sensors.append(
            [
                sensor,
                int(looks),
                expected,
                *map(int, rest),
                *errors,
                len(drones),
                int(np.isfinite(alert[0][drones]).sum()),
                float(np.median(alert_m)) if len(drones) else None,
            ]
        )
        seen = drones if sensor is None else drones[by_drone[0][drones] > 0]
        for i in seen.tolist():
            each = [float(column[i]) for column in (*first, *alert)]
            times = [value if np.isfinite(value) else None for value in each]
            counted = [int(column[i]) for column in by_drone]
            self.drones.append([sensor, self._found.drones[i], *counted, *times])

    def _told(self, t_utc_ns: Ints) -> tuple[Floats, Floats]:
        """Seconds after the beginning, and how far each drone then was from what is protected.

        NaN where it never was so, or the drone was there no more.
        """
        after_s = np.full(len(t_utc_ns), np.nan)
        distance_m = after_s.copy()
        which = np.flatnonzero(t_utc_ns != NEVER)
        if len(which):
            places_m = self._frame.from_ecef(self._found.place_ecef_m(which, t_utc_ns[which]))
            away_m = np.linalg.norm(places_m - np.array(self._plan.protect_enu_m), axis=1)
            is_there = np.isfinite(away_m)
            distance_m[which[is_there]] = away_m[is_there]
            after_ns = t_utc_ns[which] - self._found.start_utc_ns
            after_s[which[is_there]] = after_ns[is_there] / NS
        return after_s, distance_m

    def _add_distances(self, sensor: str, range_m: Floats, pd: Floats, detected: Bools) -> None:
        if not len(range_m):
            return
        bin_m = self._plan.bin_m
        number = (range_m // bin_m).astype(np.int64)
        looks, expected, hits = (
            np.bincount(number, weights=weights) for weights in (None, pd, detected)
        )
        for i in np.flatnonzero(looks).tolist():
            edges = [i * bin_m, (i + 1) * bin_m]
            counts = [int(looks[i]), float(expected[i]), int(hits[i])]
            self.distances.append([sensor, *edges, *counts])


def _rms(errors: Floats) -> float | None:
    errors = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else None


# Of runs, by level and run.
Results = Mapping[tuple[int, int], Mapping[str, Any]]
# What tables for people call all sensors together.
TOGETHER = "all"
ERRORS = ("range_rms_m", "azimuth_rms_deg", "elevation_rms_deg")


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelFigures:
    """One sensor at one level, or all together; intervals are over runs."""

    level: SweepLevel
    sensor: str | None  # None of all together
    runs: int
    pd: Interval  # Share of looks at drones that detected them
    expected_pd: float
    false_alarms: Interval  # In a run
    arrived: float  # Share of plots that passed the link before the end
    alerted: Interval  # Share of drones
    # Mean of runs, of each the median of drones; 0 of one without an alert.
    alert_distance_m: Interval
    alert_change_m: Interval  # Against the first level, run by run with the same seed
    errors: Mapping[str, Interval]  # Root mean squares of errors of plots, by name of the column

    def as_json(self) -> dict[str, Any]:
        """Figures by name, intervals as value, low and high."""
        names = ("pd", "false_alarms", "alerted", "alert_distance_m", "alert_change_m")
        return {
            "level": self.level.number,
            "scene": self.level.scene,
            "values": self.level.by_path(),
            "sensor": self.sensor,
            "runs": self.runs,
            "expected_pd": self.expected_pd,
            "arrived": self.arrived,
            **{name: getattr(self, name)._asdict() for name in names},
            **{name: interval._asdict() for name, interval in self.errors.items()},
        }


def figures_of(levels: Sequence[SweepLevel], results: Results) -> list[LevelFigures]:
    """Figures of every level that has a run: of all sensors together, and then of each."""
    columns = {level.number: _by_sensor(level, results) for level in levels}
    found = []
    for level in levels:
        for sensor, (runs, of_level) in columns[level.number].items():
            before = columns[levels[0].number].get(sensor)
            found.append(_figures(level, sensor, runs, of_level, before))
    return sorted(found, key=lambda each: (each.level.number, each.sensor is not None))


# Numbers of runs, and the columns that they have; (n,) each.
OfRuns = tuple[list[int], dict[str, Floats]]


def _by_sensor(level: SweepLevel, results: Results) -> dict[str | None, OfRuns]:
    rows: dict[str | None, list[tuple[int, list[Any]]]] = {}
    for (number, run), result in sorted(results.items()):
        if number == level.number:
            for sensor, *row in result["sensors"]:
                rows.setdefault(sensor, []).append((run, row))
    names = list(SENSOR_COLUMNS)[1:]
    return {
        sensor: (
            [run for run, _ in of],
            dict(zip(names, np.array([row for _, row in of], np.float64).T, strict=True)),
        )
        for sensor, of in rows.items()
    }


def _figures(
    level: SweepLevel,
    sensor: str | None,
    runs: list[int],
    of: Mapping[str, Floats],
    before: OfRuns | None,
) -> LevelFigures:
    change = NOTHING
    if before is not None and before[0] == runs:
        change = mean_interval(of["alert_distance_m"] - before[1]["alert_distance_m"])
    looks, plots, errors = of["looks"].sum(), of["plots"].sum(), {}
    for name in ERRORS:  # of all plots of all runs, as far as they are known
        many = np.where(np.isnan(of[name]), 0.0, of["detected"])
        squares = ratio_interval(of[name] ** 2 * of["detected"], many)
        errors[name] = Interval(*np.sqrt(squares).tolist())
    return LevelFigures(
        level=level,
        sensor=sensor,
        runs=len(runs),
        pd=ratio_interval(of["detected"], of["looks"]),
        expected_pd=float(of["expected"].sum() / looks) if looks else np.nan,
        false_alarms=mean_interval(of["false_alarms"]),
        arrived=float(of["arrived"].sum() / plots) if plots else np.nan,
        alerted=ratio_interval(of["alerted"], of["drones"]),
        alert_distance_m=mean_interval(of["alert_distance_m"]),
        alert_change_m=change,
        errors=errors,
    )


def detection_by_distance(
    level: SweepLevel, sensor: str, results: Results
) -> dict[float, tuple[int, int]]:
    """Looks and detections of all runs of a level, by where a class of distance begins, metres."""
    at = {name: i for i, name in enumerate(DISTANCE_COLUMNS)}
    found: dict[float, tuple[int, int]] = {}
    for (number, _), result in results.items():
        for row in result["distances"] if number == level.number else ():
            if row[at["sensor"]] == sensor:
                looks, detected = found.get(row[at["from_m"]], (0, 0))
                counts = looks + row[at["looks"]], detected + row[at["detected"]]
                found[row[at["from_m"]]] = counts
    return dict(sorted(found.items()))


def lines_of(figures: Sequence[LevelFigures]) -> Iterator[str]:
    """Figures as a table for people."""
    paths = [path for path, _ in figures[0].level.changes] if figures else []
    several = len({each.level.scene for each in figures}) > 1
    head = [*(["scene"] if several else []), *paths, "sensor", "runs", "Pd", "alerted, %"]
    head += ["alert at, m", "change, m", "false alarms", "range, m", "azimuth, deg", "elevation"]
    rows = [head]
    for each in figures:
        values = [value for _, value in each.level.changes]
        named = [*([each.level.scene] if several else []), *values, each.sensor or TOGETHER]
        told = [
            interval_text(each.pd, ".3f"),
            interval_text(each.alerted, ".1f", 100.0),
            interval_text(each.alert_distance_m, ".0f"),
            interval_text(each.alert_change_m, "+.0f"),
            interval_text(each.false_alarms, ".2f"),
            *(interval_text(error, ".3g") for error in each.errors.values()),
        ]
        rows.append([*named, str(each.runs), *told])
    names = len(head) - 10
    yield from (line.rstrip() for line in aligned(rows, "<" * names + ">" * 10))


def interval_text(figure: Interval, form: str, factor: float = 1.0) -> str:
    """A figure as people read it, with its interval in brackets."""
    if not isfinite(figure.value):
        return "-"
    value, low, high = (f"{number * factor:{form}}" for number in figure)
    return value if not isfinite(figure.low) or low == high else f"{value} ({low} to {high})"

"""Figures of a sweep: each sensor at each level, over its runs, with how far they may be off."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from plotfeed.feeds.console.printed import aligned
from plotfeed.feeds.sweep.levels import SweepLevel
from plotfeed.feeds.sweep.one_run import DISTANCE_COLUMNS, SENSOR_COLUMNS
from plotfeed.models.bootstrap import NOTHING, Interval, mean_interval, ratio_interval
from plotfeed.models.state import Floats

Results = Mapping[tuple[int, int], Mapping[str, Any]]
"""Of runs, by level and run."""
TOGETHER = "all"
"""What tables for people call all sensors together."""
ERRORS = ("range_rms_m", "azimuth_rms_deg", "elevation_rms_deg")


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelFigures:
    """One sensor at one level, or all together; intervals are over runs."""

    level: SweepLevel
    sensor: str | None
    """None of all together."""
    runs: int
    pd: Interval
    """Share of looks at drones that detected them."""
    expected_pd: float
    false_alarms: Interval
    """In a run."""
    arrived: float
    """Share of plots that passed the link before the end."""
    alerted: Interval
    """Share of drones."""
    alert_distance_m: Interval
    """Mean of runs, of each the median of drones; 0 of one without an alert."""
    alert_change_m: Interval
    """Against the first level, run by run with the same seed."""
    errors: Mapping[str, Interval]
    """Root mean squares of errors of plots, by name of the column."""

    def as_json(self) -> dict[str, Any]:
        """Figures by name, intervals as value, low and high."""
        names = ("pd", "false_alarms", "alerted", "alert_distance_m", "alert_change_m")
        return {
            "level": self.level.number,
            "scene": self.level.scene,
            "values": dict(zip((p for p, _ in self.level.changes), self.level.values, strict=True)),
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


OfRuns = tuple[list[int], dict[str, Floats]]
"""Numbers of runs, and the columns that they have; (n,) each."""


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
    looks, plots = of["looks"].sum(), of["plots"].sum()
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
        errors={name: _rms(of[name], of["detected"]) for name in ERRORS},
    )


def _rms(rms: Floats, plots: Floats) -> Interval:
    """Errors of all plots of all runs, as far as they are known."""
    found = ratio_interval(rms**2 * plots, np.where(np.isnan(rms), 0.0, plots))
    return Interval(*np.sqrt(found).tolist())


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
        row = [*([each.level.scene] if several else []), *values, each.sensor or TOGETHER]
        row += [str(each.runs), _shown(each.pd, ".3f"), _shown(each.alerted, ".1f", 100.0)]
        row += [_shown(each.alert_distance_m, ".0f"), _shown(each.alert_change_m, "+.0f")]
        row += [_shown(each.false_alarms, ".2f")]
        row += [_shown(error, ".3g") for error in each.errors.values()]
        rows.append(row)
    names = len(head) - 10
    yield from (line.rstrip() for line in aligned(rows, "<" * names + ">" * 10))


def _shown(figure: Interval, form: str, factor: float = 1.0) -> str:
    if not isfinite(figure.value):
        return "-"
    value, low, high = (f"{number * factor:{form}}" for number in figure)
    return value if not isfinite(figure.low) or low == high else f"{value} ({low} to {high})"

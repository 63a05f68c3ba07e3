"""A sweep drawn: detection by distance, where drones are told of, and errors, by level."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.console.extras import NO_DATE, save_figure
from plotfeed.feeds.console.printed import printable
from plotfeed.feeds.sweep.levels import SweepLevel
from plotfeed.feeds.sweep.sweep_summary import (
    ERRORS,
    TOGETHER,
    LevelFigures,
    Results,
    detection_by_distance,
)
from plotfeed.models.bootstrap import Interval

INCHES_WIDE, INCHES_A_ROW = 15.0, 3.7
DPI = 100
MOST_SENSORS, MOST_LINES = 6, 8
"""That are drawn."""
FEWEST_LOOKS = 5
"""In a class of distance that is drawn."""
LOG_FROM = 20.0
"""Times that the largest value is the smallest: then the axis is logarithmic."""
LETTERS = 28
"""Of a label."""
UNITS = {"range_rms_m": "range, m", "azimuth_rms_deg": "azimuth, degrees"}
UNITS["elevation_rms_deg"] = "elevation, degrees"


class LevelAxis:
    """Levels along an axis: by the first key of numbers, a line for each value of all others."""

    def __init__(self, levels: Sequence[SweepLevel]) -> None:
        self._several = len({level.scene for level in levels}) > 1
        self.key = next((n for n in range(len(levels[0].changes)) if _is_scale(levels, n)), None)
        self.title = "level" if self.key is None else levels[0].changes[self.key][0]
        self.lines: dict[str, list[SweepLevel]] = {}
        """Levels of a line, by its label."""
        for level in levels:
            self.lines.setdefault(self._line(level), []).append(level)
        self._at = {level.number: n for n, level in enumerate(levels)}
        values = [self.at(level) for level in levels]
        self.is_log = self.key is not None and min(values) > 0
        self.is_log = self.is_log and max(values) > LOG_FROM * min(values)
        self.ticks = {} if self.key is not None else {self.at(lv): self.name(lv) for lv in levels}

    def at(self, level: SweepLevel) -> float:
        """Where a level stands."""
        value = self._at[level.number] if self.key is None else level.values[self.key]
        return float(value)

    def name(self, level: SweepLevel) -> str:
        """A label of a level."""
        label = _label(level, range(len(level.changes)), with_scene=self._several)
        return label or plain_text(level.scene)

    def _line(self, level: SweepLevel) -> str:
        if self.key is None:
            return ""
        others = [n for n in range(len(level.changes)) if n != self.key]
        return _label(level, others, with_scene=self._several)


def draw_sweep(
    path: Path, levels: Sequence[SweepLevel], figures: Sequence[LevelFigures], results: Results
) -> None:
    """Write the picture, in the format that its name says."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    sensors = list(dict.fromkeys(each.sensor for each in figures if each.sensor is not None))
    shown, axis = sensors[:MOST_SENSORS], LevelAxis(levels)
    by = {(each.level.number, each.sensor): each for each in figures}
    rows = 1 + len(shown)
    with mpl.rc_context({"svg.hashsalt": "plotfeed", "font.size": 9.5, "axes.titlesize": 10.5}):
        figure: Any = Figure(
            figsize=(INCHES_WIDE, INCHES_A_ROW * rows), dpi=DPI, layout="constrained"
        )
        figure.suptitle(_title(levels, figures, len(sensors) - len(shown)), fontsize=13)
        grid = figure.subplots(rows, 3, squeeze=False)
        _draw(grid[0, 0], axis, by, None, ("Drones told of", "share", lambda f: f.alerted))
        _draw(grid[0, 1], axis, by, None, ALERT)
        alarms = "False alarms", "in a run", lambda f: f.false_alarms
        _draw(grid[0, 2], axis, by, None, alarms)
        for row, sensor in enumerate(shown, 1):
            _detection(grid[row, 0], axis, levels, sensor, results)
            _draw(grid[row, 1], axis, by, sensor, ALERT)
            error = _told_error(by, sensor)
            unit = f"rms of {UNITS[error]}"
            errors = "Error of plots", unit, lambda f, error=error: f.errors[error]
            _draw(grid[row, 2], axis, by, sensor, errors)
        save_figure(figure, path, metadata=NO_DATE[path.suffix.lower()])


def _alert(figures: LevelFigures) -> Interval:
    return figures.alert_distance_m


ALERT = "Alert", "metres from what is protected", _alert


def _told_error(by: Mapping[Any, LevelFigures], sensor: str) -> str:
    """The first error that the sensor has at all: those of bearings alone have none of range."""
    of = [each for (_, name), each in by.items() if name == sensor]
    told = (e for e in ERRORS if any(np.isfinite(each.errors[e].value) for each in of))
    return next(told, ERRORS[0])


def _draw(
    axes: Any,
    axis: LevelAxis,
    by: Mapping[tuple[int, str | None], LevelFigures],
    sensor: str | None,
    what: tuple[str, str, Callable[[LevelFigures], Interval]],
) -> None:
    """A figure of a sensor: its title, its unit, and where it is found."""
    title, unit, figure_of = what
    found = {number: figure_of(each) for (number, name), each in by.items() if name == sensor}
    draw_by_level(axes, axis, found, f"{title}: {printable(sensor or TOGETHER)}", unit)


def draw_by_level(
    axes: Any, axis: LevelAxis, figures: Mapping[int, Interval], title: str, unit: str
) -> None:
    """A figure by level with its intervals, a line for each value of what is not the axis.

    `figures` are by the numbers of levels.
    """
    drawn = False
    lines = list(axis.lines.items())[:: max(1, -(-len(axis.lines) // MOST_LINES))]
    for (label, levels), colour in zip(lines, _colours(len(lines)), strict=True):
        told = [(axis.at(lv), figures[lv.number]) for lv in levels if lv.number in figures]
        told = [(x, figure) for x, figure in told if np.isfinite(figure.value)]
        if not told:
            continue
        drawn = True
        x, y = [x for x, _ in told], [figure.value for _, figure in told]
        spans = [[max(f.value - f.low, 0.0), max(f.high - f.value, 0.0)] for _, f in told]
        how: dict[str, Any] = {"fmt": "o" if axis.key is None else "o-", "ms": 4, "capsize": 3}
        axes.errorbar(x, y, yerr=np.nan_to_num(spans).T, color=colour, label=label or None, **how)
    if axis.is_log:
        axes.set_xscale("log")
    if axis.ticks:
        axes.set_xticks(list(axis.ticks), list(axis.ticks.values()), rotation=20, ha="right")
    if drawn and any(axis.lines):
        axes.legend(frameon=False, fontsize=8.5)
    _finish(axes, title, printable(axis.title), unit, drawn)


def _detection(
    axes: Any, axis: LevelAxis, levels: Sequence[SweepLevel], sensor: str, results: Results
) -> None:
    step = max(1, -(-len(levels) // MOST_LINES))
    chosen, drawn = levels[::step], False
    for level, colour in zip(chosen, _colours(len(chosen)), strict=True):
        found = detection_by_distance(level, sensor, results)
        begins_m = [m for m, (looks, _) in found.items() if looks >= FEWEST_LOOKS]
        if begins_m:
            drawn = True
            half_m = _half_width_m(results)
            shares = [found[m][1] / found[m][0] for m in begins_m]
            middles_km = [(m + half_m) / 1000 for m in begins_m]
            axes.plot(middles_km, shares, ".-", color=colour, lw=1.1, label=axis.name(level))
    if drawn:
        axes.set_ylim(-0.03, 1.03)
        axes.set_xlim(left=0)
        axes.legend(frameon=False, fontsize=8.5)
    _finish(axes, f"Detection: {printable(sensor)}", "true distance, km", "share of looks", drawn)


def _half_width_m(results: Results) -> float:
    row = next(row for result in results.values() for row in result["distances"])
    return float(row[2] - row[1]) / 2


def _title(levels: Sequence[SweepLevel], figures: Sequence[LevelFigures], left_out: int) -> str:
    names = ", ".join(dict.fromkeys(level.scene for level in levels))
    runs = max((each.runs for each in figures), default=0)
    more = f"; {left_out} more sensors, not drawn" if left_out else ""
    return plain_text(f"{names}: {len(levels)} levels of {runs} runs, bars 95 % over runs{more}")


def _label(level: SweepLevel, keys: Any, *, with_scene: bool) -> str:
    parts = [level.scene] if with_scene else []
    parts += [f"{level.changes[n][0]} = {level.changes[n][1]}" for n in keys]
    text = ", ".join(parts)
    return plain_text(text if len(text) <= LETTERS else f"...{text[-LETTERS:]}")


def plain_text(text: str) -> str:
    """Text in which matplotlib takes no dollar for mathematics."""
    return printable(text).replace("$", r"\$")


def _is_scale(levels: Sequence[SweepLevel], n: int) -> bool:
    values = {level.changes[n][1] for level in levels}
    numbers = [json.loads(value) for value in values]
    return len(numbers) > 1 and all(type(number) in (int, float) for number in numbers)


def _colours(count: int) -> list[Any]:
    import matplotlib as mpl

    shades = mpl.colormaps["viridis"]
    return [shades(x) for x in np.linspace(0.0, 0.85, max(count, 1))[:count]]


def _finish(axes: Any, title: str, x: str, y: str, drawn: bool) -> None:
    axes.set_title(title.replace("$", r"\$"), loc="left", fontweight="bold")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(visible=True, alpha=0.3)
    if not drawn:
        axes.text(0.5, 0.5, "nothing to draw", transform=axes.transAxes, ha="center", color="grey")

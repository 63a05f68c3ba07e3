"""The curve of what a tracker survives: means over runs at each level, with their intervals.

As a table for people, and drawn.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.console.extras import NO_DATE, save_figure
from plotfeed.feeds.console.printed import aligned
from plotfeed.feeds.sweep.levels import SweepLevel
from plotfeed.feeds.sweep.sweep_pictures import LevelAxis, draw_by_level, plain_text
from plotfeed.feeds.sweep.sweep_summary import Results
from plotfeed.models.bootstrap import Interval, mean_interval

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
DPI = 100


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
        rows.append(row + [_shown(point.figures[name], SHOWN[name][1]) for name in SHOWN])
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


def _shown(figure: Interval, form: str) -> str:
    if not isfinite(figure.value):
        return "-"
    value, low, high = (f"{number:{form}}" for number in figure)
    return value if not isfinite(figure.low) or low == high else f"{value} ({low} to {high})"


def draw_curve(path: Path, points: Sequence[CurvePoint]) -> None:
    """Write the picture, in the format that its name says."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    axis = LevelAxis([point.level for point in points])
    with mpl.rc_context({"svg.hashsalt": "plotfeed", "font.size": 9.5, "axes.titlesize": 10.5}):
        figure: Any = Figure(figsize=INCHES, dpi=DPI, layout="constrained")
        figure.suptitle(_title(points), fontsize=13)
        for axes, (name, (title, _)) in zip(figure.subplots(2, 3).flat, SHOWN.items(), strict=True):
            found = {point.level.number: point.figures[name] for point in points}
            draw_by_level(axes, axis, found, title, "")
        save_figure(figure, path, metadata=NO_DATE[path.suffix.lower()])


def _title(points: Sequence[CurvePoint]) -> str:
    names = ", ".join(dict.fromkeys(point.tracker for point in points))
    failed = sum(len(point.failures) for point in points)
    runs = sum(point.runs for point in points)
    more = f"; failed in {failed}" if failed else ""
    return plain_text(f"{names}: {runs} runs, bars 95 % over those of a level{more}")

"""The curve of what trackers survive: figures of their score against the level."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from plotfeed.feeds.console.extras import NO_DATE, save_figure
from plotfeed.feeds.score.score_curve import SHOWN, CurvePoint
from plotfeed.feeds.sweep.sweep_pictures import LevelAxis, draw_by_level, plain_text

INCHES = (15.0, 8.0)
DPI = 100


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

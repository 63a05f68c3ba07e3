"""What pictures share: figures that are the same to the byte, axes, levels, labels with room."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.console.extras import NO_DATE, save_figure
from plotfeed.feeds.console.printed import printable
from plotfeed.feeds.scene.levels import SweepLevel
from plotfeed.models.verdicts import Interval

DPI = 110
INK, QUIET = "#1e293b", "#94a3b8"


@contextmanager
def figure_of(
    inches: tuple[float, float], title: str = "", *, size: int = 13, **settings: Any
) -> Iterator[Any]:
    """A figure of matplotlib, whose panels lie where there is room; `settings` are its own."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    rc: Any = {"svg.hashsalt": "plotfeed", "font.size": 9.5, **settings}
    with mpl.rc_context(rc):
        figure: Any = Figure(figsize=inches, dpi=DPI, layout="constrained")
        if title:
            figure.suptitle(title, fontsize=size)
        yield figure


def save_picture(figure: Any, path: Path) -> None:
    """Write a figure in the format that its name says, the same again to the byte."""
    save_figure(figure, path, metadata=NO_DATE[path.suffix.lower()])


def svg_of(figure: Any) -> str:
    """A figure as an SVG element."""
    octets = io.BytesIO()
    figure.savefig(octets, format="svg", metadata=NO_DATE[".svg"])
    text = octets.getvalue().decode()
    return text[text.index("<svg") :]


def finish(
    axes: Any, title: str, x: str, y: str, *, drawn: object = True, nothing: str = "nothing to draw"
) -> None:
    """Titles and a grid; where nothing is `drawn`, the words for that in the middle."""
    axes.set_title(title.replace("$", r"\$"), loc="left", fontweight="bold")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(visible=True, alpha=0.3)
    if not drawn:
        axes.set_xticks([])
        axes.set_yticks([])
        axes.text(0.5, 0.5, nothing, transform=axes.transAxes, ha="center", color=QUIET, size=11)


def plain_text(text: str) -> str:
    """Text in which matplotlib takes no dollar for mathematics."""
    return printable(text).replace("$", r"\$")


LEVELS_DRAWN = 8
LOG_FROM = 20.0  # Times that the largest value is the smallest: then the axis is logarithmic
LETTERS = 28  # Of a label


class LevelAxis:
    """Levels along an axis: by the first key of numbers, a line for each value of all others."""

    def __init__(self, levels: Sequence[SweepLevel]) -> None:
        self._several = len({level.scene for level in levels}) > 1
        found = ({level.changes[n][1] for level in levels} for n in range(len(levels[0].changes)))
        values = [[json.loads(text) for text in each] for each in found]
        scales = (len(v) > 1 and all(type(x) in (int, float) for x in v) for v in values)
        self.key = next((n for n, is_scale in enumerate(scales) if is_scale), None)
        self.title = "level" if self.key is None else levels[0].changes[self.key][0]
        self.lines: dict[str, list[SweepLevel]] = {}  # Levels of a line, by its label
        for level in levels:
            line = "" if self.key is None else self._label(level, self.key)
            self.lines.setdefault(line, []).append(level)
        self._at = {level.number: n for n, level in enumerate(levels)}
        at = [self.at(level) for level in levels]
        self.is_log = self.key is not None and 0 < LOG_FROM * min(at) < max(at)
        self.ticks = {} if self.key is not None else {self.at(lv): self.name(lv) for lv in levels}

    def at(self, level: SweepLevel) -> float:
        """Where a level stands."""
        value = self._at[level.number] if self.key is None else level.values[self.key]
        return float(value)

    def name(self, level: SweepLevel) -> str:
        """A label of a level."""
        return self._label(level) or plain_text(level.scene)

    def _label(self, level: SweepLevel, but: int | None = None) -> str:
        """The scene, where there are several, and the values of all keys but one."""
        told = [f"{k} = {v}" for n, (k, v) in enumerate(level.changes) if n != but]
        text = ", ".join([level.scene, *told] if self._several else told)
        return plain_text(text if len(text) <= LETTERS else f"...{text[-LETTERS:]}")


def draw_by_level(
    axes: Any, axis: LevelAxis, figures: Mapping[int, Interval], title: str, unit: str
) -> None:
    """A figure by level with its intervals, a line for each value of what is not the axis.

    `figures` are by the numbers of levels.
    """
    drawn = False
    lines = list(axis.lines.items())[:: max(1, -(-len(axis.lines) // LEVELS_DRAWN))]
    for (label, levels), colour in zip(lines, shades(len(lines)), strict=True):
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
    finish(axes, title, printable(axis.title), unit, drawn=drawn)


def shades(count: int) -> list[Any]:
    """Colours of so many lines, in order."""
    import matplotlib as mpl

    shades = mpl.colormaps["viridis"]
    return [shades(x) for x in np.linspace(0.0, 0.85, max(count, 1))[:count]]


LABEL_STYLE = {"fontsize": 7.5, "linespacing": 1.2, "va": "bottom", "ha": "left"}
MARKER_PIXELS = 8.0
GAP_PIXELS = 10.0
REACHES = (1.0, 2.0, 3.5, 5.5, 8.0, 11.0, 15.0)  # How far labels may move away, in gaps
# Where a label may be beside its point, the better places first.
SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))


def place_labels(
    figure: Any, axes: Any, labels: Sequence[tuple[float, float, str]], colour: str
) -> None:
    """Write texts beside points, each where it first finds room, with a line to one far away."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas: Any = FigureCanvasAgg(figure)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # labels go where there is room, and make none
    renderer = canvas.get_renderer()
    frame = axes.get_window_extent(renderer).extents[None]
    points = axes.transData.transform([(x, y) for x, y, _ in labels])
    taken = np.concatenate([points - MARKER_PIXELS, points + MARKER_PIXELS], axis=1)

    def covered(box: Any, others: Any) -> float:
        """Area of a box that lies in others: left, bottom, right and top, pixels."""
        sides = np.minimum(box[2:], others[:, 2:]) - np.maximum(box[:2], others[:, :2])
        return float(np.maximum(sides, 0.0).prod(axis=1).sum())

    for (x, y, text), point in zip(labels, points, strict=True):
        tried = axes.annotate(text, (x, y), **LABEL_STYLE)
        half = tried.get_window_extent(renderer).size / 2
        tried.remove()
        middles = (point + np.array(s) * (r * GAP_PIXELS + half) for r in REACHES for s in SIDES)
        boxes = [np.concatenate([middle - half, middle + half]) for middle in middles]
        costs = [covered(box, taken) - covered(box, frame) for box in boxes]
        box = boxes[int(np.argmin(costs))]
        taken = np.vstack([taken, box])
        is_far = np.abs(np.clip(point, box[:2], box[2:]) - point).max() > 2.5 * GAP_PIXELS
        line = {"arrowstyle": "-", "lw": 0.5, "color": colour, "alpha": 0.6, "shrinkA": 0}
        axes.annotate(
            text,
            (x, y),
            xytext=(box[:2] - point) / (axes.figure.dpi / 72),
            textcoords="offset points",
            **LABEL_STYLE,
            color=colour,
            zorder=6,
            annotation_clip=False,
            arrowprops=line if is_far else None,
            bbox={"facecolor": "white", "alpha": 0.8, "lw": 0, "pad": 0.6},
        )

"""The figures of a chart: one a stage, one of batch sizes, one of whole configurations."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.accuracy_chart.chart import (
    LITTLE,
    Chart,
    ChartedSensor,
    MeasuredStage,
)
from plotfeed.feeds.accuracy_chart.stage import errors_text, ns_text
from plotfeed.feeds.console.extras import save_figure
from plotfeed.models.state import Floats

COLUMNS = 2
PANEL_INCHES = (6.6, 4.7)
TITLE_AND_LEGEND_INCHES = 0.9
DPI = 110
LEAST_SHARE, LARGEST_SHARE = 1e-12, 1e6
"""Smaller shares are none, and larger ones are drawn there."""
SCENE, FRONT, OTHER, CHEAP, QUIET = "#c2410c", "#1d4ed8", "#64748b", "#15803d", "#94a3b8"
INK = "#1e293b"
COST_LABEL = "ns a target-scan"
SHARE_LABEL = "error added, beside the sensor's own"

LABEL_STYLE = {"fontsize": 7.5, "linespacing": 1.2, "va": "bottom", "ha": "left"}
MARKER_PIXELS = 8.0
GAP_PIXELS = 10.0
REACHES = (1.0, 2.0, 3.5, 5.5, 8.0, 11.0, 15.0)
"""How far labels may move away, in gaps."""
Box = tuple[float, float, float, float]
"""Left, bottom, right, top; pixels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """What is written beside a point; data coordinates."""

    x: float
    y: float
    text: str
    color: str


Panel = Callable[[Any], list[Label]]


def draw(chart: Chart, folder: Path, picture: str) -> list[Path]:
    """Draw all figures into a folder, as .png or .svg; their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, title, panels in _figures(chart):
        path = folder / f"{name}.{picture}"
        _draw(f"{title}: scene {chart.scene}", panels, path)
        paths.append(path)
    return paths


def _figures(chart: Chart) -> list[tuple[str, str, Mapping[str, Panel]]]:
    """File name, title, and a panel for each sensor that has something to show."""
    stages: dict[str, tuple[str, dict[str, Panel]]] = {}
    for sensor in chart.sensors:
        for stage in sensor.stages:
            _, panels = stages.setdefault(stage.name, (stage.question, {}))
            panels[sensor.name] = partial(_stage_panel, sensor, stage)
    found: list[tuple[str, str, Mapping[str, Panel]]] = [
        (name.replace(" ", "-"), question, panels) for name, (question, panels) in stages.items()
    ]
    if chart.sensors:
        batches: dict[str, Panel] = {"": partial(_batches_panel, chart.sensors)}
        whole: dict[str, Panel] = {s.name: partial(_whole_panel, s) for s in chart.sensors}
        found.append(("batches", "What a target costs in company, by their number", batches))
        found.append(("configurations", "Whole configurations: one method of every stage", whole))
    return found


def _draw(title: str, panels: Mapping[str, Panel], path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    size = PANEL_INCHES[0] * columns, PANEL_INCHES[1] * rows + TITLE_AND_LEGEND_INCHES
    figure: Any = Figure(figsize=size, dpi=DPI, layout="constrained")
    canvas: Any = FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=12 if columns > 1 else 10)
    places = figure.subplots(rows, columns, squeeze=False).flatten()
    for unused in places[len(panels) :]:
        unused.remove()
    labels = []
    for axes, (name, panel) in zip(places, panels.items(), strict=False):
        axes.set_title(name, fontsize=11, loc="left", fontweight="bold")
        labels.append((axes, panel(axes)))
    if "" not in panels:  # of which it would say nothing
        _legend(figure, columns)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # labels go where there is room, and make none
    for axes, texts in labels:
        place_labels(axes, texts, canvas.get_renderer())
    save_figure(figure, path)


def _legend(figure: Any, columns: int) -> None:
    from matplotlib.lines import Line2D

    marks: list[tuple[str, dict[str, Any]]] = [
        ("what the scene has", {"color": SCENE, "marker": "D", "lw": 0}),
        ("on the front: nothing is both cheaper and better", {"color": FRONT, "marker": "o"}),
        ("other", {"color": OTHER, "marker": "o", "lw": 0}),
        ("a tenth of the sensor's own error", {"color": CHEAP, "ls": "--"}),
    ]
    handles = [Line2D([], [], label=text, **how) for text, how in marks]
    place = "outside lower center"
    figure.legend(handles=handles, loc=place, ncol=2 * columns, fontsize=8.5, frameon=False)


def _stage_panel(sensor: ChartedSensor, stage: MeasuredStage, axes: Any) -> list[Label]:
    ns = np.array([m.time.median_ns for m in stage.methods])
    scale = _Shares.of([m.share for m in stage.methods])
    shares = scale.drawn([m.share for m in stage.methods])
    labels = []
    for i, (x, y, m) in enumerate(zip(ns.tolist(), shares.tolist(), stage.methods, strict=True)):
        span_ns = ([x - m.time.low_ns], [m.time.high_ns - x])
        axes.errorbar([x], [y], xerr=span_ns, color=QUIET, lw=1, zorder=1)
        ours = m.method.ours
        color = SCENE if ours else FRONT if i in stage.front else OTHER
        axes.scatter([x], [y], s=60, color=color, marker="D" if ours else "o", zorder=4)
        text = f"{m.method.name}\n{errors_text(m.method.errors)}"
        labels.append(Label(x=x, y=y, text=text, color=SCENE if ours else INK))
    front = list(stage.front)
    _finish(axes, sensor, scale, ns, (ns[front], shares[front]))
    return labels


def _whole_panel(sensor: ChartedSensor, axes: Any) -> list[Label]:
    whole, front = sensor.whole, sensor.whole.front
    scale = _Shares.of([*whole.shares, whole.scene.share])
    axes.scatter(
        whole.ns, scale.drawn(whole.shares), s=3, color=QUIET, alpha=0.25, lw=0, rasterized=True
    )
    marked = [("as the scene has it", whole.scene, SCENE, "D")]
    if whole.cheapest is not None:
        marked.append(("the cheapest that adds little", whole.cheapest, CHEAP, "o"))
    labels = []
    for text, found, color, marker in marked:
        (y,) = scale.drawn([found.share])
        axes.scatter([found.ns], [y], s=70, color=color, marker=marker, zorder=5)
        told = f"{text}: {ns_text(found.ns)} ns\n{errors_text(found.errors)}"
        labels.append(Label(x=found.ns, y=float(y), text=told, color=color))
    steps = np.array([c.ns for c in front]), scale.drawn([c.share for c in front])
    _finish(axes, sensor, scale, np.append(whole.ns, whole.scene.ns), steps)
    return labels


def _batches_panel(sensors: Sequence[ChartedSensor], axes: Any) -> list[Label]:
    axes.set_xscale("log")
    axes.set_yscale("log")
    labels = []
    for i, sensor in enumerate(sensors):
        sizes = np.array(list(sensor.batches))
        times = list(sensor.batches.values())
        medians = np.array([t.median_ns for t in times])
        color = f"C{i}"
        axes.fill_between(
            sizes, [t.low_ns for t in times], [t.high_ns for t in times], color=color, alpha=0.15
        )
        axes.plot(sizes, medians, marker="o", ms=4, color=color)
        labels.append(
            Label(x=float(sizes[-1]), y=float(medians[-1]), text=sensor.name, color=color)
        )
    axes.margins(x=0.18)
    _log_axis(axes.xaxis, axes.get_xlim())
    _log_axis(axes.yaxis, axes.get_ylim())
    axes.set_xlabel("targets at once")
    axes.set_ylabel(f"{COST_LABEL}, from place to plot")
    axes.grid(visible=True, alpha=0.2)
    return labels


@dataclass(frozen=True, slots=True)
class _Shares:
    """A logarithmic axis of shares, on which no error lies a step below the least one."""

    none: float
    has_none: bool
    low: float
    high: float

    @classmethod
    def of(cls, shares: Sequence[float]) -> _Shares:
        """Room for those, and for the tenth below which errors do not matter."""
        some = [min(s, LARGEST_SHARE) for s in shares if s > LEAST_SHARE] or [LITTLE]
        none = 10.0 ** (np.floor(np.log10(min(*some, LITTLE))) - 1)
        has_none = any(s <= LEAST_SHARE for s in shares)
        low = none / 5 if has_none else min(*some, LITTLE) / 20
        return cls(float(none), has_none, float(low), float(max(*some, LITTLE) * 30))

    def drawn(self, shares: Any) -> Floats:
        """Where they are drawn."""
        values = np.minimum(np.asarray(shares, dtype=np.float64), LARGEST_SHARE)
        return np.where(values > LEAST_SHARE, values, self.none)


def _finish(
    axes: Any, sensor: ChartedSensor, scale: _Shares, ns: Floats, front: tuple[Floats, Floats]
) -> None:
    """Axes, the front in steps, and the tenth below which errors do not matter."""
    axes.set_title(f"its own: {errors_text(sensor.own)}", fontsize=8, loc="right", color=OTHER)
    axes.step(*front, where="post", color=FRONT, lw=1.2, alpha=0.7, zorder=2)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(ns.min() / 2.5, ns.max() * 4)
    axes.set_ylim(scale.low, scale.high)
    axes.axhline(LITTLE, color=CHEAP, ls="--", lw=1, zorder=0)
    axes.axhspan(scale.low, LITTLE, color=CHEAP, alpha=0.05, zorder=0, lw=0)
    _log_axis(axes.xaxis, axes.get_xlim())
    _log_axis(axes.yaxis, (scale.low, scale.high), none=scale.none * scale.has_none)
    axes.set_xlabel(COST_LABEL)
    axes.set_ylabel(SHARE_LABEL)
    axes.grid(visible=True, alpha=0.2)


def _log_axis(axis: Any, limits: tuple[float, float], none: float = 0.0) -> None:
    """Ticks at powers of ten, between them too where there are few; nothing is at `none`."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    low, high = np.log10(limits[0]), np.log10(limits[1])
    powers = np.arange(np.ceil(low), np.floor(high) + 1)
    step = max(1, round(len(powers) / 8))
    ticks = [10.0**p for p in powers if p % step == 0]
    if high - low < 2.5:
        ticks = [m * 10.0**p for p in np.arange(np.floor(low), high) for m in (1, 2, 5)]
    ticks = [none, *(t for t in ticks if limits[0] <= t <= limits[1] and t > none * 2)]

    def text(value: float, _: int) -> str:
        return "none" if value == none else _number(value)

    axis.set_major_locator(FixedLocator(ticks[0 if none else 1 :]))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(text))


def _number(value: float) -> str:
    """A number as people write it, a very large or very small one as a power of ten."""
    if 1e-3 <= value < 1e6:
        return f"{value:,.0f}" if value >= 1 else f"{value:g}"
    return f"$10^{{{round(np.log10(value))}}}$"


def place_labels(axes: Any, labels: Sequence[Label], renderer: Any) -> None:
    """Write them, each where it first finds room, with a line to its point if that is not near."""
    points = [tuple(axes.transData.transform((label.x, label.y))) for label in labels]
    taken: list[Box] = [_around(x, y, MARKER_PIXELS, MARKER_PIXELS) for x, y in points]
    within = axes.get_window_extent(renderer)
    frame = (within.x0, within.y0, within.x1, within.y1)
    for label, (x, y) in zip(labels, points, strict=True):
        text = axes.annotate(label.text, (label.x, label.y), **LABEL_STYLE)
        extent = text.get_window_extent(renderer)
        text.remove()
        best = min(
            _boxes(x, y, extent.width, extent.height),
            key=lambda found: _cost(found, frame, taken),
        )
        taken.append(best)
        _write(axes, label, (x, y), best)


def _write(axes: Any, label: Label, point: tuple[float, float], box: Box) -> None:
    """A label in its box, which is in pixels."""
    pixels_a_point = axes.figure.dpi / 72
    offset = ((box[0] - point[0]) / pixels_a_point, (box[1] - point[1]) / pixels_a_point)
    near_x = min(max(point[0], box[0]), box[2])
    near_y = min(max(point[1], box[1]), box[3])
    far = max(abs(near_x - point[0]), abs(near_y - point[1])) > 2.5 * GAP_PIXELS
    axes.annotate(
        label.text,
        (label.x, label.y),
        xytext=offset,
        textcoords="offset points",
        **LABEL_STYLE,
        color=label.color,
        zorder=6,
        annotation_clip=False,
        arrowprops={"arrowstyle": "-", "lw": 0.5, "color": label.color, "alpha": 0.6, "shrinkA": 0}
        if far
        else None,
        bbox={"facecolor": "white", "alpha": 0.8, "lw": 0, "pad": 0.6},
    )


def _boxes(x: float, y: float, width: float, height: float) -> Iterator[Box]:
    """Places for a label, the better ones first: to the right, to the left, above, below."""
    for reach in REACHES:
        away = reach * GAP_PIXELS
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            middle_x = x + dx * (away + width / 2)
            middle_y = y + dy * (away + height / 2)
            yield _around(middle_x, middle_y, width / 2, height / 2)


def _cost(box: Box, frame: Box, taken: Sequence[Box]) -> float:
    """Area that is covered twice or lies outside."""
    inside = _overlap(box, frame)
    area = (box[2] - box[0]) * (box[3] - box[1])
    return (area - inside) + sum(_overlap(box, other) for other in taken)


def _overlap(a: Box, b: Box) -> float:
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    return max(width, 0.0) * max(height, 0.0)


def _around(x: float, y: float, half_width: float, half_height: float) -> Box:
    return x - half_width, y - half_height, x + half_width, y + half_height

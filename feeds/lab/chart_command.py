"""`plotfeed chart`: measures a scene, prints what came of it, and draws it."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.console.printed import finite, say
from plotfeed.feeds.console.process import keep_freed, refuse_if_there
from plotfeed.feeds.lab.chart import (
    LITTLE,
    Chart,
    ChartedSensor,
    Configuration,
    MeasuredStage,
    charted,
)
from plotfeed.feeds.lab.charted import Effort, Time, errors_text, ns_text, share_text
from plotfeed.feeds.lab.pictures import INK, QUIET, Label, figure_of, place_labels, save_picture
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.state import Floats

Values = Mapping[str, Any]


def print_chart(
    scene: Scene,
    *,
    out: Path | None,
    picture: str,
    targets: int,
    quick: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Measure and print, as a table or as JSON; with `out`, a folder, draw too.

    Raises `PlotfeedError` where figures are in that folder and nobody says to replace them.
    """
    if out is not None:
        need_extra("matplotlib.figure", "a chart", "charts")
        for path in sorted(out.glob(f"*.{picture}")):
            refuse_if_there(path, force=force)
    keep_freed()  # as a session does
    chart = charted(scene, Effort.quick(targets) if quick else Effort.usual(targets))
    values = as_values(chart)
    drawn = draw_chart(chart, out, picture) if out is not None else []
    if as_json:
        say(json.dumps(values))
        return
    for line in lines(values):
        say(line)
    for path in drawn:
        say(f"drawn: {path}", err=True)


def as_values(chart: Chart) -> dict[str, Any]:
    """A chart for JSON: all that the table has, and the front of whole configurations."""
    return {
        "scene": chart.scene,
        "machine": _machine(),
        "targets": chart.effort.targets,
        "rounds": chart.effort.rounds,
        "sensors": [_sensor_values(sensor) for sensor in chart.sensors],
        "unseen": list(chart.unseen),
    }


def _machine() -> dict[str, Any]:
    """Where the times are from."""
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "system": platform.system(),
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "scipy": version("scipy"),
    }


def processor() -> str:
    """What the machine says that it is."""
    cpuinfo = Path("/proc/cpuinfo")
    told = cpuinfo.read_text("utf-8", "replace").splitlines() if cpuinfo.exists() else []
    names = [line.partition(":")[2].strip() for line in told if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _sensor_values(sensor: ChartedSensor) -> dict[str, Any]:
    return {
        "id": sensor.name,
        "type": sensor.type,
        "own": dict(sensor.own),
        "stages": [
            {
                "stage": stage.name,
                "question": stage.question,
                "methods": [
                    {
                        "method": m.method.name,
                        "ns": _time_values(m.time),
                        "errors": dict(m.method.errors),
                        "share": finite(m.share),
                        "ours": m.method.ours,
                        "on_front": i in stage.front,
                    }
                    for i, m in enumerate(stage.methods)
                ],
            }
            for stage in sensor.stages
        ],
        "batches": [{"targets": n, "ns": _time_values(t)} for n, t in sensor.batches.items()],
        "configurations": {
            "scene": _configuration_values(sensor.whole.scene),
            "cheapest": _configuration_values(sensor.whole.cheapest),
            "front": [_configuration_values(c) for c in sensor.whole.front],
            "all": len(sensor.whole.ns),
        },
    }


def _time_values(time: Time) -> dict[str, float]:
    return {"median": time.median_ns, "low": time.low_ns, "high": time.high_ns}


def _configuration_values(found: Configuration | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "methods": dict(found.names),
        "ns": found.ns,
        "errors": dict(found.errors),
        "share": finite(found.share),
    }


def lines(chart: Values) -> Iterator[str]:
    """The whole table."""
    turns = chart["rounds"]
    yield (
        f"{chart['scene']}: {chart['targets']:,} targets at once; "
        f"ns a target-scan, median (middle half) of {turns} turns"
    )
    yield "> what the scene has, * on the front: none is both cheaper and better"
    for sensor in chart["sensors"]:
        yield from _sensor_lines(sensor)
    for name in chart["unseen"]:
        yield f"\n{name}: left out, for it hardly ever detects a drone of the scene"
    yield ""
    yield from (verdict(sensor) for sensor in chart["sensors"])


def verdict(sensor: Values) -> str:
    """The cheapest configuration that adds little, and what it saves."""
    scene, cheapest = (sensor["configurations"][name] for name in ("scene", "cheapest"))
    if cheapest is None:
        return (
            f"{sensor['id']}: no configuration adds less than {LITTLE:g} of the sensor's own error."
        )
    changed = [
        f"{method} in place of {scene['methods'][stage]}"
        for stage, method in cheapest["methods"].items()
        if method != scene["methods"][stage]
    ]
    head = (
        f"{sensor['id']}: the cheapest configuration that adds less than {LITTLE:g} of the "
        f"sensor's own error"
    )
    if not changed:
        return f"{head} is what the scene has, {ns_text(scene['ns'])} ns a target-scan."
    saved = 1 - cheapest["ns"] / scene["ns"]
    much = f"{saved:.0%} less" if saved >= 0 else f"{-saved:.0%} more"
    return (
        f"{head} takes {ns_text(cheapest['ns'])} ns a target-scan, {much} than the scene's "
        f"{ns_text(scene['ns'])}, and adds {share_text(cheapest['share'])} "
        f"(the scene's: {share_text(scene['share'])}): {'; '.join(changed)}."
    )


def _sensor_lines(sensor: Values) -> Iterator[str]:
    own = sensor["own"]
    yield f"\n{sensor['id']} ({sensor['type']}), its own error, rms: {errors_text(own)}"
    yield f"  {'':14}  {'':32}{'ns':>10}  {'':24}{'of its own':>10}  error added"
    for stage in sensor["stages"]:
        for i, method in enumerate(stage["methods"]):
            yield _method_line("" if i else stage["stage"], method)
    costs = "  ".join(f"{b['targets']:,}: {ns_text(b['ns']['median'])}" for b in sensor["batches"])
    yield f"  {'targets at once':14} {costs}"
    for name in ("scene", "cheapest"):
        found = sensor["configurations"][name]
        if found is not None:
            yield (
                f"  {name:14}  {'all stages together':32}{ns_text(found['ns']):>10}  {'':24}"
                f"{share_text(found['share']):>10}  {errors_text(found['errors'])}"
            )


def _method_line(stage: str, method: Values) -> str:
    mark = f"{'>' if method['ours'] else ' '}{'*' if method['on_front'] else ' '}"
    ns = method["ns"]
    spread = f"({ns_text(ns['low'])} to {ns_text(ns['high'])})"
    return (
        f"  {stage:14}{mark}{method['method']:32}{ns_text(ns['median']):>10}  {spread:24}"
        f"{share_text(method['share']):>10}  {errors_text(method['errors'])}"
    )


# The figures: one a stage, one of batch sizes, one of whole configurations.

COLUMNS = 2
PANEL_INCHES = (6.6, 4.7)
TITLE_AND_LEGEND_INCHES = 0.9
LEAST_SHARE, LARGEST_SHARE = 1e-12, 1e6
"""Smaller shares are none, and larger ones are drawn there."""
SCENE, FRONT, OTHER, CHEAP = "#c2410c", "#1d4ed8", "#64748b", "#15803d"
COST_LABEL = "ns a target-scan"
SHARE_LABEL = "error added, beside the sensor's own"

Panel = Callable[[Any], list[Label]]


def draw_chart(chart: Chart, folder: Path, picture: str) -> list[Path]:
    """Draw all figures into a folder, as .png or .svg; their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, title, panels in _figures(chart):
        path = folder / f"{name}.{picture}"
        _draw_panels(f"{title}: scene {chart.scene}", panels, path)
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


def _draw_panels(title: str, panels: Mapping[str, Panel], path: Path) -> None:
    columns = min(COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    size = PANEL_INCHES[0] * columns, PANEL_INCHES[1] * rows + TITLE_AND_LEGEND_INCHES
    with figure_of(size, title, size=12 if columns > 1 else 10) as figure:
        places = figure.subplots(rows, columns, squeeze=False).flatten()
        for unused in places[len(panels) :]:
            unused.remove()
        labels = []
        for axes, (name, panel) in zip(places, panels.items(), strict=False):
            axes.set_title(name, fontsize=11, loc="left", fontweight="bold")
            labels.append((axes, panel(axes)))
        if "" not in panels:  # of which it would say nothing
            _legend(figure, columns)
        place_labels(figure, labels)
        save_picture(figure, path)


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

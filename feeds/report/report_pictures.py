"""The report drawn: what was asked as broken lines, what was delivered as whole ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np

from plotfeed.feeds.console.extras import NO_DATE, save_figure
from plotfeed.feeds.console.printed import printable
from plotfeed.feeds.report.expected_plots import QUANTITIES
from plotfeed.feeds.report.figures import LedgerReport, SensorFigures
from plotfeed.feeds.report.link_figures import LinkFigures, link_text
from plotfeed.feeds.report.spreads import share_interval

INCHES = (16.5, 9.3)
DPI = 110
COLOURS = ("#1d4ed8", "#c2410c", "#15803d", "#7e22ce", "#0e7490", "#a16207", "#be123c", "#475569")
INK, QUIET = "#1e293b", "#94a3b8"
ASKED: Mapping[str, Any] = {"ls": (0, (4, 2)), "lw": 2.2, "alpha": 0.55}
DOTTED = (0, (3, 1, 1, 1, 1, 1))
LINES = dict(zip(QUANTITIES, ("-", "-.", "--", ":", DOTTED, (0, (6, 3))), strict=True))
BURSTS_DRAWN = 30
FEWEST_LOOKS = 5
"""Of a bin of ranges that is drawn."""
LEGEND_LETTERS, LEGEND_LINES = 70, 5
LEAST_LATE_MS = 1e-3
MOST_SPREAD = 30.0
"""Of median delays, beyond which their axis is logarithmic."""


@dataclass(frozen=True, slots=True)
class Chosen:
    """What is drawn of a report: as many as there are colours."""

    links: Sequence[tuple[str, LinkFigures]]
    """With colours."""
    sensors: Sequence[tuple[str, SensorFigures]]
    left_out: int
    """Links that are not drawn."""
    curve: Sequence[float]
    edges: Sequence[float]

    @classmethod
    def of(cls, told: LedgerReport) -> Chosen:
        """A sensor has the colour of its first link."""
        links = [link for link in told.links if link.messages][: len(COLOURS)]
        coloured = list(zip(COLOURS, links, strict=False))
        colours = {link.sensor: colour for colour, link in reversed(coloured)}
        spare = iter(COLOURS[len(links) :])
        sensors = [
            (colours.get(sensor.sensor) or next(spare, INK), sensor)
            for sensor in told.sensors
            if sensor.sensor in colours or not told.links
        ]
        left_out = len(told.links) - len(links)
        return cls(coloured, sensors[: len(COLOURS)], left_out, told.curve, told.normalised_edges)


def draw(told: LedgerReport, path: Path) -> None:
    """Write the picture, in the format that its name says."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    chosen = Chosen.of(told)
    with mpl.rc_context({"svg.hashsalt": "plotfeed", "font.size": 9.5, "axes.titlesize": 11}):
        figure: Any = Figure(figsize=INCHES, dpi=DPI, layout="constrained")
        figure.suptitle(_title(told), fontsize=13)
        panels = (_delays, _bursts, _detection, _lateness, _errors, _legend)
        for panel, axes in zip(panels, figure.subplots(2, 3).flat, strict=True):
            panel(axes, chosen)
        save_figure(figure, path, metadata=NO_DATE[path.suffix.lower()])


def _title(told: LedgerReport) -> str:
    name = told.scene or Path(told.file).name
    return f"{printable(name)}: asked and delivered, by {told.entries:,} entries of the ledger"


def _delays(axes: Any, chosen: Chosen) -> None:
    medians, ends_ms = [], []
    for colour, link in chosen.links:
        if link.asked is not None and link.sent:
            axes.plot(link.asked.curve_ms, chosen.curve, color=colour, **ASKED)
        if link.sent:
            axes.plot(link.delivered.curve_ms, chosen.curve, color=colour, lw=1.1)
            medians.append(link.delivered.p50_ms)
            asked_ms = 0.0 if link.asked is None else link.asked.max_ms
            ends_ms.append(max(asked_ms, link.delivered.p99_ms))
    if medians and min(medians) > 0 and max(medians) > MOST_SPREAD * min(medians):
        axes.set_xscale("log")
    if ends_ms and max(ends_ms) > 0:  # the last hundredth may be far away
        axes.set_xlim(right=1.05 * max(ends_ms))
    _finish(axes, "Delay", "ms from being handed over to sending", "share of messages")
    _say_if(axes, not medians, "nothing left")


def _lateness(axes: Any, chosen: Chosen) -> None:
    """The share that left later still, so that the tail can be seen."""
    later = 1 - np.array(chosen.curve)
    drawn = False
    for colour, link in chosen.links:
        late_ms = np.array(link.lateness.curve_ms)
        if link.sent and late_ms[-1] >= LEAST_LATE_MS:
            later_still = np.where(later > 0, later, 1 / max(link.sent, 1000))
            axes.plot(np.maximum(late_ms, LEAST_LATE_MS), later_still, color=colour, lw=1.1)
            drawn = True
    if drawn:
        axes.set_xscale("log")
        axes.set_yscale("log")
    _finish(axes, "Lateness of the engine", "ms after the link let them leave", "share later still")
    _say_if(axes, not drawn, "all left when they were due")


def _bursts(axes: Any, chosen: Chosen) -> None:
    drawn = False
    for colour, link in chosen.links:
        bursts = link.bursts
        if not bursts.bursts:
            continue
        drawn = True
        lengths = np.arange(1, min(len(bursts.asked_survival), BURSTS_DRAWN) + 1)
        asked = np.array(bursts.asked_survival)[: len(lengths)]
        shown = asked > 0.2 / bursts.bursts
        axes.plot(lengths[shown], asked[shown], color=colour, **ASKED)
        delivered = np.array(bursts.delivered_survival)[: len(lengths)]
        _points(axes, lengths, delivered, bursts.bursts, colour)
    if drawn:
        axes.set_yscale("log")
        axes.xaxis.get_major_locator().set_params(integer=True)
    _finish(axes, "Bursts of losses", "messages lost in a row", "share as long or longer")
    _say_if(axes, not drawn, "no bursts of losses")


def _points(axes: Any, x: Any, shares: Any, of: int, colour: str) -> None:
    """Shares of so many with their 95 % intervals."""
    there = shares > 0
    x, shares = x[there], shares[there]
    intervals = [share_interval(round(share * of), of) for share in shares]
    _bars(axes, x, shares, np.array(intervals).T, colour)


def _bars(axes: Any, x: Any, y: Any, interval: Any, colour: str) -> None:
    low, high = interval
    spans = np.maximum([y - low, high - y], 0)
    axes.errorbar(x, y, yerr=spans, color=colour, fmt="o", ms=3.5, lw=1.1, capsize=2)


def _detection(axes: Any, chosen: Chosen) -> None:
    drawn = False
    for colour, sensor in chosen.sensors:
        bins = [at for at in sensor.looks_by_range if at.looks >= FEWEST_LOOKS]
        if not bins:
            continue
        drawn = True
        x_km = np.array([(at.from_m + at.to_m) / 2000 for at in bins])
        axes.plot(x_km, [at.asked for at in bins], color=colour, **ASKED)
        delivered, *interval = np.array([(at.delivered, at.low, at.high) for at in bins]).T
        _bars(axes, x_km, delivered, interval, colour)
    if drawn:
        axes.set_ylim(-0.03, 1.03)
        axes.set_xlim(left=0)
    _finish(axes, "Detection", "true range, km", "probability of detection, share detected")
    _say_if(axes, not drawn, "nobody was looked at")


def _errors(axes: Any, chosen: Chosen) -> None:
    from matplotlib.lines import Line2D

    x = np.linspace(chosen.edges[0], chosen.edges[-1], 300)
    axes.fill_between(x, np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi), color=QUIET, alpha=0.35, lw=0)
    step = chosen.edges[2] - chosen.edges[0]
    used = []
    for colour, sensor in chosen.sensors:
        for error in sensor.errors:
            if error.compared:
                counts = np.array(error.histogram).reshape(-1, 2).sum(axis=1)
                density, line = counts / (error.compared * step), LINES[error.quantity]
                axes.stairs(density, chosen.edges[::2], color=colour, ls=line, lw=1.1)
                used.append(error.quantity)
    handles = [
        Line2D([], [], color=INK, ls=LINES[name], label=name) for name in dict.fromkeys(used)
    ]
    if handles:
        asked = Line2D([], [], color=QUIET, lw=6, alpha=0.35, label="asked: N(0, 1)")
        axes.legend(handles=[asked, *handles], frameon=False, fontsize=8.5, loc="upper right")
    axes.set_xlim(-5, 5)
    _finish(axes, "Errors of plots", "error over its standard deviation", "density")
    _say_if(axes, not used, "no plots whose error is known")


def _legend(axes: Any, chosen: Chosen) -> None:
    """The legend: which colour is whose, and what it asked."""
    from matplotlib.lines import Line2D

    axes.axis("off")
    handles = [
        Line2D([], [], color=INK, label="asked", **ASKED),
        Line2D([], [], color=INK, lw=1.1, marker="o", ms=3.5, label="delivered, bars: 95 %"),
    ]
    for colour, link in chosen.links:
        text = f"{link.sensor}, link {link.number}: {link_text(link.link)}; {_verdict(link)}"
        handles.append(Line2D([], [], color=colour, lw=3, label=_fit_in(text)))
    if not chosen.links:
        handles += [
            Line2D([], [], color=colour, lw=3, label=printable(sensor.sensor))
            for colour, sensor in chosen.sensors
        ]
    if chosen.left_out:
        handles.append(Line2D([], [], lw=0, label=f"and {chosen.left_out} more, not drawn"))
    axes.legend(handles=handles, loc="upper left", frameon=False, fontsize=9, labelspacing=0.9)


def _verdict(link: LinkFigures) -> str:
    """A verdict on whether the delays can be those that were asked for."""
    fit = link.fit
    if fit.not_comparable or not isfinite(fit.p_value):
        return f"delay not compared: {fit.not_comparable or 'too few'}"
    return f"delay: KS {fit.distance:.4f}, p {fit.p_value:.2g}"


def _fit_in(text: str) -> str:
    """Some lines of it; matplotlib takes a dollar for mathematics."""
    lines = wrap(printable(text), LEGEND_LETTERS, break_on_hyphens=False)
    if len(lines) > LEGEND_LINES:
        lines = [*lines[: LEGEND_LINES - 1], f"... {lines[-1]}"]
    return "\n".join(lines).replace("$", r"\$")


def _finish(axes: Any, title: str, x: str, y: str) -> None:
    axes.set_title(title, loc="left", fontweight="bold")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(visible=True, alpha=0.3)


def _say_if(axes: Any, nothing: bool, what: str) -> None:
    if nothing:
        axes.set_xticks([])
        axes.set_yticks([])
        axes.text(0.5, 0.5, what, transform=axes.transAxes, ha="center", color=QUIET, fontsize=11)

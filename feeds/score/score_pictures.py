"""A score drawn: over time, by drone, and how errors are spread; as SVG, the same to the byte."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import numpy as np

from plotfeed.feeds.console.extras import NO_DATE
from plotfeed.feeds.console.printed import printable
from plotfeed.feeds.score.score_figures import Score
from plotfeed.models.state import Floats
from plotfeed.proto.utc import NS

INCHES = (11.0, 3.0)
MOST_POINTS = 1200
"""Of a line: more are drawn as means."""
MOST_DRONES = 60
"""In the chart of drones: the first ones."""
BLUE, ORANGE, RED, GREY, GREEN = "#1d4ed8", "#c2410c", "#be123c", "#94a3b8", "#15803d"
BINS = 60
NAME = 16


def charts(score: Score) -> dict[str, str]:
    """Charts by their titles, each as an SVG element; needs matplotlib."""
    drawn: dict[str, Callable[[Any, Score], None]] = {
        "GOSPA over time, and its parts": _gospa,
        "Drones and tracks over time": _counts,
        "When each drone had a track": _drones,
        "Errors of reports over time": _errors,
        "How large errors are": _spread,
    }
    if np.isfinite(score.errors.nees).any():
        drawn["NEES over its degrees of freedom: 1 for an honest tracker"] = _nees
    if np.isfinite(score.errors.latency_s).any():
        drawn["Latency of reports"] = _latency
    return {title: _svg(draw, score) for title, draw in drawn.items()}


def _svg(draw: Callable[[Any, Score], None], score: Score) -> str:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    settings: Any = {"svg.hashsalt": "plotfeed", "svg.fonttype": "none", "font.size": 9.0}
    with mpl.rc_context(settings):
        figure: Any = Figure(figsize=INCHES, layout="constrained")
        axes = figure.subplots()
        draw(axes, score)
        axes.grid(visible=True, alpha=0.3)
        octets = io.BytesIO()
        figure.savefig(octets, format="svg", metadata=NO_DATE[".svg"])
    text = octets.getvalue().decode()
    return text[text.index("<svg") :]


def _since_s(score: Score) -> Floats:
    return (score.over_time.t_utc_ns - score.start_utc_ns) / NS


def _thinned(x: Floats, *columns: Floats) -> list[Floats]:
    """Columns, or means of neighbours where there are too many to be drawn."""
    every = -(-len(x) // MOST_POINTS)
    if every <= 1:
        return [x, *columns]
    whole = len(x) // every * every
    return [column[:whole].reshape(-1, every).mean(axis=1) for column in (x, *columns)]


def _gospa(axes: Any, score: Score) -> None:
    steps, power = score.over_time.steps, 1.0 / score.settings.order
    total = (steps.localisation + steps.missed + steps.false) ** power
    x, total, location, missed, false = _thinned(
        _since_s(score),
        total,
        steps.localisation**power,
        steps.missed**power,
        steps.false**power,
    )
    axes.plot(x, missed, color=RED, lw=0.9, label="drones without a track")
    axes.plot(x, false, color=ORANGE, lw=0.9, label="tracks of no drone")
    axes.plot(x, location, color=GREEN, lw=0.9, label="localisation")
    axes.plot(x, total, color=BLUE, lw=1.4, label="GOSPA")
    _finish(axes, "s", "m")


def _counts(axes: Any, score: Score) -> None:
    steps = score.over_time.steps
    x, drones, tracks, tracked = _thinned(
        _since_s(score),
        steps.drones.astype(np.float64),
        steps.tracks.astype(np.float64),
        steps.tracked.astype(np.float64),
    )
    axes.plot(x, drones, color=GREY, lw=2.4, label="drones")
    axes.plot(x, tracks, color=ORANGE, lw=0.9, label="tracks")
    axes.plot(x, tracked, color=BLUE, lw=1.1, label="drones that have one")
    _finish(axes, "s", "")


def _drones(axes: Any, score: Score) -> None:
    shown, step_s = min(len(score.drones), MOST_DRONES), score.settings.step_s
    since_s = _since_s(score)
    for number in range(shown):
        for there, colour, height in (
            (score.over_time.there[:, number], GREY, 0.7),
            (score.over_time.tracked[:, number], BLUE, 0.4),
        ):
            edges = np.diff(np.concatenate([[0], there.astype(np.int8), [0]]))
            begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
            stretches = [
                (float(since_s[a]), float((b - a) * step_s))
                for a, b in zip(begins, ends, strict=True)
            ]
            axes.broken_barh(stretches, (number - height / 2, height), color=colour, lw=0)
    if shown <= 25:
        names = [_plain(each.drone) for each in score.drones[:shown]]
        axes.set_yticks(range(shown), names)
    axes.set_ylim(max(shown, 1) - 0.5, -0.5)
    rest = len(score.drones) - shown
    more = f"; {rest} more are not drawn" if rest else ""
    axes.set_xlabel(f"s; grey: in cover, blue: with a track{more}")


def _errors(axes: Any, score: Score) -> None:
    errors = score.errors
    if not len(errors):
        _nothing(axes)
        return
    every = -(-len(errors) // MOST_POINTS)
    order = np.argsort(errors.t_utc_ns, kind="stable")[::every]
    since_s = (errors.t_utc_ns[order] - score.start_utc_ns) / NS
    axes.plot(since_s, errors.distance_m[order], ".", color=BLUE, ms=2.0, label="one report")
    axes.axhline(score.reports.position_rms_m, color=ORANGE, lw=1.2, label="rms")
    axes.axhline(score.reports.position_p95_m, color=RED, lw=1.2, label="95 %")
    axes.set_ylim(bottom=0)
    _finish(axes, "s", f"m {score.distances}")


def _spread(axes: Any, score: Score) -> None:
    errors = score.errors
    if not len(errors):
        _nothing(axes)
        return
    for column, name, colour in ((0, "east", BLUE), (1, "north", ORANGE), (2, "up", GREEN)):
        each_m = errors.error_enu_m[:, column]
        each_m = each_m[np.isfinite(each_m)]
        if len(each_m):
            counts, edges = np.histogram(each_m, BINS)
            axes.stairs(counts, edges, color=colour, lw=1.1, label=name)
    _finish(axes, "m", "reports")


def _nees(axes: Any, score: Score) -> None:
    errors = score.errors
    tested = np.isfinite(errors.nees)
    order = np.argsort(errors.t_utc_ns[tested], kind="stable")
    since_s = (errors.t_utc_ns[tested][order] - score.start_utc_ns) / NS
    each = errors.nees[tested][order] / score.dimensions
    bins = np.linspace(0, max(float(since_s[-1]), 1e-9), min(BINS, max(len(each) // 5, 1)) + 1)
    which = np.clip(np.digitize(since_s, bins) - 1, 0, len(bins) - 2)
    many = np.bincount(which, minlength=len(bins) - 1)
    means = np.bincount(which, each, len(bins) - 1) / np.where(many, many, np.nan)
    axes.plot((bins[:-1] + bins[1:]) / 2, means, color=BLUE, lw=1.1, marker=".", label="mean")
    axes.axhline(1.0, color=GREY, lw=1.2, label="as claimed")
    axes.set_yscale("log")
    _finish(axes, "s", "")


def _latency(axes: Any, score: Score) -> None:
    late_s = score.errors.latency_s[np.isfinite(score.errors.latency_s)]
    counts, edges = np.histogram(late_s, BINS)
    axes.stairs(counts, edges, color=BLUE, lw=1.1, fill=True, alpha=0.4)
    axes.axvline(score.reports.latency_p95_s, color=RED, lw=1.2, label="95 %")
    _finish(axes, "s from the time of a report to when it was received", "reports")


def _nothing(axes: Any) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    axes.text(0.5, 0.5, "no track was of a drone", transform=axes.transAxes, ha="center")


def _plain(name: str) -> str:
    """A name as matplotlib shows it, which takes a dollar for mathematics."""
    return printable(name)[:NAME].replace("$", r"\$")


def _finish(axes: Any, x: str, y: str) -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8.5)

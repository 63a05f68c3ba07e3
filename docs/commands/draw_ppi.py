"""Draws docs/ppi.png: what the radar of section-4 reports while the drone comes in.

python docs/commands/draw_ppi.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import patheffects
from matplotlib.colors import LinearSegmentedColormap
from section_4 import START_UTC_NS, scene_with, simulated

from plotfeed.feeds.engine.simulation import SimulatedSensor

mpl.use("agg")
from matplotlib import pyplot as plt

PICTURE = Path(__file__).parents[1] / "ppi.png"
SECONDS = 240.0
RANGE_KM = 10.0
ZOOM_M = (420.0, 80.0)  # Along and across the line of sight

NIGHT, SEA, GRID, INK, QUIET = "#071018", "#0b1924", "#24485a", "#dbe9ee", "#7fa0ad"
ALARM, TRACK = "#ff9d5c", "#ffffff"
AGE = LinearSegmentedColormap.from_list("age", ["#e8fff0", "#4df0b4", "#159a8c", "#1c5a78"])

mpl.rcParams.update(
    {
        "font.family": "DejaVu Sans",
        "font.size": 11,
        "text.color": INK,
        "axes.edgecolor": GRID,
        "axes.labelcolor": QUIET,
        "xtick.color": QUIET,
        "ytick.color": QUIET,
        "figure.facecolor": NIGHT,
        "axes.facecolor": SEA,
        "savefig.facecolor": NIGHT,
        "svg.hashsalt": "plotfeed",
    }
)


class ShownPlots:
    """Columns of the plots of one run: of the drone, and false; and of the looks that missed."""

    def __init__(self, seen: SimulatedSensor) -> None:
        plots, looks = seen.plots, seen.looks
        t_s = (plots.t_utc_ns - START_UTC_NS) / 1e9
        true, false = plots.drone >= 0, plots.drone < 0
        self.t_s, self.false_t_s = t_s[true], t_s[false]
        self.range_m, self.false_range_m = plots.range_m[true], plots.range_m[false]
        azimuth = np.radians(plots.azimuth_deg)
        self.azimuth, self.false_azimuth = azimuth[true], azimuth[false]
        self.true_range_m = plots.true_range_m[true]
        self.true_azimuth = np.radians(plots.true_azimuth_deg[true])
        self.looks = len(looks)
        self.missed_range_m = looks.range_m[~looks.detected]
        self.missed_azimuth = np.radians(looks.azimuth_deg[~looks.detected])


def draw() -> None:
    """The display at the left; what it means, and a part of it enlarged, at the right."""
    plots = ShownPlots(simulated(scene_with("active"), SECONDS)["active"])
    figure = plt.figure(figsize=(16, 10), dpi=100)
    display = figure.add_axes((0.03, 0.05, 0.5625, 0.9), projection="polar")
    _rose(display)
    _plots(display, plots)
    points = _legend(figure, plots)
    _age_bar(figure, points)
    _zoom(figure, display, plots)
    figure.savefig(PICTURE, metadata={"Software": None})
    print(f"{PICTURE}: {len(plots.t_s)} plots, {len(plots.false_t_s)} false alarms")


def _rose(axes: Any) -> None:
    """Rings and spokes; north up, clockwise."""
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    axes.set_ylim(0, RANGE_KM)
    axes.grid(visible=False)
    axes.spines["polar"].set_color(GRID)
    axes.spines["polar"].set_linewidth(1.5)
    circle = np.linspace(0, 2 * np.pi, 361)
    for ring_km in range(1, int(RANGE_KM)):
        major = ring_km % 2 == 0
        axes.plot(circle, np.full_like(circle, ring_km), color=GRID, lw=1.0 if major else 0.4)
    for degrees in range(0, 360, 10):
        inner = 0.4 if degrees % 30 == 0 else RANGE_KM - 0.18
        axes.plot([np.radians(degrees)] * 2, [inner, RANGE_KM], color=GRID, lw=0.8)
    axes.set_xticks(np.radians(range(0, 360, 30)))
    axes.set_xticklabels(["N", *(f"{d:03d}°" for d in range(30, 360, 30))], fontsize=12)
    axes.tick_params(axis="x", pad=7, colors=INK)
    axes.set_yticks([])
    for ring_km in (2, 4, 6, 8, 10):
        label = f"{ring_km} km" if ring_km < RANGE_KM else ""
        text = axes.text(np.radians(285), ring_km, label, color=QUIET, ha="center", va="center")
        text.set_path_effects([patheffects.withStroke(linewidth=4, foreground=SEA)])


def _plots(axes: Any, plots: ShownPlots) -> None:
    age_s = SECONDS - plots.false_t_s
    axes.scatter(
        plots.false_azimuth,
        plots.false_range_m / 1000,
        s=36,
        marker="x",
        linewidths=1.3,
        color=[(*mpl.colors.to_rgb(ALARM), 0.95 - 0.65 * a / SECONDS) for a in age_s],
        zorder=3,
    )
    axes.plot(plots.true_azimuth, plots.true_range_m / 1000, color=TRACK, lw=0.8, zorder=6)
    axes.scatter(
        plots.azimuth,
        plots.range_m / 1000,
        s=30,
        c=SECONDS - plots.t_s,
        cmap=AGE,
        vmin=0,
        vmax=SECONDS,
        linewidths=0,
        zorder=5,
    )
    axes.scatter([0], [0], s=90, marker="^", color=INK, zorder=6)
    outline = [patheffects.withStroke(linewidth=4, foreground=SEA)]
    note = {"color": INK, "fontsize": 13, "zorder": 7, "path_effects": outline}
    axes.annotate("radar", (0, 0), (12, -16), textcoords="offset points", **note)
    where = (plots.azimuth[-1], plots.range_m[-1] / 1000)
    axes.annotate("drone, now", where, (-86, 10), textcoords="offset points", **note)
    where = (plots.azimuth[0], plots.range_m[0] / 1000)
    axes.annotate(f"{SECONDS / 60:g} min ago", where, (8, 10), textcoords="offset points", **note)


def _legend(figure: Any, plots: ShownPlots) -> Any:
    """Words at the right, counted in this very run."""
    x = 0.635
    figure.text(x, 0.925, "What the radar reports", fontsize=23, weight="bold")
    lines = (
        f"A Phantom 4 of 0.01 m² flies straight in at 20 m/s, 50 m up.\n"
        f"The radar turns once a second: {SECONDS:g} scans. True north is up."
    )
    figure.text(x, 0.872, lines, fontsize=12.5, color=QUIET, linespacing=1.5, va="center")
    axes = figure.add_axes((x, 0.625, 0.345, 0.2))
    axes.set_axis_off()
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    points = axes.scatter(
        np.linspace(0.015, 0.085, 4), [0.84] * 4, s=60, c=[0, 80, 160, 240], cmap=AGE, vmin=0,
        vmax=SECONDS,
    )  # fmt: skip
    told = f"plots of the drone: {len(plots.t_s)} of {plots.looks} looks"
    axes.text(0.13, 0.84, told, va="center",
              fontsize=13)  # fmt: skip
    axes.scatter([0.05], [0.6], s=60, marker="x", color=ALARM, linewidths=1.6)
    rate = len(plots.false_t_s) / SECONDS
    axes.text(0.13, 0.6, f"false alarms: {len(plots.false_t_s)}, {rate:.2f} a scan", va="center",
              fontsize=13)  # fmt: skip
    axes.plot([0.015, 0.085], [0.36, 0.36], color=TRACK, lw=1)
    axes.text(0.13, 0.36, "where it truly was: for you, not for the tracker", va="center",
              fontsize=13)  # fmt: skip
    return points


def _age_bar(figure: Any, points: Any) -> None:
    axes = figure.add_axes((0.635, 0.617, 0.335, 0.013))
    bar = figure.colorbar(points, cax=axes, orientation="horizontal")
    bar.outline.set_visible(False)
    bar.set_ticks([0, 60, 120, 180, 240], labels=["now", "1 min ago", "2", "3", "4"])
    bar.ax.tick_params(length=0, labelsize=11)


def _zoom(figure: Any, display: Any, plots: ShownPlots) -> None:
    """Some seconds of the approach along and across the line of sight."""
    middle = len(plots.t_s) // 8
    range_m, azimuth = plots.true_range_m[middle], plots.true_azimuth[middle]
    axes = figure.add_axes((0.665, 0.095, 0.305, 0.37))
    across_m = plots.range_m * np.sin(plots.azimuth - azimuth)
    along_m = plots.range_m * np.cos(plots.azimuth - azimuth) - range_m
    true_across_m = plots.true_range_m * np.sin(plots.true_azimuth - azimuth)
    true_along_m = plots.true_range_m * np.cos(plots.true_azimuth - azimuth) - range_m
    near = np.abs(along_m) < ZOOM_M[0] / 2
    for true, measured in zip(
        np.column_stack([true_along_m, true_across_m])[near],
        np.column_stack([along_m, across_m])[near],
        strict=True,
    ):
        axes.plot(*zip(true, measured, strict=True), color=QUIET, lw=0.7, zorder=2)
    axes.plot(true_along_m, true_across_m, color=TRACK, lw=1, marker="|", ms=9, zorder=3)
    axes.scatter(
        along_m[near], across_m[near], s=60, c=SECONDS - plots.t_s[near], cmap=AGE, vmin=0,
        vmax=SECONDS, linewidths=0, zorder=4,
    )  # fmt: skip
    missed_m = plots.missed_range_m * np.cos(plots.missed_azimuth - azimuth) - range_m
    for along in missed_m[np.abs(missed_m) < ZOOM_M[0] / 2]:
        axes.annotate("missed", (along, 2), (along, 14), ha="center", color=QUIET,
                      arrowprops={"arrowstyle": "-", "color": QUIET})  # fmt: skip
    axes.set_xlim(ZOOM_M[0] / 2, -ZOOM_M[0] / 2)
    axes.set_ylim(-ZOOM_M[1] / 2, ZOOM_M[1] / 2)
    axes.set_xlabel("metres along the line of sight; the radar is to the right")
    axes.set_ylabel("across it")
    axes.grid(color=GRID, lw=0.5)
    axes.set_title(
        f"The box, enlarged: plots and the truth at {range_m / 1000:.1f} km",
        loc="left", fontsize=13, color=INK, pad=12,
    )  # fmt: skip
    half_m, width = ZOOM_M[0] / 2, 130.0 / range_m
    corners = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1], [-1, -1]])
    display.plot(
        azimuth + corners[:, 1] * width, (range_m + corners[:, 0] * half_m) / 1000, color=INK,
        lw=1.2, zorder=8,
    )  # fmt: skip


if __name__ == "__main__":
    draw()

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
from section_4 import START_UTC_NS, Floats, of_drone, scene_with, simulated

from plotfeed.feeds.engine.simulation import SimulatedPlots, SimulatedSensor

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


def draw() -> None:
    """The display at the left; what it means, and a part of it enlarged, at the right."""
    seen = simulated(scene_with("active"), SECONDS)["active"]
    plots, false = of_drone(seen), seen.plots.rows(seen.plots.drone < 0)
    figure = plt.figure(figsize=(16, 10), dpi=100)
    display = figure.add_axes((0.03, 0.05, 0.5625, 0.9), projection="polar")
    _rose(display)
    _plots(display, plots, false)
    points = _legend(figure, plots, len(seen.looks), len(false))
    _age_bar(figure, points)
    _zoom(figure, display, plots, seen)
    figure.savefig(PICTURE, metadata={"Software": None})
    print(f"{PICTURE}: {len(plots)} plots, {len(false)} false alarms")


def _age_s(plots: SimulatedPlots) -> Floats:
    return SECONDS - (plots.t_utc_ns - START_UTC_NS) / 1e9


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


def _plots(axes: Any, plots: SimulatedPlots, false: SimulatedPlots) -> None:
    azimuth, range_km = np.radians(plots.azimuth_deg), plots.range_m / 1000
    axes.scatter(
        np.radians(false.azimuth_deg),
        false.range_m / 1000,
        s=36,
        marker="x",
        linewidths=1.3,
        color=[(*mpl.colors.to_rgb(ALARM), 0.95 - 0.65 * a / SECONDS) for a in _age_s(false)],
        zorder=3,
    )
    true_azimuth = np.radians(plots.true_azimuth_deg)
    axes.plot(true_azimuth, plots.true_range_m / 1000, color=TRACK, lw=0.8, zorder=6)
    axes.scatter(
        azimuth,
        range_km,
        s=30,
        c=_age_s(plots),
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
    for row, words, off in (
        (-1, "drone, now", (-86, 10)),
        (0, f"{SECONDS / 60:g} min ago", (8, 10)),
    ):
        where = (azimuth[row], range_km[row])
        axes.annotate(words, where, off, textcoords="offset points", **note)


def _legend(figure: Any, plots: SimulatedPlots, looks: int, false: int) -> Any:
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
    axes.scatter([0.05], [0.6], s=60, marker="x", color=ALARM, linewidths=1.6)
    axes.plot([0.015, 0.085], [0.36, 0.36], color=TRACK, lw=1)
    for y, told in (
        (0.84, f"plots of the drone: {len(plots)} of {looks} looks"),
        (0.6, f"false alarms: {false}, {false / SECONDS:.2f} a scan"),
        (0.36, "where it truly was: for you, not for the tracker"),
    ):
        axes.text(0.13, y, told, va="center", fontsize=13)
    return points


def _age_bar(figure: Any, points: Any) -> None:
    axes = figure.add_axes((0.635, 0.617, 0.335, 0.013))
    bar = figure.colorbar(points, cax=axes, orientation="horizontal")
    bar.outline.set_visible(False)
    bar.set_ticks([0, 60, 120, 180, 240], labels=["now", "1 min ago", "2", "3", "4"])
    bar.ax.tick_params(length=0, labelsize=11)


def _zoom(figure: Any, display: Any, plots: SimulatedPlots, seen: SimulatedSensor) -> None:
    """Some seconds of the approach along and across the line of sight."""
    middle = len(plots) // 8
    range_m, azimuth = plots.true_range_m[middle], np.radians(plots.true_azimuth_deg[middle])

    def enlarged(range_of_m: Floats, azimuth_deg: Floats) -> Floats:
        """Metres along the line of sight, and across it; (n, 2)."""
        off = np.radians(azimuth_deg) - azimuth
        return np.column_stack([range_of_m * np.cos(off) - range_m, range_of_m * np.sin(off)])

    axes = figure.add_axes((0.665, 0.095, 0.305, 0.37))
    there = enlarged(plots.range_m, plots.azimuth_deg)
    true = enlarged(plots.true_range_m, plots.true_azimuth_deg)
    near = np.abs(there[:, 0]) < ZOOM_M[0] / 2
    for of_one, measured in zip(true[near], there[near], strict=True):
        axes.plot(*zip(of_one, measured, strict=True), color=QUIET, lw=0.7, zorder=2)
    axes.plot(*true.T, color=TRACK, lw=1, marker="|", ms=9, zorder=3)
    axes.scatter(
        *there[near].T, s=60, c=_age_s(plots)[near], cmap=AGE, vmin=0, vmax=SECONDS, linewidths=0,
        zorder=4,
    )  # fmt: skip
    missed = seen.looks.rows(~seen.looks.detected)
    missed_m = enlarged(missed.range_m, missed.azimuth_deg)[:, 0]
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

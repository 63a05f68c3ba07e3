"""Draws docs/section-4-*.png: figures 4 to 8 of the paper, from one run of the example scene.

    python docs/commands/draw_section_4.py

The fifth, of many approaches, holds what was counted against what `plotfeed check` predicts.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.patches import Rectangle
from section_4 import (
    SENSORS,
    TITLES,
    Floats,
    across_m,
    angle_error_deg,
    distance_error_m,
    many_flights,
    of_drone,
    one_flight,
    place_m,
    predictions,
    scene_with,
)

from plotfeed.feeds.engine.simulation import SimulatedPlots, SimulatedSensor
from plotfeed.models.sensors.sensor_model import Prediction
from plotfeed.models.verdicts import TWO_SIDED_95

mpl.use("agg")
from matplotlib import pyplot as plt

COLOURS = {"active": "#0a7d6c", "passive": "#c8651b", "mimo": "#3b5bb5", "microphone": "#a3276f"}
MARKERS = {"active": "o", "passive": "D", "mimo": "s", "microphone": "^"}
GRID, QUIET, MISSED = "#dde3e6", "#5c6b73", "#9aa5ab"
DOCS = Path(__file__).parents[1]
FLIGHTS = 400
BIN_M = 250.0
NEAR_M = 450.0
Seen = Mapping[str, SimulatedSensor]
Predictions = dict[str, tuple[Floats, Prediction]]

mpl.rcParams.update(
    {
        "font.family": "DejaVu Sans",
        "font.size": 11,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.titlelocation": "left",
        "axes.titleweight": "bold",
        "axes.titlesize": 12,
        "figure.dpi": 100,
        "figure.titlesize": 14,
        "figure.constrained_layout.use": True,
        "grid.color": GRID,
        "legend.frameon": False,
        "svg.hashsalt": "plotfeed",
    }
)


def main() -> None:
    """All five pictures, and the counts beside them."""
    seen, predicted = one_flight(), predictions()
    for name in SENSORS:
        plots, looks, false = counts(seen[name])
        print(f"{name}: {plots} plots of the drone in {looks} looks, {false} false alarms")
    draw_map(seen)
    draw_drone(seen)
    draw_errors(7, "azimuth", "degrees", seen, predicted)
    draw_errors(8, "distance", "m", seen, predicted)
    draw_predicted(many_flights(FLIGHTS), predicted)


def counts(seen: SimulatedSensor) -> tuple[int, int, int]:
    """Plots of the drone, looks, and false alarms."""
    plots = len(of_drone(seen))
    return plots, len(seen.looks), len(seen.plots) - plots


def draw_map(sensors: Seen) -> None:
    """Figure 4: everything that was reported, and the surroundings of the facility enlarged."""
    figure, (whole, near) = plt.subplots(1, 2, figsize=(16, 8.6))
    circle = np.linspace(0, 2 * np.pi, 361)
    whole.plot(10 * np.sin(circle), 10 * np.cos(circle), color=QUIET, lw=0.8, ls=":")
    whole.annotate("10 km", (0, 10), (0, 4), textcoords="offset points", ha="center", color=QUIET)
    for azimuth in np.radians((15, 75)):
        whole.plot([0, 10 * np.sin(azimuth)], [0, 10 * np.cos(azimuth)],
                   color=COLOURS["passive"], lw=0.8, ls="--", alpha=0.7)  # fmt: skip
    for name in SENSORS:
        _scatter_map(whole, name, sensors[name], 1000.0)
        _scatter_map(near, name, sensors[name], 1.0)
    _dress_map(whole, 10.6, "km", "All plots; dashed, what the passive radar covers")
    _dress_map(near, NEAR_M, "m", f"The last {NEAR_M:g} m of the approach")
    half = NEAR_M / 1000
    box = Rectangle((-half, -half), 2 * half, 2 * half, fill=False, ec="black", lw=1.2, zorder=4)
    whole.add_patch(box)
    handles = [_key(name, sensors[name]) for name in SENSORS]
    whole.legend(handles=handles, loc="lower left", title="crosses: false alarms", frameon=True,
                 framealpha=0.95, edgecolor=GRID)  # fmt: skip
    (mimo,) = scene_with("mimo")["sensor"]
    for transmitter in mimo["transmitters"]:
        near.plot(transmitter["east_m"], transmitter["north_m"], marker="2", ms=13, mew=1.8,
                  color=COLOURS["mimo"])  # fmt: skip
    near.annotate("transmitters of the MIMO radar", (86.6, -50), (12, -14),
                  textcoords="offset points", color=COLOURS["mimo"])  # fmt: skip
    near.plot(0, 0, marker="P", ms=11, color="black")
    near.annotate("all receivers", (0, 0), (-12, -18), textcoords="offset points", ha="right")
    figure.suptitle("Figure 4: what the four sensors report while the drone comes in from 7 km")
    _save(figure, "section-4-map.png")


def _scatter_map(axes: Any, name: str, seen: SimulatedSensor, unit_m: float) -> None:
    east, north = (place / unit_m for place in place_m(seen.plots))
    false, size = seen.plots.drone < 0, 22 if unit_m > 1 else 34
    axes.scatter(east[false], north[false], marker="x", color=COLOURS[name], s=26, lw=1, alpha=0.7)
    axes.scatter(east[~false], north[~false], marker=MARKERS[name], s=size, alpha=0.6,
                 color=COLOURS[name], linewidths=0, zorder=3)  # fmt: skip


def _dress_map(axes: Any, half: float, unit: str, title: str) -> None:
    axes.set(aspect="equal", xlim=(-half, half), ylim=(-half, half), title=title,
             xlabel=f"east of the facility, {unit}", ylabel=f"north, {unit}")  # fmt: skip


def _key(name: str, seen: SimulatedSensor) -> Any:
    plots, _, false = counts(seen)
    label = f"{TITLES[name]}: {plots} plots of the drone, {false} false"
    (line,) = plt.plot([], [], color=COLOURS[name], marker=MARKERS[name], ls="", label=label)
    return line


def draw_drone(sensors: Seen) -> None:
    """Figures 5 and 6: plots of the drone, by its distance and, much enlarged, across its line."""
    figure, panels = plt.subplots(2, 2, figsize=(16, 8.4))
    for axes, name in zip(panels.T.flat, SENSORS, strict=True):
        plots, looks = of_drone(sensors[name]), sensors[name].looks
        half_m = _by_distance(axes, name, plots, across_m(plots), size=16)
        missed_m = looks.range_m[~looks.detected]
        axes.vlines(missed_m / 1000, -half_m, -0.92 * half_m, color=MISSED, lw=0.9)
        axes.set_xlim(1.03 if name == "microphone" else 7.2, 0)
        axes.set_ylabel("across the line of sight, m")
        title = f"{TITLES[name][0].upper()}{TITLES[name][1:]}"
        axes.set_title(f"{title}: {len(plots)} plots, {len(missed_m)} looks missed")
    figure.suptitle(
        "Figures 5 (left) and 6 (right): plots of the drone; ticks at the bottom are looks that "
        "missed it\nEach panel has scales of its own; the microphones' bearings are drawn at the "
        "true distance"
    )
    _save(figure, "section-4-drone.png")


def draw_errors(number: int, what: str, unit: str, sensors: Seen, predicted: Predictions) -> None:
    """Figures 7, of azimuth, and 8, of distance, which the microphones do not measure."""
    is_angle = what == "azimuth"
    names = [n for n in SENSORS if is_angle or np.isfinite(sensors[n].plots.range_m).any()]
    figure, panels = plt.subplots(1, len(names), figsize=(16, 4.9))
    for axes, name in zip(panels, names, strict=True):
        range_m, expected = predicted[name]
        sigma = 2 * (expected.sigma_azimuth_deg if is_angle else expected.sigma_range_m)
        inside = range_m <= 7200
        axes.fill_between(
            range_m[inside] / 1000, -sigma[inside], sigma[inside], color="#e9eef0", lw=0
        )
        plots = of_drone(sensors[name])
        error = angle_error_deg(plots) if is_angle else distance_error_m(plots)
        _by_distance(axes, name, plots, error, size=14)
        axes.set_xlim(0, 0.2 if name == "microphone" else 7.2)
        axes.set_title(TITLES[name])
    panels[0].set_ylabel(f"error of {what}, {unit}")
    about = "" if is_angle else " about the truth"
    figure.suptitle(f"Figure {number}: error of {what} of each plot of the drone; shaded, twice "
                    f"the predicted rms error{about}")  # fmt: skip
    _save(figure, f"section-4-{'angle' if is_angle else what}.png")


def _by_distance(
    axes: Any, name: str, plots: SimulatedPlots, values: Floats, *, size: float
) -> float:
    """Points of a sensor's plots by the drone's distance, about zero; half the panel's height."""
    axes.axhline(0, color="black", lw=0.8)
    axes.scatter(plots.true_range_m / 1000, values, s=size, color=COLOURS[name],
                 marker=MARKERS[name], linewidths=0, alpha=0.8, zorder=3)  # fmt: skip
    half = 1.15 * float(np.abs(values).max())
    axes.set_ylim(-half, half)
    axes.set_xlabel("distance of the drone, km")
    return half


def draw_predicted(sensors: Seen, predicted: Predictions) -> None:
    """Pd and rms errors by distance: lines as predicted, points as counted over many flights."""
    figure, (detected, turned, displaced) = plt.subplots(1, 3, figsize=(16, 5.6))
    for name in SENSORS:
        range_m, expected = predicted[name]
        looks, plots = sensors[name].looks, of_drone(sensors[name])
        style = {"color": COLOURS[name], "lw": 1.6, "label": TITLES[name]}
        detected.plot(range_m / 1000, expected.pd, **style)
        turned.semilogy(range_m / 1000, expected.sigma_azimuth_deg, **style)
        step_m = 20.0 if name == "microphone" else BIN_M
        _counted(detected, name, looks.range_m, looks.detected, step_m, root=False)
        _counted(turned, name, plots.true_range_m, angle_error_deg(plots) ** 2, step_m, root=True)
        if np.isfinite(plots.range_m).any():
            displaced.semilogy(range_m / 1000, expected.sigma_range_m, **style)
            off_m2 = distance_error_m(plots) ** 2
            _counted(displaced, name, plots.true_range_m, off_m2, step_m, root=True)
    for axes, title in (
        (detected, "Probability of detection"),
        (turned, "Rms error of azimuth, degrees"),
        (displaced, "Rms error of distance, m"),
    ):
        axes.set(title=title, xlabel="distance of the drone, km", xlim=(0, 7.2))
    turned.legend(loc="lower right")
    turned.set_ylim(5e-5, 4)
    displaced.set_ylim(2e-4, 40)
    looks_of_all = sum(len(sensors[name].looks) for name in SENSORS)
    figure.suptitle(f"Lines: what plotfeed check predicts. Points: {looks_of_all:,} looks at "
                    f"{FLIGHTS} approaches, with 95 % bars for Pd")  # fmt: skip
    _save(figure, "section-4-predicted.png")


def _counted(
    axes: Any, name: str, range_m: Floats, value: Floats, step_m: float, *, root: bool
) -> None:
    """Means, or roots of means, of values by distance, at the middle of what they came from."""
    box = (range_m // step_m).astype(int)
    for i in np.unique(box):
        here = box == i
        n = int(here.sum())
        if n < 100:
            continue
        mean = float(value[here].mean())
        half = 0.0 if root else TWO_SIDED_95 * np.sqrt(mean * (1 - mean) / n)
        height = mean**0.5 if root else mean
        axes.errorbar(float(range_m[here].mean()) / 1000, height, yerr=half or None, ms=4.2, lw=1.2,
                      marker=MARKERS[name], color=COLOURS[name], ls="", zorder=3)  # fmt: skip


def _save(figure: Any, file: str) -> None:
    figure.savefig(DOCS / file, metadata={"Software": None})
    plt.close(figure)


if __name__ == "__main__":
    main()

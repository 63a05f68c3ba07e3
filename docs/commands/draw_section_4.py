"""Draws docs/section-4-*.png: figures 4 to 8 of the paper, from one run of the example scene.

    python docs/commands/draw_section_4.py

The fifth, of many approaches, holds what was counted against what `plotfeed check` predicts.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.patches import Rectangle
from section_4 import (
    SENSORS,
    TITLES,
    Floats,
    Measured,
    many_flights,
    one_flight,
    predictions,
    scene_with,
)

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
        "figure.titlesize": 14,
        "grid.color": GRID,
        "legend.frameon": False,
        "svg.hashsalt": "plotfeed",
    }
)


def main() -> None:
    """All five pictures, and the counts beside them."""
    sensors = one_flight()
    predicted = predictions()
    for name, m in sensors.items():
        print(
            f"{name}: {m.of_drone.sum()} plots of the drone in {len(m.look_pd)} looks, "
            f"{(~m.of_drone).sum()} false alarms"
        )
    draw_map(sensors)
    draw_drone(sensors)
    draw_angle(sensors, predicted)
    draw_distance(sensors, predicted)
    flights = many_flights(FLIGHTS)
    draw_predicted({name: Measured.by(flights[name]) for name in SENSORS}, predicted)


def draw_map(sensors: dict[str, Measured]) -> None:
    """Figure 4: everything that was reported, and the surroundings of the facility enlarged."""
    figure, (whole, near) = plt.subplots(1, 2, figsize=(16, 8.6), dpi=100, layout="constrained")
    circle = np.linspace(0, 2 * np.pi, 361)
    whole.plot(10 * np.sin(circle), 10 * np.cos(circle), color=QUIET, lw=0.8, ls=":")
    whole.annotate("10 km", (0, 10), (0, 4), textcoords="offset points", ha="center", color=QUIET)
    for azimuth_deg in (15, 75):
        azimuth = np.radians(azimuth_deg)
        whole.plot([0, 10 * np.sin(azimuth)], [0, 10 * np.cos(azimuth)],
                   color=COLOURS["passive"], lw=0.8, ls="--", alpha=0.7)  # fmt: skip
    for name, m in sensors.items():
        _scatter_map(whole, name, m, 1000.0)
        _scatter_map(near, name, m, 1.0)
    _dress_map(whole, 10.6, "km", "All plots; dashed, what the passive radar covers")
    _dress_map(near, NEAR_M, "m", f"The last {NEAR_M:g} m of the approach")
    whole.add_patch(_box(NEAR_M / 1000))
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


def _scatter_map(axes: Any, name: str, m: Measured, unit_m: float) -> None:
    east, north = (place / unit_m for place in m.place_m())
    false, size = ~m.of_drone, 22 if unit_m > 1 else 34
    axes.scatter(east[false], north[false], marker="x", color=COLOURS[name], s=26, lw=1, alpha=0.7)
    axes.scatter(east[~false], north[~false], marker=MARKERS[name], s=size, alpha=0.6,
                 color=COLOURS[name], linewidths=0, zorder=3)  # fmt: skip


def _box(half: float) -> Rectangle:
    return Rectangle((-half, -half), 2 * half, 2 * half, fill=False, ec="black", lw=1.2, zorder=4)


def _dress_map(axes: Any, half: float, unit: str, title: str) -> None:
    axes.set_aspect("equal")
    axes.set_xlim(-half, half)
    axes.set_ylim(-half, half)
    axes.set_xlabel(f"east of the facility, {unit}")
    axes.set_ylabel(f"north, {unit}")
    axes.set_title(title)


def _key(name: str, m: Measured) -> Any:
    false = int((~m.of_drone).sum())
    label = f"{TITLES[name]}: {m.of_drone.sum()} plots of the drone, {false} false"
    (line,) = plt.plot([], [], color=COLOURS[name], marker=MARKERS[name], ls="", label=label)
    return line


def draw_drone(sensors: dict[str, Measured]) -> None:
    """Figures 5 and 6: plots of the drone, by its distance and, much enlarged, across its line."""
    figure, panels = plt.subplots(2, 2, figsize=(16, 8.4), dpi=100, layout="constrained")
    for axes, name in zip(panels.T.flat, SENSORS, strict=True):
        m = sensors[name]
        across_m = m.across_m()
        which = m.of_drone
        axes.axhline(0, color="black", lw=0.8)
        axes.scatter(m.true_range_m[which] / 1000, across_m[which], s=16, marker=MARKERS[name],
                     color=COLOURS[name], linewidths=0, alpha=0.8, zorder=3)  # fmt: skip
        half_m = 1.15 * float(np.abs(across_m[which]).max())
        missed_m = m.look_range_m[m.look_detected == 0]
        axes.vlines(missed_m / 1000, -half_m, -0.92 * half_m, color=MISSED, lw=0.9)
        axes.set_ylim(-half_m, half_m)
        axes.set_xlim(1.03 if name == "microphone" else 7.2, 0)
        axes.set_xlabel("distance of the drone, km")
        axes.set_ylabel("across the line of sight, m")
        axes.set_title(
            f"{TITLES[name][0].upper()}{TITLES[name][1:]}: {which.sum()} plots, "
            f"{len(missed_m)} looks missed"
        )
    figure.suptitle(
        "Figures 5 (left) and 6 (right): plots of the drone; ticks at the bottom are looks that "
        "missed it\nEach panel has scales of its own; the microphones' bearings are drawn at the "
        "true distance"
    )
    _save(figure, "section-4-drone.png")


def draw_angle(sensors: dict[str, Measured], predicted: Predictions) -> None:
    """Figure 7."""
    figure, panels = plt.subplots(1, 4, figsize=(16, 4.9), dpi=100, layout="constrained")
    for axes, name in zip(panels, SENSORS, strict=True):
        m = sensors[name]
        range_m, expected = predicted[name]
        _band(axes, range_m, np.zeros(len(range_m)), expected.sigma_azimuth_deg)
        _errors(axes, name, m, m.angle_error_deg)
    panels[0].set_ylabel("error of azimuth, degrees")
    figure.suptitle("Figure 7: error of azimuth of each plot of the drone; "
                    "shaded, twice the predicted rms error")  # fmt: skip
    _save(figure, "section-4-angle.png")


def draw_distance(sensors: dict[str, Measured], predicted: Predictions) -> None:
    """Figure 8; the microphones measure no distance."""
    names = [name for name in SENSORS if np.isfinite(sensors[name].range_m).any()]
    figure, panels = plt.subplots(1, 3, figsize=(16, 4.9), dpi=100, layout="constrained")
    for axes, name in zip(panels, names, strict=True):
        m = sensors[name]
        range_m, expected = predicted[name]
        _band(axes, range_m, np.zeros(len(range_m)), expected.sigma_range_m)
        _errors(axes, name, m, m.distance_error_m)
    panels[0].set_ylabel("error of distance, m")
    figure.suptitle("Figure 8: error of distance of each plot of the drone; "
                    "shaded, twice the predicted rms error about the truth")  # fmt: skip
    _save(figure, "section-4-distance.png")


def _band(axes: Any, range_m: Floats, middle: Floats, sigma: Floats) -> None:
    inside = range_m <= 7200
    low, high = (middle - 2 * sigma)[inside], (middle + 2 * sigma)[inside]
    axes.fill_between(range_m[inside] / 1000, low, high, color="#e9eef0", lw=0)


def _errors(axes: Any, name: str, m: Measured, error: Floats) -> None:
    which = m.of_drone
    axes.axhline(0, color="black", lw=0.8)
    axes.scatter(m.true_range_m[which] / 1000, error[which], s=14, color=COLOURS[name],
                 marker=MARKERS[name], linewidths=0, alpha=0.8, zorder=3)  # fmt: skip
    half = 1.15 * float(np.abs(error[which]).max())
    axes.set_ylim(-half, half)
    axes.set_xlim(0, 0.2 if name == "microphone" else 7.2)
    axes.set_xlabel("distance of the drone, km")
    axes.set_title(TITLES[name])


def draw_predicted(sensors: dict[str, Measured], predicted: Predictions) -> None:
    """Pd and rms errors by distance: lines as predicted, points as counted over many flights."""
    figure, (detected, turned, displaced) = plt.subplots(
        1, 3, figsize=(16, 5.6), dpi=100, layout="constrained"
    )
    for name, m in sensors.items():
        range_m, expected = predicted[name]
        style = {"color": COLOURS[name], "lw": 1.6, "label": TITLES[name]}
        detected.plot(range_m / 1000, expected.pd, **style)
        turned.semilogy(range_m / 1000, expected.sigma_azimuth_deg, **style)
        step_m = 20.0 if name == "microphone" else BIN_M
        _counted(detected, name, m.look_range_m, m.look_detected, step_m, root=False)
        true_m, which = m.true_range_m[m.of_drone], m.of_drone
        _counted(turned, name, true_m, m.angle_error_deg[which] ** 2, step_m, root=True)
        if np.isfinite(m.range_m).any():
            displaced.semilogy(range_m / 1000, expected.sigma_range_m, **style)
            _counted(displaced, name, true_m, m.distance_error_m[which] ** 2, step_m, root=True)
    for axes, title in zip(
        (detected, turned, displaced),
        ("Probability of detection", "Rms error of azimuth, degrees", "Rms error of distance, m"),
        strict=True,
    ):
        axes.set_title(title)
        axes.set_xlabel("distance of the drone, km")
        axes.set_xlim(0, 7.2)
    turned.legend(loc="lower right")
    turned.set_ylim(5e-5, 4)
    displaced.set_ylim(2e-4, 40)
    looks = sum(len(m.look_pd) for m in sensors.values())
    figure.suptitle(f"Lines: what plotfeed check predicts. Points: {looks:,} looks at {FLIGHTS} "
                    "approaches, with 95 % bars for Pd")  # fmt: skip
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

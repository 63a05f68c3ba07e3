"""Draws docs/section-4-*.png: figures 4 to 8 of the paper, from one run of the example scene.

python docs/draw_section_4.py
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from collect import sent_by_sensors

from plotfeed.feeds.scene import example

mpl.use("agg")
from matplotlib import pyplot as plt  # noqa: E402 - after the choice of backend

SECONDS = 349.0
"""From 7 km to the facility at 20 m/s."""
COLOURS = {"active": "#0a7d6c", "passive": "#c8651b", "mimo": "#3b5bb5", "microphone": "#a3276f"}
MARKERS = {"active": "o", "passive": "D", "mimo": "s", "microphone": "^"}

mpl.rcParams.update({"font.size": 11, "axes.grid": True, "grid.alpha": 0.3})


@dataclass(frozen=True, slots=True)
class Measured:
    """One sensor's plots; range is NaN for a bearing alone, truth is NaN for a false alarm."""

    range_m: Any
    azimuth_deg: Any
    true_range_m: Any
    true_azimuth_deg: Any

    @property
    def of_drone(self) -> Any:
        return np.isfinite(self.true_range_m)

    @property
    def angle_error_deg(self) -> Any:
        return (self.azimuth_deg - self.true_azimuth_deg + 180) % 360 - 180

    def place_km(self, which: Any) -> tuple[Any, Any]:
        """East and north; a bearing alone is drawn at the drone's true distance."""
        range_km = np.where(np.isfinite(self.range_m), self.range_m, self.true_range_m) / 1000
        azimuth = np.radians(self.azimuth_deg)
        return (range_km * np.sin(azimuth))[which], (range_km * np.cos(azimuth))[which]


def measured() -> dict[str, Measured]:
    """The plots of every sensor of the scene, by its id."""
    found = {}
    for sensor, sent in sent_by_sensors(example("section-4"), SECONDS).items():
        rows = [
            (
                plot.range_m if plot.HasField("range_m") else np.nan,
                plot.azimuth_deg if plot.HasField("azimuth_deg") else np.nan,
                truth.range_m if truth.drone else np.nan,
                truth.azimuth_deg if truth.drone else np.nan,
            )
            for plot, truth in sent.plots()
        ]
        found[sensor] = Measured(*np.array(rows).reshape(-1, 4).T)
    return found


def main() -> None:
    """All five figures, and the counts beside them."""
    sensors = measured()
    for name, m in sensors.items():
        print(f"{name}: {m.of_drone.sum()} plots of the drone, {(~m.of_drone).sum()} false alarms")
    _maps(sensors, "section-4-map.png", [list(sensors)], alarms=True, title="figure 4: all plots")
    pairs = [
        [n for n in pair if n in sensors]
        for pair in (("active", "passive"), ("mimo", "microphone"))
    ]
    _maps(
        sensors, "section-4-drone.png", pairs, alarms=False, title="figures 5 and 6: of the drone"
    )
    _errors(sensors, "section-4-angle.png", "angle_error_deg", "angle error, degrees", "figure 7")
    _errors(sensors, "section-4-distance.png", "distance_error_m", "distance error, m", "figure 8")


def _maps(
    sensors: dict[str, Measured], file: str, groups: list[list[str]], *, alarms: bool, title: str
) -> None:
    figure, axes = plt.subplots(
        1, len(groups), figsize=(8.0 * len(groups), 8.0), layout="constrained", squeeze=False
    )
    for axis, names in zip(axes[0], groups, strict=True):
        for name in names:
            m = sensors[name]
            if alarms:
                axis.scatter(
                    *m.place_km(~m.of_drone), marker="x", color=COLOURS[name], s=30, lw=1, alpha=0.8
                )
            axis.scatter(
                *m.place_km(m.of_drone),
                marker=MARKERS[name],
                s=22,
                alpha=0.55,
                color=COLOURS[name],
                linewidths=0,
                label=f"{name}, {m.of_drone.sum()} plots",
            )
        axis.set_aspect("equal")
        axis.set_xlabel("east of the facility, km")
        axis.set_ylabel("north, km")
        axis.legend(title="crosses: false alarms" if alarms else None, loc="lower left")
    figure.suptitle(title)
    _save(figure, file)


def _errors(sensors: dict[str, Measured], file: str, error: str, label: str, title: str) -> None:
    ranged = {
        n: m
        for n, m in sensors.items()
        if error == "angle_error_deg" or np.isfinite(m.range_m).any()
    }
    figure, axes = plt.subplots(
        1, len(ranged), figsize=(4.2 * len(ranged), 4), layout="constrained"
    )
    for axis, (name, m) in zip(axes, ranged.items(), strict=True):
        values = m.angle_error_deg if error == "angle_error_deg" else m.range_m - m.true_range_m
        axis.scatter(
            m.true_range_m[m.of_drone] / 1000,
            values[m.of_drone],
            s=10,
            color=COLOURS[name],
            marker=MARKERS[name],
            linewidths=0,
        )
        axis.set_title(name)
        axis.set_xlabel("distance of the drone, km")
    axes[0].set_ylabel(label)
    figure.suptitle(title)
    _save(figure, file)


def _save(figure: Any, file: str) -> None:
    figure.savefig(Path(__file__).with_name(file), dpi=100, metadata={"Software": None})
    plt.close(figure)


if __name__ == "__main__":
    main()

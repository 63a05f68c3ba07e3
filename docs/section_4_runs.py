"""Runs of scene section-4, and the columns of what they gave: for its pictures and its table."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import cos, radians, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from collect import Sent, Tree, scene_with, sent_by, sent_by_sensors
from numpy.typing import NDArray

from plotfeed.feeds.cli.check import curves
from plotfeed.feeds.scene.scene import Scene, example, from_tree
from plotfeed.models.sensors.sensor_model import Prediction

SECONDS = 349.0
"""From 7 km to the facility at 20 m/s."""
APPROACH_DEG = 45.0
HEIGHT_M = 50.0
START_M = 7000.0
SPEED_M_S = 20.0
SENSORS = ("active", "passive", "mimo", "microphone")
"""In the order of the paper's figures 5 and 6."""
TITLES = {
    "active": "active radar",
    "passive": "passive radar",
    "mimo": "MIMO radar",
    "microphone": "microphones",
}
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Measured:
    """One sensor's plots and looks; range is NaN for a bearing alone, truth for a false alarm."""

    range_m: Floats
    azimuth_deg: Floats
    true_range_m: Floats
    true_azimuth_deg: Floats
    look_range_m: Floats
    look_pd: Floats
    look_detected: Floats

    @property
    def of_drone(self) -> Any:
        return np.isfinite(self.true_range_m)

    @property
    def angle_error_deg(self) -> Floats:
        return (self.azimuth_deg - self.true_azimuth_deg + 180) % 360 - 180

    @property
    def distance_error_m(self) -> Floats:
        return self.range_m - self.true_range_m

    def place_m(self) -> tuple[Floats, Floats]:
        """East and north; a bearing alone at the drone's true distance, as in the paper."""
        range_m = np.where(np.isfinite(self.range_m), self.range_m, self.true_range_m)
        azimuth = np.radians(self.azimuth_deg)
        return range_m * np.sin(azimuth), range_m * np.cos(azimuth)

    def across_m(self) -> Floats:
        """To the right of the true line of sight, seen from the sensor."""
        east_m, north_m = self.place_m()
        return np.hypot(east_m, north_m) * np.sin(np.radians(self.angle_error_deg))


def measured(sent: Sent) -> Measured:
    """Columns of what a sensor sent, and of the ledger beside it."""
    plots = [
        (
            plot.range_m if plot.HasField("range_m") else np.nan,
            plot.azimuth_deg if plot.HasField("azimuth_deg") else np.nan,
            truth.range_m if truth.drone else np.nan,
            truth.azimuth_deg if truth.drone else np.nan,
        )
        for plot, truth in sent.plots()
    ]
    looks = [(look.range_m, look.pd, look.detected) for look in sent.looks()]
    return Measured(
        *np.array(plots, np.float64).reshape(-1, 4).T,
        *np.array(looks, np.float64).reshape(-1, 3).T,
    )


def one_flight() -> dict[str, Measured]:
    """What each sensor reports of the scene as it comes: one drone, one approach."""
    sent = sent_by_sensors(example("section-4"), SECONDS)
    return {sensor: measured(sent[sensor]) for sensor in SENSORS}


def many_flights(n: int) -> tuple[dict[str, Sent], dict[str, Measured]]:
    """The same for that many drones on the one line, 20 m or less after each other."""
    tree = scene_with("active", [_inbound(k, START_M + SPEED_M_S * k / n) for k in range(n)])
    tree["sensor"] = _sensors()
    sent = sent_by_sensors(_scene(tree), SECONDS)
    return sent, {sensor: measured(sent[sensor]) for sensor in SENSORS}


def hovering(sensor: str, range_m: float, drones: int, scans: int) -> Measured:
    """What a sensor reports of drones that hover at that slant range on the line of approach."""
    up_m = HEIGHT_M - _height_m(sensor)
    ground_m = sqrt(range_m**2 - up_m**2)
    tree = scene_with(sensor, [_still(k, ground_m) for k in range(drones)])
    return measured(sent_by(tree, float(scans)))


def false_alarms(sensor: str, scans: int) -> int:
    """How many a sensor reports in that many scans of an empty sky."""
    tree = scene_with(sensor)
    tree["drone"] = []
    return sum(1 for _ in sent_by(tree, float(scans)).plots())


def predictions() -> dict[str, tuple[Floats, Prediction]]:
    """What `plotfeed check` predicts, against range."""
    return dict(curves(example("section-4"), None))


def _sensors() -> list[Tree]:
    return [sensor for name in SENSORS for sensor in scene_with(name)["sensor"]]


def _height_m(sensor: str) -> float:
    (keys,) = scene_with(sensor)["sensor"]
    return float(keys.get("position_enu_m", (0, 0, 0))[2])


def _scene(tree: Tree) -> Scene:
    return from_tree(tree, Path("section-4.toml"))


def _inbound(k: int, start_m: float) -> Tree:
    return _drone(k, [(start_m, 0.0), (0.0, 0.0)], SPEED_M_S)


def _still(k: int, ground_m: float) -> Tree:
    """A centimetre a second, across the line of sight."""
    return _drone(k, [(ground_m, -3.0), (ground_m, 3.0)], 0.01)


def _drone(k: int, places_m: Iterable[tuple[float, float]], speed_m_s: float) -> Tree:
    """At places along and across the line of approach."""
    s, c = sin(radians(APPROACH_DEG)), cos(radians(APPROACH_DEG))
    path = [
        {"east_m": a * s + x * c, "north_m": a * c - x * s, "above_site_m": HEIGHT_M}
        for a, x in places_m
    ]
    return {
        "id": f"drone-{k}", "rcs_m2": 0.01, "sound_power_db": 80.0, "speed_m_s": speed_m_s,
        "path": path,
    }  # fmt: skip

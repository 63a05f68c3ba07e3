"""Scene section-4 in simulated time: what its sensors report, and shares with their intervals."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Sequence
from importlib.resources import files
from math import cos, radians, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotfeed import simulate
from plotfeed.feeds.cli.check import curves
from plotfeed.feeds.engine.simulation import SimulatedPlots, SimulatedSensor, Simulation
from plotfeed.feeds.scene.scene import example, from_tree
from plotfeed.models.frames import wrap_180
from plotfeed.models.sensors.sensor_model import Prediction

# 2026-01-01, 12:00. Always the same, so that a picture drawn again is the same picture.
START_UTC_NS = 1_767_268_800 * 10**9
SECONDS = 349.0  # From 7 km to the facility at 20 m/s
APPROACH_DEG = 45.0
HEIGHT_M = 50.0
START_M = 7000.0
SPEED_M_S = 20.0
SENSORS = ("active", "passive", "mimo", "microphone")  # In the order of the paper's figures 5 and 6
TITLES = {
    "active": "active radar",
    "passive": "passive radar",
    "mimo": "MIMO radar",
    "microphone": "microphones",
}
Floats = NDArray[np.float64]
Tree = dict[str, Any]


def of_drone(seen: SimulatedSensor) -> SimulatedPlots:
    """A sensor's plots but its false alarms."""
    return seen.plots.rows(seen.plots.drone >= 0)


def angle_error_deg(plots: SimulatedPlots) -> Floats:
    return wrap_180(plots.azimuth_deg - plots.true_azimuth_deg)


def distance_error_m(plots: SimulatedPlots) -> Floats:
    """NaN of a bearing alone."""
    return plots.range_m - plots.true_range_m


def place_m(plots: SimulatedPlots) -> tuple[Floats, Floats]:
    """East and north; a bearing alone at the drone's true distance, as in the paper."""
    range_m = np.where(np.isfinite(plots.range_m), plots.range_m, plots.true_range_m)
    azimuth = np.radians(plots.azimuth_deg)
    return range_m * np.sin(azimuth), range_m * np.cos(azimuth)


def across_m(plots: SimulatedPlots) -> Floats:
    """Metres to the right of the true line of sight, seen from the sensor."""
    return np.hypot(*place_m(plots)) * np.sin(np.radians(angle_error_deg(plots)))


def scene_with(*sensors: str, drones: Sequence[Tree] | None = None) -> Tree:
    """The scene with those sensors alone, and with those drones in place of its own."""
    tree = tomllib.loads((files("plotfeed.feeds.scene.examples") / "section-4.toml").read_text())
    tree["sensor"] = [s for name in sensors for s in tree["sensor"] if s["id"] == name]
    return tree if drones is None else tree | {"drone": list(drones)}


def simulated(tree: Tree, duration_s: float) -> Simulation:
    """What the sensors of a scene report in that time."""
    scene = from_tree(tree, Path("section-4.toml"))
    return simulate(scene, duration_s, start_utc_ns=START_UTC_NS)


def one_flight() -> Simulation:
    """What each sensor reports of the scene as it comes: one drone, one approach."""
    return simulate("section-4", SECONDS, start_utc_ns=START_UTC_NS)


def many_flights(n: int) -> Simulation:
    """An approach for each of that many drones, all on one line, 20 m or less after each other."""
    starts_m = [START_M + SPEED_M_S * k / n for k in range(n)]
    drones = [
        _on_approach(k, [(start_m, 0.0), (0.0, 0.0)], SPEED_M_S)
        for k, start_m in enumerate(starts_m)
    ]
    return simulated(scene_with(*SENSORS, drones=drones), SECONDS)


def hovering_on_approach(sensor: str, range_m: float, drones: int, scans: int) -> SimulatedSensor:
    """What a sensor reports of drones that hover at that slant range on the line of approach."""
    (keys,) = scene_with(sensor)["sensor"]
    up_m = HEIGHT_M - float(keys.get("position_enu_m", (0, 0, 0))[2])
    ground_m = sqrt(range_m**2 - up_m**2)
    there = [
        _on_approach(k, [(ground_m, -3.0), (ground_m, 3.0)], speed_m_s=0.01) for k in range(drones)
    ]
    return simulated(scene_with(sensor, drones=there), float(scans))[sensor]


def false_alarms(sensor: str, scans: int) -> int:
    """How many a sensor reports in that many scans of an empty sky."""
    return len(simulated(scene_with(sensor, drones=()), float(scans))[sensor].plots)


def predictions() -> dict[str, tuple[Floats, Prediction]]:
    """What `plotfeed check` predicts, against range."""
    return dict(curves(example("section-4"), None))


def _on_approach(k: int, places_m: Iterable[tuple[float, float]], speed_m_s: float) -> Tree:
    """A drone at places along and across the line of approach."""
    path = [along_and_across(a, x, radians(APPROACH_DEG)) for a, x in places_m]
    return {
        "id": f"drone-{k}", "rcs_m2": 0.01, "sound_power_db": 80.0, "speed_m_s": speed_m_s,
        "path": path,
    }  # fmt: skip


def along_and_across(along_m: float, across_m: float, azimuth: float) -> dict[str, float]:
    """A waypoint along a direction, radians from north, and to the right of it."""
    return {
        "east_m": along_m * sin(azimuth) + across_m * cos(azimuth),
        "north_m": along_m * cos(azimuth) - across_m * sin(azimuth),
        "above_site_m": HEIGHT_M,
    }

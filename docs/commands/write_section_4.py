"""Writes the counted tables of docs/section-4.md, between its two marks.

python docs/commands/write_section_4.py
"""

from __future__ import annotations

import platform
from importlib.metadata import version
from pathlib import Path

import numpy as np
from pages import between, table
from section_4 import (
    SECONDS,
    SENSORS,
    TITLES,
    Floats,
    false_alarms,
    hovering_on_approach,
    many_flights,
    of_drone,
    one_flight,
)

from plotfeed.feeds.engine.simulation import SimulatedSensor
from plotfeed.feeds.scene.scene import example
from plotfeed.models.verdicts import share_interval

PAGE = Path(__file__).parents[1] / "section-4.md"
DRONES, SCANS, FLIGHTS = 25, 400, 400
EMPTY_SCANS = {"active": 2000, "passive": 20_000, "mimo": 20_000, "microphone": 20_000}
RANGES_M = {
    "active": (7000, 5000, 4000),
    "passive": (7000, 5000, 4000, 3100, 2000),
    "mimo": (5000, 4000, 3850, 3000),
    "microphone": (200, 150, 131, 100, 75),
}
# What the paper says in our words, and where it is checked.
OUTCOMES = {
    "active": ("consistent from the start, 7 km away", 7000),
    "passive": ("consistent from about 3 km", 3100),
    "mimo": ("consistent from about 4 km", 3850),
    "microphone": ("only very near", 131),
}
# Pd computed, and counted with its interval, by sensor and slant range.
Pds = dict[tuple[str, int], tuple[str, str]]


def counted() -> Pds:
    """Pds at all ranges."""
    found = {}
    for sensor in SENSORS:
        for range_m in RANGES_M[sensor]:
            looks = hovering_on_approach(sensor, range_m, DRONES, SCANS).looks
            hits, n = int(looks.detected.sum()), len(looks)
            low, high = share_interval(hits, n)
            share = f"{hits / n:.3f} ({low:.3f} to {high:.3f})"
            found[sensor, range_m] = (f"{looks.pd.mean():.3f}", share)
            print(sensor, range_m, *found[sensor, range_m], flush=True)
    return found


def first_plots_m(seen: SimulatedSensor) -> Floats:
    """How far away each drone was at its first plot."""
    plots = of_drone(seen)
    _, first = np.unique(plots.drone, return_index=True)
    return plots.true_range_m[first]


def outcomes(pds: Pds) -> list[str]:
    """The paper's words beside what was counted."""
    flights, rows = many_flights(FLIGHTS), []
    for sensor in SENSORS:
        words, range_m = OUTCOMES[sensor]
        quantiles_m = np.quantile(first_plots_m(flights[sensor]), (0.05, 0.5, 0.95))
        low, middle, high = map(_distance, quantiles_m)
        first = f"{middle} ({low} to {high})"
        rows.append((TITLES[sensor], words, _distance(range_m), *pds[sensor, range_m], first))
    head = ("sensor", "the paper", "at", "Pd computed", "Pd counted")
    return table((*head, "first plot, median (middle 90 %)"), rows)


def alarms() -> list[str]:
    """Counts of one approach, and false alarms in the long run."""
    one, scene, rows = one_flight(), example("section-4"), []
    means = {s.id: s.model(scene.scene.site).false_alarms_per_scan for s in scene.sensor}
    for sensor in SENSORS:
        seen, scans, mean = one[sensor], EMPTY_SCANS[sensor], means[sensor]
        plots, false = len(of_drone(seen)), len(seen.plots) - len(of_drone(seen))
        long_run = f"{false_alarms(sensor, scans):,} in {scans:,} scans"
        counts = (plots, len(seen.looks), false, _mean(mean * SECONDS))
        rows.append((TITLES[sensor], *counts, long_run, _mean(mean * scans)))
    head = ("sensor", "plots of the drone", "looks", "false alarms", "expected", "in the long run")
    return table((*head, "expected"), rows)


def _mean(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.2g}"


def _distance(value_m: float) -> str:
    return f"{value_m / 1000:.2f} km" if value_m >= 1000 else f"{value_m:.0f} m"


def tables() -> str:
    """All three."""
    pds = counted()
    ranges = [(TITLES[s], _distance(r), *pds[s, r]) for s in SENSORS for r in RANGES_M[s]]
    return "\n".join(
        [
            f"Counted: {DRONES} drones that hover at that slant range on the line of approach, "
            f"{SCANS} scans, {DRONES * SCANS:,} looks a row, with 95 % intervals. First plots: "
            f"{FLIGHTS} approaches, begun 7.00 to 7.02 km away.",
            "",
            *outcomes(pds),
            "",
            f"One approach of {SECONDS:g} scans, and false alarms in long runs of an empty sky:",
            "",
            *alarms(),
            "",
            "The probability of detection at more distances:",
            "",
            *table(("sensor", "slant range", "Pd computed", "Pd counted"), ranges),
            "",
            f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}, "
            f"numpy {version('numpy')}, scipy {version('scipy')}; seed 1, which is the "
            "scene's.",
        ]
    )


if __name__ == "__main__":
    between(PAGE, "counted", tables())

"""Writes the counted tables of docs/section-4.md, between its two marks.

python docs/write_section_4.py
"""

from __future__ import annotations

import platform
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

import numpy as np
from collect import Sent
from section_4_runs import (
    SECONDS,
    SENSORS,
    TITLES,
    Floats,
    false_alarms,
    hovering,
    many_flights,
    one_flight,
)

from plotfeed.feeds.scene.scene import example

PAGE = Path(__file__).with_name("section-4.md")
BEGIN, END = "<!-- counted: begin -->", "<!-- counted: end -->"
DRONES, SCANS, FLIGHTS = 25, 400, 400
EMPTY_SCANS = {"active": 2000, "passive": 20_000, "mimo": 20_000, "microphone": 20_000}
RANGES_M = {
    "active": (7000, 5000, 4000),
    "passive": (7000, 5000, 4000, 3100, 2000),
    "mimo": (5000, 4000, 3850, 3000),
    "microphone": (200, 150, 131, 100, 75),
}
OUTCOMES = {
    "active": ("consistent from the start, 7 km away", 7000),
    "passive": ("consistent from about 3 km", 3100),
    "mimo": ("consistent from about 4 km", 3850),
    "microphone": ("only very near", 131),
}
"""What the paper says in our words, and where it is checked."""
Z = 1.959964  # of a normal distribution: 95 % lie within
Row = tuple[object, ...]


def wilson(hits: int, n: int) -> tuple[float, float]:
    """The 95 % interval of a share."""
    p = hits / n
    middle = (p + Z**2 / (2 * n)) / (1 + Z**2 / n)
    half = Z / (1 + Z**2 / n) * np.sqrt(p * (1 - p) / n + Z**2 / (4 * n**2))
    return middle - half, middle + half


def counted() -> dict[tuple[str, int], tuple[str, str]]:
    """Pd computed, and counted with its interval, by sensor and slant range."""
    found = {}
    for sensor in SENSORS:
        for range_m in RANGES_M[sensor]:
            m = hovering(sensor, range_m, DRONES, SCANS)
            hits, n = int(m.look_detected.sum()), len(m.look_detected)
            low, high = wilson(hits, n)
            share = f"{hits / n:.3f} ({low:.3f} to {high:.3f})"
            found[sensor, range_m] = (f"{m.look_pd.mean():.3f}", share)
            print(sensor, range_m, *found[sensor, range_m], flush=True)
    return found


def first_plots_m(sent: Sent) -> Floats:
    """How far away each drone was at its first plot."""
    first: dict[str, float] = {}
    for _, truth in sent.plots():
        if truth.drone:
            first.setdefault(truth.drone, truth.range_m)
    return np.array(list(first.values()))


def _mean(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.2g}"


def _distance(value_m: float) -> str:
    return f"{value_m / 1000:.2f} km" if value_m >= 1000 else f"{value_m:.0f} m"


def tables() -> str:
    """All three."""
    pds = counted()
    sent, _ = many_flights(FLIGHTS)
    one = one_flight()
    outcomes: list[Row] = [("sensor", "the paper", "at", "Pd computed", "Pd counted",
                            "first plot, median (middle 90 %)")]  # fmt: skip
    alarms: list[Row] = [
        (
            "sensor",
            "plots of the drone",
            "looks",
            "false alarms",
            "expected",
            "in the long run",
            "expected",
        )
    ]
    site = example("section-4").scene.site
    means = {s.id: s.model(site).false_alarms_per_scan for s in example("section-4").sensor}
    for sensor in SENSORS:
        words, range_m = OUTCOMES[sensor]
        low, middle, high = (_distance(x) for x in np.quantile(first_plots_m(sent[sensor]),
                                                               (0.05, 0.5, 0.95)))  # fmt: skip
        outcomes.append((TITLES[sensor], words, _distance(range_m), *pds[sensor, range_m],
                         f"{middle} ({low} to {high})"))  # fmt: skip
        m, scans = one[sensor], EMPTY_SCANS[sensor]
        alarms.append((TITLES[sensor], m.of_drone.sum(), len(m.look_pd), (~m.of_drone).sum(),
                       _mean(means[sensor] * SECONDS),
                       f"{false_alarms(sensor, scans):,} in {scans:,} scans",
                       _mean(means[sensor] * scans)))  # fmt: skip
    ranges: list[Row] = [("sensor", "slant range", "Pd computed", "Pd counted")]
    ranges += [(TITLES[s], _distance(r), *pds[s, r]) for s in SENSORS for r in RANGES_M[s]]
    looks = DRONES * SCANS
    return "\n".join(
        [
            f"Counted: {DRONES} drones that hover at that slant range on the line of approach, "
            f"{SCANS} scans, {looks:,} looks a row, with 95 % intervals. First plots: {FLIGHTS} "
            "approaches, begun 7.00 to 7.02 km away.",
            "",
            *_table(outcomes),
            "",
            f"One approach of {SECONDS:g} scans, and false alarms in long runs of an empty sky:",
            "",
            *_table(alarms),
            "",
            "The probability of detection at more distances:",
            "",
            *_table(ranges),
            "",
            f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}, "
            f"numpy {version('numpy')}, scipy {version('scipy')}; seed 1, which is the "
            "scene's.",
        ]
    )


def _table(rows: Iterable[Row]) -> list[str]:
    lines = ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    return [lines[0], "|" + "---|" * (lines[0].count("|") - 1), *lines[1:]]


def main() -> None:
    """Put the tables between the marks."""
    text = PAGE.read_text()
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    PAGE.write_text(f"{before}{BEGIN}\n\n{tables()}\n\n{END}{after}")


if __name__ == "__main__":
    main()

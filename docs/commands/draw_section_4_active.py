"""Draws docs/section-4-active.png: what the radar of section-4 does, beside what theory says.

    python docs/commands/draw_section_4_active.py

Drones of three sizes hover at set ranges all around the radar of scene section-4. Bars are 95 %
intervals: of the share detected after Wilson, of the rms errors by the spread that theory gives to
the mean of their squares. That is wide for strong echoes, where the few weak ones decide.
The lines are computed here, apart from the models' own detection and errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import radians
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from scipy.special import exp1, gammaincinv
from section_4 import Floats, Tree, along_and_across, scene_with, simulated

from plotfeed.feeds.engine.simulation import Simulation
from plotfeed.models.frames import wrap_180
from plotfeed.models.propagation import radar_snr
from plotfeed.models.state import Ints
from plotfeed.models.verdicts import TWO_SIDED_95, share_interval

mpl.use("agg")
from matplotlib import pyplot as plt

PICTURE = Path(__file__).parents[1] / "section-4-active.png"
RANGES_M = range(1000, 10_000, 1000)
SIZES_M2 = {0.1: "#c8553d", 0.01: "#1f7a8c", 0.001: "#5b4b8a"}
BEARINGS = 12
SCANS = 400
Measured = dict[tuple[float, int], Floats]

mpl.rcParams.update({"font.family": "DejaVu Sans", "font.size": 12, "svg.hashsalt": "plotfeed"})


def hovering() -> list[Tree]:
    """Drones that move a centimetre a second, across the line of sight."""
    return [
        {
            "id": f"{size_m2}-{range_m}-{k}",
            "rcs_m2": size_m2,
            "speed_m_s": 0.01,
            "path": [
                along_and_across(range_m, d, radians((k + 0.5) * 360 / BEARINGS)) for d in (-3, 3)
            ],
        }
        for size_m2 in SIZES_M2
        for range_m in RANGES_M
        for k in range(BEARINGS)
    ]


def predicted(radar: Tree, range_m: Floats, size_m2: float) -> tuple[list[Floats], Floats]:
    """Pd and the rms errors of range, azimuth and elevation, by docs/equations.md.

    Beside them the standard deviation of one squared error, over its mean.
    """
    beam_deg2 = radar["azimuth_beamwidth_deg"] * radar["elevation_beamwidth_deg"]
    snr = radar_snr(
        radar["power_w"],
        radar["gain_tx_dbi"],
        10 * np.log10(41253 / beam_deg2),
        299_792_458.0 / radar["frequency_hz"],
        size_m2,
        radar["integration_s"],
        range_m,
        range_m,
        radar["loss_db"],
        radar["noise_figure_db"],
    )
    n = radar["n_reference"]
    alpha = radar["pfa"] ** (-1 / n) - 1
    shares = (np.arange(2000) + 0.5) / 2000  # the threshold's distribution, in equal parts
    y = alpha * gammaincinv(n, shares) / (1 + snr[:, None] + alpha)
    tail = np.exp(y) * exp1(y)
    inverse_snr = np.mean(tail, axis=1) / (1 + snr)  # mean of 1/x of a detection
    inverse_square = np.mean(1 / y - tail, axis=1) / (1 + snr) ** 2  # and of 1/x squared
    spread = np.sqrt(inverse_snr / 2)
    values = [
        (1 + alpha / (1 + snr)) ** -n,
        radar["range_resolution_m"] / 1.63 * spread,
        radar["azimuth_beamwidth_deg"] / 1.6 * spread,
        radar["elevation_beamwidth_deg"] / 1.6 * spread,
    ]
    return values, np.sqrt(3 * inverse_square / inverse_snr**2 - 1)


def by_place(drones: Sequence[str], drone: Ints, values: Floats) -> Measured:
    """Values of looks or plots of drones, (n,) or (n, 3), by the size and the range of each."""
    found = {}
    for row, name in enumerate(drones):
        size_m2, range_m, _ = name.split("-")
        found.setdefault((float(size_m2), int(range_m)), []).append(values[drone == row])
    return {place: np.concatenate(parts) for place, parts in found.items()}


def detections(seen: Simulation) -> Measured:
    """Whether each look at a size and a range was a detection."""
    looks = seen["active"].looks
    return by_place(seen.drones, looks.drone, looks.detected.astype(np.float64))


def errors(seen: Simulation) -> Measured:
    """Errors of range, azimuth and elevation of each plot of a size and a range; (n, 3)."""
    plots = seen["active"].plots
    found = [
        plots.range_m - plots.true_range_m,
        wrap_180(plots.azimuth_deg - plots.true_azimuth_deg),
        plots.elevation_deg - plots.true_elevation_deg,
    ]
    return by_place(seen.drones, plots.drone, np.stack(found, axis=-1))


def rms(values: Floats, expected: float, deviation: float) -> tuple[float, float, float]:
    """Root mean square, and the ends of its 95 % interval."""
    mean = float(np.mean(values**2))
    half = TWO_SIDED_95 * expected**2 * deviation / np.sqrt(len(values))
    return mean**0.5, max(mean - half, 0.0) ** 0.5, (mean + half) ** 0.5


def draw() -> None:
    """Pd, then the three errors."""
    tree = scene_with("active", drones=hovering())
    (radar,) = tree["sensor"]
    seen = simulated(tree, SCANS * radar["scan"]["period_s"])
    hits, missed_by = detections(seen), errors(seen)
    looks, plots = sum(map(len, hits.values())), sum(map(len, missed_by.values()))
    figure, panels = plt.subplots(2, 2, figsize=(16, 10.5), dpi=100, layout="constrained")
    line_m = np.linspace(500, 10_000, 381)
    within = [0, 0]
    titles = ("Probability of detection", "Rms error of range, m", "Rms error of azimuth, degrees",
              "Rms error of elevation, degrees")  # fmt: skip
    for size_m2, colour in SIZES_M2.items():
        lines, deviations = predicted(radar, line_m, size_m2)
        for column, axes in enumerate(panels.flat):
            axes.plot(line_m / 1000, lines[column], color=colour, lw=1.6, zorder=2)
            for range_m in RANGES_M:
                here = (size_m2, range_m)
                wanted = float(np.interp(range_m, line_m, lines[column]))
                deviation = float(np.interp(range_m, line_m, deviations))
                if column:
                    value, low, high = rms(missed_by[here][:, column - 1], wanted, deviation)
                else:
                    value = float(hits[here].mean())
                    low, high = share_interval(int(hits[here].sum()), len(hits[here]))
                within[0] += low <= wanted <= high
                within[1] += 1
                bar = [[value - low], [high - value]]
                axes.errorbar(range_m / 1000, value, yerr=bar, color=colour, fmt="o", ms=5.5,
                              capsize=4, lw=1.4, zorder=3)  # fmt: skip
    for title, axes in zip(titles, panels.flat, strict=True):
        _dress(axes, title)
    for size_m2, colour in SIZES_M2.items():
        panels[0, 0].plot([], [], color=colour, marker="o", label=f"{size_m2:g} m²")
    panels[0, 0].legend(title="radar cross-section", loc="lower left", frameon=False)
    figure.suptitle(
        f"The radar of section-4: lines are closed forms, points what it sent "
        f"({looks:,} looks, {plots:,} plots)\n"
        f"{within[0]} of {within[1]} points have their line within their 95 % bars",
        fontsize=15,
    )
    figure.savefig(PICTURE, metadata={"Software": None})
    print(f"{PICTURE}: {looks} looks, {plots} plots, {within[0]} of {within[1]} within 95 %")


def _dress(axes: Any, title: str) -> None:
    axes.set_title(title, loc="left", weight="bold")
    axes.set_xlabel("range, km")
    axes.set_xlim(0, 10)
    if not title.startswith("Prob"):
        axes.set_yscale("log")
    else:
        axes.set_ylim(0, 1.03)
    axes.grid(color="#dde3e6", lw=0.7, which="major")
    axes.spines[["top", "right"]].set_visible(False)


if __name__ == "__main__":
    draw()

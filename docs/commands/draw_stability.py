"""Draws docs/stability-baseline.png and docs/stability-limits.png: errors of plain forms and ours.

python docs/commands/draw_stability.py
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from stability_case import relative
from stability_chances import multiplier_errors, near_ties_errors
from stability_places import (
    BASELINE_M,
    TRANSMITTER_M,
    exact_detour_m,
    plain_detour_m,
    pole_errors,
    zenith_errors,
)

from plotfeed.models import propagation

mpl.use("agg")
from matplotlib import colors
from matplotlib import pyplot as plt

DOCS = Path(__file__).parents[1]
ALONG_M = np.linspace(-10_000.0, 30_000.0, 161)
OFF_M = np.logspace(-5, 4, 91)
LEAST, LEAST_M = 1e-17, 1e-11  # What stands for no error at all on a logarithmic axis
PLAIN, OURS = "#c8553d", "#1f7a8c"
Floats = NDArray[np.float64]
Errors = Callable[[float], tuple[float, float]]

mpl.rcParams.update({"font.family": "DejaVu Sans", "font.size": 12})


def baseline() -> None:
    """Relative error of the bistatic range over the plane, plain and ours."""
    along, off = np.meshgrid(ALONG_M, OFF_M)
    places = np.stack([along, off, 0 * off], axis=-1)
    exact = [[exact_detour_m(x, y) for x in ALONG_M] for y in OFF_M]
    forms = {
        "the ways less the baseline": plain_detour_m(places),
        "ours": propagation.bistatic_range(places, TRANSMITTER_M),
    }
    figure, panels = plt.subplots(1, 2, figsize=(12, 4.8), sharey=True, layout="constrained")
    scale = colors.LogNorm(1e-16, 1.0)
    for panel, (name, found) in zip(panels, forms.items(), strict=True):
        errors = [
            [relative(f, e) for f, e in zip(*rows, strict=True)]
            for rows in zip(found, exact, strict=True)
        ]
        drawn = panel.pcolormesh(
            ALONG_M / 1e3,
            OFF_M,
            np.maximum(errors, LEAST),
            norm=scale,
            cmap="magma_r",
            rasterized=True,
        )
        panel.set(title=name, yscale="log", xlabel="km along the baseline")
        for x_km, antenna in ((0.0, "receiver"), (BASELINE_M / 1e3, "transmitter")):
            panel.plot([x_km], [OFF_M[0]], "^", color="k", markersize=12, clip_on=False)
            panel.axvline(x_km, color="k", linewidth=0.8, linestyle=":")
            panel.annotate(
                antenna,
                (x_km, OFF_M[-1]),
                (4 if x_km else -4, -14),
                textcoords="offset points",
                ha="left" if x_km else "right",
            )
    panels[0].set_ylabel("metres off it")
    bar = figure.colorbar(drawn, ax=panels, extend="both", ticks=10.0 ** np.arange(-16, 1, 4))
    bar.set_label("relative error of the bistatic range")
    figure.savefig(DOCS / "stability-baseline.png", dpi=110, metadata={"Software": None})


LIMITS: tuple[tuple[str, str, str, Floats, Errors], ...] = (
    (
        "Angle from the vertical, 10 km up",
        "metres off the vertical",
        "relative error",
        np.logspace(-5, 3, 161),
        zenith_errors,
    ),
    (
        "Height at the pole",
        "degrees from the pole",
        "error, m",
        np.logspace(-12, 1, 161),
        pole_errors,
    ),
    (
        "Pd of three looks of nearly equal SNR",
        "dB apart",
        "relative error",
        np.logspace(-9, 0.5, 161),
        near_ties_errors,
    ),
    (
        "Threshold of a CFAR",
        "reference cells",
        "relative error",
        np.logspace(0, 15, 161),
        multiplier_errors,
    ),
)


def limits() -> None:
    """Errors on the way to four limits."""
    figure, panels = plt.subplots(2, 2, figsize=(12, 7.6), layout="constrained")
    for panel, (title, along, across, places, errors) in zip(panels.flat, LIMITS, strict=True):
        plain, ours = np.array([errors(float(x)) for x in places]).T
        least = LEAST_M if errors is pole_errors else LEAST
        dots = {"s": 12, "linewidths": 0}
        panel.scatter(places, np.maximum(plain, least), color=PLAIN, label="plain form", **dots)
        panel.scatter(places, np.maximum(ours, least), color=OURS, label="ours", **dots)
        panel.set(title=title, xlabel=along, ylabel=across, xscale="log", yscale="log")
        panel.set_ylim(least / 5, None)
        panel.grid(alpha=0.3)
        panel.minorticks_off()
        if errors is not multiplier_errors:
            panel.invert_xaxis()
    panels[0, 0].legend(loc="upper left", markerscale=2)
    figure.savefig(DOCS / "stability-limits.png", dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    baseline()
    limits()

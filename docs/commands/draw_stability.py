"""Draws docs/stability-limits.png: errors of plain forms and of ours on the way to five limits.

python docs/commands/draw_stability.py
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import matplotlib as mpl
import numpy as np
import stability_forms as forms

mpl.use("agg")
from matplotlib import pyplot as plt

DOCS = Path(__file__).parents[1]
PLAIN, OURS = "#c8553d", "#1f7a8c"
# Titles, what is along the axis, its powers of ten from the furthest to the limit, errors, and what
# stands for no error at all.
LIMITS = (
    (
        "Bistatic range",
        "metres off the baseline",
        4,
        -5,
        partial(forms.detour_errors, 7000.0),
        1e-17,
    ),
    ("Angle from the vertical, 10 km up", "metres off it", 3, -5, forms.zenith_errors, 1e-17),
    ("Height at the pole, error in m", "degrees from it", 1, -12, forms.pole_errors, 1e-11),
    ("Pd of three looks of nearly equal SNR", "dB apart", 0.5, -9, forms.near_ties_errors, 1e-17),
    ("Threshold of a CFAR", "reference cells", 0, 15, forms.multiplier_errors, 1e-17),
)

mpl.rcParams.update({"font.family": "DejaVu Sans", "font.size": 12})
figure, panels = plt.subplots(2, 3, figsize=(15, 7.6), layout="constrained")
for panel, (title, along, far, near, errors, least) in zip(panels.flat, LIMITS, strict=False):
    places = np.logspace(far, near, 161)
    for found, colour in zip(np.transpose([errors(x) for x in places]), (PLAIN, OURS), strict=True):
        panel.scatter(places, np.maximum(found, least), color=colour, s=12, linewidths=0)
    panel.set(title=title, xlabel=along, xscale="log", yscale="log", xlim=(places[0], places[-1]))
    panel.set_ylim(least / 5, None)
    panel.grid(alpha=0.3)
    panel.minorticks_off()
panels[0, 0].set_ylabel("relative error")
panels[1, 0].set_ylabel("relative error")
panels[1, 2].axis("off")
for name, colour in (("plain form", PLAIN), ("ours", OURS)):
    panels[1, 2].scatter([], [], color=colour, label=name)
panels[1, 2].legend(loc="center", markerscale=2)
figure.savefig(DOCS / "stability-limits.png", dpi=110, metadata={"Software": None})

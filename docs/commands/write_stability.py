"""Writes figures into docs/stability.md: where plain forms fail, and extremes through the engine.

python docs/commands/write_stability.py [picture]

The picture, docs/stability-limits.png, has errors of plain forms and of ours towards five limits.

The page has the words. Rows whose figures no rounding makes stand there as they are; each row of
the first tables is held by the test that it names.
"""

from __future__ import annotations

import math
import sys
from functools import partial
from pathlib import Path

import numpy as np
import stability_forms as forms
from stability_engine import EXTREMES
from stability_forms import FORMS

PAGE = Path(__file__).parents[1] / "stability.md"
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
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
# Errors below these, by unit, are those of the last digits: another machine's may differ.
ROUNDING = {"": 1e-14, "m": 1e-8, "m/s": 1e-8, "°": 1e-12, "s": 1e-6}
# Units of rows whose errors are not relative.
UNITS = {
    "height 0.1 mm from the pole": "m",
    "the leap second at the end of 2016": "s",
    **dict.fromkeys(("the site at either pole", "the antimeridian between site and drone"), "m"),
    **dict.fromkeys(("the year 1970", "the year 2100"), "m"),
}


def in_words(error: float | str, unit: str = "") -> str:
    """An error to one digit; what is rounding alone, as that."""
    if isinstance(error, str):
        return error
    if math.isnan(error):
        return "no number"
    after = unit if unit == "°" else f" {unit}".rstrip()
    if 0 < error < ROUNDING.get(unit, 0.0) or (error == 0 and not unit):
        return f"under {in_words(ROUNDING[unit])}{after}"
    if error == 0 or 0.01 <= error < 1000:
        return f"{float(f'{error:.1g}'):g}{after}"
    digit, exponent = f"{error:.0e}".split("e")
    power = f"10{str(int(exponent)).translate(SUPERSCRIPT)}"
    return f"{'' if digit == '1' else f'{digit}·'}{power}{after}"


def filled(line: str) -> str:
    """A line of the page with the figures of its row anew, if it has any."""
    cells = [cell.strip() for cell in line.split("|")]
    name = cells[1] if len(cells) > 1 else ""
    unit = UNITS.get(name, "")
    if name in FORMS:
        cells[3], cells[5] = (in_words(error, unit) for error in FORMS[name]())
    elif name in EXTREMES:
        cells[3] = in_words(EXTREMES[name](), unit)
    else:
        return line
    return " | ".join(cells).strip()


def page() -> str:
    """The whole page; raises `KeyError` for a row that it has not."""
    lines = PAGE.read_text().splitlines()
    first = {line.split("|")[1].strip() for line in lines if line.count("|") > 1}
    if missing := (FORMS.keys() | EXTREMES.keys()) - first:
        raise KeyError(f"{PAGE.name} has no row {sorted(missing)}")
    return "\n".join(map(filled, lines)) + "\n"


def draw() -> None:
    """The picture."""
    import matplotlib as mpl

    mpl.use("agg")
    from matplotlib import pyplot as plt

    mpl.rcParams.update({"font.family": "DejaVu Sans", "font.size": 12})
    figure, panels = plt.subplots(2, 3, figsize=(15, 7.6), layout="constrained")
    for panel, (title, along, far, near, errors, least) in zip(panels.flat, LIMITS, strict=False):
        places = np.logspace(far, near, 161)
        both = np.transpose([errors(x) for x in places])
        for found, colour in zip(both, (PLAIN, OURS), strict=True):
            panel.scatter(places, np.maximum(found, least), color=colour, s=12, linewidths=0)
        panel.set(
            title=title, xlabel=along, xscale="log", yscale="log", xlim=(places[0], places[-1])
        )
        panel.set_ylim(least / 5, None)
        panel.grid(alpha=0.3)
        panel.minorticks_off()
    for row in panels:
        row[0].set_ylabel("relative error")
    panels[1, 2].axis("off")
    for name, colour in (("plain form", PLAIN), ("ours", OURS)):
        panels[1, 2].scatter([], [], color=colour, label=name)
    panels[1, 2].legend(loc="center", markerscale=2)
    picture = PAGE.with_name("stability-limits.png")
    figure.savefig(picture, dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    if sys.argv[1:] == ["picture"]:
        draw()
    PAGE.write_text(page())

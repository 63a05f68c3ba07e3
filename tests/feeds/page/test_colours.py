"""Colours of marks are told apart by who sees all colours, and by who is colour-blind.

Dichromats are simulated after Machado, Oliveira and Fernandes, "A Physiologically-based Model for
Simulation of Color Vision Deficiency", IEEE TVCG 15 (2009), with severity 1, on linear light;
differences are CIEDE2000 (Sharma, Wu and Dalal, Color Research and Application 30, 2005).
"""

from __future__ import annotations

import re
from importlib.resources import files
from itertools import combinations
from math import atan2, cos, degrees, exp, hypot, pi, radians, sin, sqrt
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

Colour = NDArray[np.float64]
LEAST = 15.0
LEAST_CONTRAST = 4.5  # Of words in a colour, on what is behind them: WCAG 2.2, 1.4.3
VISIONS = {
    "all colours": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
# Of linear sRGB, for its own white (IEC 61966-2-1).
XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)
SENSORS = tuple(f"s{i}" for i in range(8))
# Colours that are on show at once.
TOGETHER = {
    "the picture": (*SENSORS, "track", "truth", "gone", "sea"),
    "lateness": ("ink", "warn", "panel"),
    "loss": ("bad", "ink", "panel"),
    **{f"strips of {sensor}": (sensor, "ink", "panel") for sensor in SENSORS},
}


def theme_colours(theme: str) -> dict[str, Colour]:
    """Colours of a theme by name, 0 to 1 of linear light."""
    sheet = (files("plotfeed.feeds.page") / "static" / "page.css").read_text()
    selector = {"dark": r":root", "light": r':root\[data-theme="light"\]'}[theme]
    block = re.search(rf"^{selector} \{{(.*?)\}}", sheet, re.MULTILINE | re.DOTALL)
    assert block
    found = {}
    for name, code in re.findall(r"--([\w-]+): #([0-9a-f]{6});", block[1]):
        v = np.frombuffer(bytes.fromhex(code), np.uint8) / 255
        found[name] = np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)
    return found


def lab(colour: Colour) -> Colour:
    """CIE L*a*b*."""
    share = (XYZ @ colour) / XYZ.sum(axis=1)
    linear = (24389 / 27 * share + 16) / 116
    x, y, z = np.where(share > 216 / 24389, np.cbrt(share), linear)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def difference(one: Any, other: Any) -> float:
    """CIEDE2000."""
    (l1, a1, b1), (l2, a2, b2) = one, other
    mean_c7 = ((hypot(a1, b1) + hypot(a2, b2)) / 2) ** 7
    g = 0.5 * (1 - sqrt(mean_c7 / (mean_c7 + 25.0**7)))
    a1, a2 = a1 * (1 + g), a2 * (1 + g)
    c1, c2 = hypot(a1, b1), hypot(a2, b2)
    h1, h2 = degrees(atan2(b1, a1)) % 360, degrees(atan2(b2, a2)) % 360
    turn = 0.0 if c1 * c2 == 0 else (h2 - h1 + 180) % 360 - 180
    mean_h = h1 + h2 if c1 * c2 == 0 else (h1 + turn / 2) % 360
    d_l, d_c, d_h = l2 - l1, c2 - c1, 2 * sqrt(c1 * c2) * sin(radians(turn / 2))
    lightness, c = (l1 + l2) / 2, (c1 + c2) / 2
    t = (
        1
        - 0.17 * cos(radians(mean_h - 30))
        + 0.24 * cos(radians(2 * mean_h))
        + 0.32 * cos(radians(3 * mean_h + 6))
        - 0.20 * cos(radians(4 * mean_h - 63))
    )
    s_l = 1 + 0.015 * (lightness - 50) ** 2 / sqrt(20 + (lightness - 50) ** 2)
    s_c, s_h = 1 + 0.045 * c, 1 + 0.015 * c * t
    bend = 2 * sqrt(c**7 / (c**7 + 25.0**7)) * -sin(pi / 3 * exp(-(((mean_h - 275) / 25) ** 2)))
    return sqrt(
        (d_l / s_l) ** 2 + (d_c / s_c) ** 2 + (d_h / s_h) ** 2 + bend * (d_c / s_c) * (d_h / s_h)
    )


def test_differences_are_those_of_the_published_pairs() -> None:
    for one, other, expected in (
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, 2.5, 0.0), (50.0, 0.0, -2.5), 4.3065),
        ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
        ((90.8027, -2.0831, 1.4410), (91.1528, -1.6435, 0.0447), 1.4441),
        ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
    ):
        assert difference(one, other) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_any_two_colours_on_show_are_told_apart_and_words_in_them_can_be_read(theme: str) -> None:
    colours = theme_colours(theme)
    for vision, matrix in VISIONS.items():
        seen = {k: lab(np.clip(np.array(matrix) @ v, 0.0, 1.0)) for k, v in colours.items()}
        for where, names in TOGETHER.items():
            for one, other in combinations(names, 2):
                off = difference(seen[one], seen[other])
                assert off >= LEAST, f"{vision}, {where}: {one} and {other} differ by {off:.1f}"
    words = [("ink", "sea"), ("quiet", "sea")]
    words += [(name, "panel") for name in ("good", "warn", "bad", "ink", "quiet", "accent")]
    for pair in words:
        dark, bright = sorted(float((XYZ @ colours[name])[1]) for name in pair)
        assert (bright + 0.05) / (dark + 0.05) >= LEAST_CONTRAST, pair

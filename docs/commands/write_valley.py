"""Writes the ground of scene valley: two valleys and a ridge with a saddle, by formula.

python docs/commands/write_valley.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from plotfeed.feeds.scene.fields import site_frame
from plotfeed.feeds.scene.scene import example
from plotfeed.models.frames import geodetic_to_ecef

EXAMPLES = Path(__file__).parents[2] / "feeds" / "scene" / "examples"
TILE = EXAMPLES / "N46E011.hgt"
SIDE = 181
"""Samples along each edge, 20 arc seconds apart: 64 KiB."""
FLOOR_M = 1000.0
"""Of the valleys, above the ellipsoid; the site's height."""
RIDGE_EAST_M, RIDGE_WIDTH_M, RIDGE_M = 2500.0, 600.0, 420.0
SADDLE_NORTH_M, SADDLE_WIDTH_M, SADDLE_SHARE = 500.0, 700.0, 0.75
"""Where the ridge is lower, and by which share of its height."""
WALLS_M, WALLS_EAST_M, WALLS_WIDTH_M = 900.0, (-3500.0, 8500.0), 900.0
"""Mountains on both sides."""


def heights_m() -> np.ndarray:
    """Rows southwards and columns eastwards, above the ellipsoid."""
    steps = np.arange(SIDE) / (SIDE - 1)
    latitude_deg, longitude_deg = np.meshgrid(47.0 - steps, 11.0 + steps, indexing="ij")
    frame = site_frame(example("valley").scene.site)
    places = frame.from_ecef(geodetic_to_ecef(latitude_deg, longitude_deg, frame.height_m))
    east_m, north_m = places[..., 0], places[..., 1]
    saddle = SADDLE_SHARE * np.exp(-(((north_m - SADDLE_NORTH_M) / SADDLE_WIDTH_M) ** 2))
    ridge = np.exp(-0.5 * ((east_m - RIDGE_EAST_M) / RIDGE_WIDTH_M) ** 2)
    found = FLOOR_M + RIDGE_M * (1 - saddle) * ridge
    for wall_east_m in WALLS_EAST_M:
        found += WALLS_M * np.exp(-0.5 * ((east_m - wall_east_m) / WALLS_WIDTH_M) ** 2)
    return found


if __name__ == "__main__":
    TILE.write_bytes(heights_m().round().astype(">i2").tobytes())

"""Writes the ground of scene valley and the buildings of scene city, both by formula.

python docs/commands/write_example_ground.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.scene.fields import site_frame
from plotfeed.feeds.scene.scene import example
from plotfeed.models.frames import geodetic_to_ecef

EXAMPLES = Path(__file__).parents[2] / "feeds" / "scene" / "examples"
TILE, CITY = EXAMPLES / "N46E011.hgt", EXAMPLES / "city.geojson"
SIDE = 181  # Samples along each edge, 20 arc seconds apart: 64 KiB
FLOOR_M = 1000.0  # Of the valleys, above the ellipsoid; the site's height
RIDGE_EAST_M, RIDGE_WIDTH_M, RIDGE_M = 2500.0, 600.0, 420.0
# Where the ridge is lower, and by which share of its height.
SADDLE_NORTH_M, SADDLE_WIDTH_M, SADDLE_SHARE = 500.0, 700.0, 0.75
WALLS_M, WALLS_EAST_M, WALLS_WIDTH_M = 900.0, (-3500.0, 8500.0), 900.0  # Mountains on both sides
BLOCKS, BLOCK_M, STREET_M = 8, 80.0, 25.0  # On each side of a square of them, about the site
PLAZA = ((3, 3), (4, 3), (3, 4), (4, 4))  # Blocks that are not built on
LEAST_STOREYS, STOREYS, STOREY_M = 4, 7, 3.5


def valley_heights_m() -> np.ndarray:
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


def city_blocks() -> dict[str, Any]:
    """Blocks about a plaza, of 4 to 10 storeys, as GeoJSON."""
    frame, pitch_m = site_frame(example("city").scene.site), BLOCK_M + STREET_M
    features = []
    for i in range(BLOCKS):
        for j in range(BLOCKS):
            if (i, j) in PLAZA:
                continue
            west_m = (i - BLOCKS / 2) * pitch_m + STREET_M / 2
            south_m = (j - BLOCKS / 2) * pitch_m + STREET_M / 2
            sides = ((0, 0), (BLOCK_M, 0), (BLOCK_M, BLOCK_M), (0, BLOCK_M), (0, 0))
            corners = np.array([(west_m + x, south_m + y, 0.0) for x, y in sides])
            latitude_deg, longitude_deg, _ = frame.to_geodetic(corners)
            ring = np.stack([longitude_deg, latitude_deg], axis=-1).round(6).tolist()
            storeys = LEAST_STOREYS + (3 * i + 5 * j) % STOREYS
            features.append(
                {
                    "type": "Feature",
                    "properties": {"height": storeys * STOREY_M},
                    "geometry": {"type": "Polygon", "coordinates": [ring]},
                }
            )
    return {"type": "FeatureCollection", "features": features}


if __name__ == "__main__":
    TILE.write_bytes(valley_heights_m().round().astype(">i2").tobytes())
    CITY.write_text(json.dumps(city_blocks(), separators=(",", ":")) + "\n")

"""Ground and buildings for tests: a tile with a ridge across, and blocks as GeoJSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.models.frames import aer_to_enu
from plotfeed.testing import SITE

SIDE = 1201
TILE = "N40W004.hgt"
PLAIN_M = 500
RIDGE_NORTH_M = 3000.0
METRES_PER_DEG = 111_000.0


def write_ridge(folder: Path, *, height_m: int, name: str = TILE, plain_m: int = PLAIN_M) -> str:
    """A plain with a ridge from west to east, north of the site, some 200 m wide."""
    latitude_deg = 41 - np.arange(SIDE) / (SIDE - 1)
    middle_deg = SITE.latitude_deg + RIDGE_NORTH_M / METRES_PER_DEG
    heights = np.full((SIDE, SIDE), plain_m, ">i2")
    heights[np.abs(latitude_deg - middle_deg) < 100 / METRES_PER_DEG] = height_m
    heights.tofile(folder / name)
    return name


def footprint(azimuth_deg: float, range_m: float, side_m: float) -> list[list[float]]:
    """A square about a place seen from the site, corner by corner and back."""
    middle = aer_to_enu(azimuth_deg, 0.0, range_m)
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]
    places = [middle + np.array([x, y, 0.0]) * side_m / 2 for x, y in corners]
    geodetic = [SITE.to_geodetic(place) for place in places]
    return [[float(longitude), float(latitude)] for latitude, longitude, _ in geodetic]


def write_buildings(folder: Path, blocks: Sequence[tuple[list[list[float]], Any]]) -> str:
    """Footprints, each with its height."""
    features = [
        {
            "type": "Feature",
            "properties": {"height": height},
            "geometry": {"type": "Polygon", "coordinates": [ring]},
        }
        for ring, height in blocks
    ]
    tree = {"type": "FeatureCollection", "features": features}
    (folder / "city.geojson").write_text(json.dumps(tree))
    return "city.geojson"

"""Writes the map of scene field-day, the ground of valley and the buildings of city, by formula.

python docs/commands/write_example_ground.py
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.scene.fields import site_frame
from plotfeed.feeds.scene.scene import example
from plotfeed.models.frames import geodetic_to_ecef

EXAMPLES = Path(__file__).parents[2] / "feeds" / "scene" / "examples"
TILE = EXAMPLES / "N46E011.hgt"
SIDE = 181  # Samples along each edge, 20 arc seconds apart: 64 KiB
FLOOR_M = 1000.0  # Of the valleys, above the ellipsoid; the site's height
RIDGE_EAST_M, RIDGE_WIDTH_M, RIDGE_M = 2500.0, 600.0, 420.0
# Where the ridge is lower, and by which share of its height.
SADDLE_NORTH_M, SADDLE_WIDTH_M, SADDLE_SHARE = 500.0, 700.0, 0.75
WALLS_M, WALLS_EAST_M, WALLS_WIDTH_M = 900.0, (-3500.0, 8500.0), 900.0  # Mountains on both sides

BLOCKS, BLOCK_M, STREET_M = 8, 80.0, 25.0  # On each side of a square of them, about the site
PLAZA = ((3, 3), (4, 3), (3, 4), (4, 4))  # Blocks that are not built on
LEAST_STOREYS, STOREYS, STOREY_M = 4, 7, 3.5

RUNWAY = ((-1300.0, -180.0), (1250.0, 260.0))
RUNWAY_WIDTH_M = 60.0
TAXIWAY_OFF_M, TAXIWAY_WIDTH_M = 190.0, 24.0
HANGARS = ((-520.0, 330.0), (-400.0, 350.0), (-280.0, 372.0))
HANGAR_M = (90.0, 60.0)
FENCE = ((-1700, -650), (-1650, 500), (-700, 720), (1500, 900), (1700, -250), (300, -560))
ROADS = (
    ((-6500, -900), (-3000, -700), (-1750, -900), (400, -900), (1900, -450), (6500, 1900)),
    ((2300, -6500), (1900, -3000), (1900, -450), (2400, 1700), (2100, 6500)),
    ((-3000, -700), (-3300, 2500), (-2500, 6500)),
)
# Its middle, its radii east and north, and how many bays it has.
LAKE = ((-3900, 3300), 1100.0, 650.0, 8)
WOOD = ((-4600, -3400), 1300.0, 1500.0, 5)
# Its south-western corner, a block's side, and blocks east and north.
TOWN = ((2700.0, 1300.0), 240.0, (6, 5))
PYLONS = ((-1900.0, 2150.0), (-1900.0, 1250.0))
MAST = (1000.0, 700.0)

Place = tuple[float, float]
# Properties, kind of geometry, and places east and north of the site; of polygons, rings of them.
Feature = tuple[dict[str, Any], str, Any]


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


def square(west: float, south: float, side_m: float) -> list[Place]:
    """Corners of a block, anticlockwise."""
    east, north = west + side_m, south + side_m
    return [(west, south), (east, south), (east, north), (west, north)]


def city() -> Iterator[Feature]:
    """Blocks about a plaza, of 4 to 10 storeys."""
    pitch_m = BLOCK_M + STREET_M
    for i, j in np.ndindex(BLOCKS, BLOCKS):
        if (i, j) not in PLAZA:
            west_m, south_m = (((n - BLOCKS / 2) * pitch_m + STREET_M / 2) for n in (i, j))
            height_m = (LEAST_STOREYS + (3 * i + 5 * j) % STOREYS) * STOREY_M
            yield {"height": height_m}, "Polygon", [square(west_m, south_m, BLOCK_M)]


def beside(line: tuple[Place, Place], off_m: float, width_m: float) -> list[Place]:
    """Corners of a strip along a line, so far to its left."""
    begin, end = map(np.array, line)
    along = end - begin
    left = np.array([-along[1], along[0]]) / np.hypot(*along)
    near, far = off_m - width_m / 2, off_m + width_m / 2
    corners = (begin + near * left, end + near * left, end + far * left, begin + far * left)
    return [(float(east), float(north)) for east, north in corners]


def blob(middle: Place, east_m: float, north_m: float, bays: int) -> list[Place]:
    """The edge of something that has grown."""
    angles = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    radius = 1 + 0.13 * np.sin(bays * angles) + 0.07 * np.cos((bays + 3) * angles)
    east = middle[0] + east_m * radius * np.cos(angles)
    north = middle[1] + north_m * radius * np.sin(angles)
    return list(zip(east.tolist(), north.tolist(), strict=True))


def field_day() -> Iterator[Feature]:
    """An airfield with its roads, a wood, a lake and a town."""
    (west, south), side_m, number = TOWN
    width_m, depth_m = HANGAR_M
    yield {"name": "lake"}, "Polygon", [blob(*LAKE)]
    yield {"name": "wood"}, "Polygon", [blob(*WOOD)]
    for i, j in np.ndindex(*number):  # with streets of a tenth of a side between them
        yield {}, "Polygon", [square(west + i * side_m, south + j * side_m, 0.9 * side_m)]
    yield {"name": "runway"}, "Polygon", [beside(RUNWAY, 0.0, RUNWAY_WIDTH_M)]
    yield {}, "Polygon", [beside(RUNWAY, TAXIWAY_OFF_M, TAXIWAY_WIDTH_M)]
    for e, n in HANGARS:
        far = (e + width_m, n + depth_m + 16)
        yield {}, "Polygon", [[(e, n), (e + width_m, n + 16), far, (e, n + depth_m)]]
    for line in ((*FENCE, FENCE[0]), *ROADS):
        yield {}, "LineString", line
    yield {"name": "town"}, "Point", (west + 700.0, south + 1400.0)
    yield {"name": "hangars"}, "Point", (-400.0, 480.0)
    for name, place in (("mast", MAST), *(("pylon", pylon) for pylon in PYLONS)):
        yield {"name": name}, "Point", place


# By the scene: its features, and what stands between them in the file.
MAPS = {"field-day": (field_day, "\n"), "city": (city, "")}


def geojson(scene: str) -> str:
    """The map of a scene, by longitude and latitude."""
    made, between = MAPS[scene]
    frame = site_frame(example(scene).scene.site)

    def degrees(places: Any) -> Any:
        if isinstance(places[0], list | tuple):
            return [degrees(place) for place in places]
        latitude_deg, longitude_deg, _ = frame.to_geodetic(np.array([*places, 0.0]))
        return [round(float(longitude_deg), 6), round(float(latitude_deg), 6)]

    lines = []
    for properties, kind, places in made():
        rings = [[*ring, ring[0]] for ring in places] if kind == "Polygon" else places
        geometry = {"type": kind, "coordinates": degrees(rings)}
        feature = {"type": "Feature", "properties": properties, "geometry": geometry}
        lines.append(json.dumps(feature, separators=(",", ":")))
    inside = f",{between}".join(lines)
    return f'{{"type":"FeatureCollection","features":[{between}{inside}{between}]}}\n'


if __name__ == "__main__":
    TILE.write_bytes(valley_heights_m().round().astype(">i2").tobytes())
    for name in MAPS:
        (EXAMPLES / f"{name}.geojson").write_text(geojson(name), encoding="utf-8")

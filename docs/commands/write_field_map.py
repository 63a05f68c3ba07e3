"""Writes the map of scene field-day: an airfield with its roads, a wood, a lake and a town.

python docs/commands/write_field_map.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.scene.fields import site_frame
from plotfeed.feeds.scene.scene import example
from plotfeed.models.frames import ecef_to_geodetic

MAP = Path(__file__).parents[2] / "feeds" / "scene" / "examples" / "field-day.geojson"
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


def beside(line: tuple[Place, Place], off_m: float, width_m: float) -> list[Place]:
    """Corners of a strip along a line, so far to its left."""
    (east0, north0), (east1, north1) = line
    along = np.array([east1 - east0, north1 - north0])
    left = np.array([-along[1], along[0]]) / np.hypot(*along)
    begin, end = np.array([east0, north0]), np.array([east1, north1])
    near, far = off_m - width_m / 2, off_m + width_m / 2
    corners = (begin + near * left, end + near * left, end + far * left, begin + far * left)
    return [(float(east), float(north)) for east, north in corners]


def blob(middle: Place, east_m: float, north_m: float, bays: int) -> list[Place]:
    """The edge of something that has grown."""
    angles = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    radius = 1 + 0.13 * np.sin(bays * angles) + 0.07 * np.cos((bays + 3) * angles)
    east, north = (
        middle[0] + east_m * radius * np.cos(angles),
        middle[1] + north_m * radius * np.sin(angles),
    )
    return list(zip(east.tolist(), north.tolist(), strict=True))


def blocks(corner: Place, side_m: float, number: tuple[int, int]) -> list[list[Place]]:
    """A town's, with streets of a tenth of a side between them."""
    found = []
    for i in range(number[0]):
        for j in range(number[1]):
            west, south = corner[0] + i * side_m, corner[1] + j * side_m
            east, north = west + 0.9 * side_m, south + 0.9 * side_m
            found.append([(west, south), (east, south), (east, north), (west, north)])
    return found


def features() -> list[tuple[str, str, Any]]:
    """Names, kinds of geometry, and places east and north of the site."""
    width_m, depth_m = HANGAR_M
    hangars = [
        [(e, n), (e + width_m, n + 16), (e + width_m, n + depth_m + 16), (e, n + depth_m)]
        for e, n in HANGARS
    ]
    return [
        ("lake", "Polygon", [blob(*LAKE)]),
        ("wood", "Polygon", [blob(*WOOD)]),
        *(("", "Polygon", [block]) for block in blocks(*TOWN)),
        ("runway", "Polygon", [beside(RUNWAY, 0.0, RUNWAY_WIDTH_M)]),
        ("", "Polygon", [beside(RUNWAY, TAXIWAY_OFF_M, TAXIWAY_WIDTH_M)]),
        *(("", "Polygon", [hangar]) for hangar in hangars),
        ("", "LineString", [*FENCE, FENCE[0]]),
        *(("", "LineString", [*road]) for road in ROADS),
        ("town", "Point", (TOWN[0][0] + 700.0, TOWN[0][1] + 1400.0)),
        ("hangars", "Point", (-400.0, 480.0)),
        ("mast", "Point", MAST),
        *(("pylon", "Point", pylon) for pylon in PYLONS),
    ]


def main() -> None:
    """Write the file."""
    frame = site_frame(example("field-day").scene.site)

    def degrees(places: Any) -> Any:
        if isinstance(places[0], list | tuple):
            return [degrees(place) for place in places]
        ecef_m = frame.to_ecef(np.array([[*places, 0.0]]))
        latitude_deg, longitude_deg, _ = (float(x[0]) for x in ecef_to_geodetic(ecef_m))
        return [round(longitude_deg, 6), round(latitude_deg, 6)]

    found = []
    for name, kind, places in features():
        rings = [[*ring, ring[0]] for ring in places] if kind == "Polygon" else places
        found.append(
            {
                "type": "Feature",
                "properties": {"name": name} if name else {},
                "geometry": {"type": kind, "coordinates": degrees(rings)},
            }
        )
    lines = ",\n".join(json.dumps(feature, separators=(",", ":")) for feature in found)
    MAP.write_text(f'{{"type":"FeatureCollection","features":[\n{lines}\n]}}\n', encoding="utf-8")


if __name__ == "__main__":
    main()

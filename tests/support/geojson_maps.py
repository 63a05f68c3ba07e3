"""Maps in GeoJSON, right and wrong, and what the page's server makes of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed import testing
from plotfeed.feeds.page.scene_outline import load_basemap
from plotfeed.feeds.scene.fields import Site

SITE = Site(latitude_deg=40.45, longitude_deg=-3.73, height_m=650.0)


def place(east_m: float, north_m: float) -> list[float]:
    """Longitude and latitude."""
    latitude_deg, longitude_deg, _ = testing.SITE.to_geodetic(np.array([east_m, north_m, 0.0]))
    return [float(longitude_deg), float(latitude_deg)]


def loaded(tmp_path: Path, tree: Any) -> dict[str, Any]:
    path = tmp_path / "map.geojson"
    path.write_text(json.dumps(tree))
    found: dict[str, Any] = json.loads(load_basemap(path.name, path, SITE).content)
    return found


def feature(kind: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


LINE = [place(0, 0), place(1000, 2000)]
RING = [place(0, 0), place(500, 0), place(500, 500), place(0, 0)]
COLLECTION = {"type": "GeometryCollection", "geometries": [feature("LineString", LINE)["geometry"]]}
SHAPES = {
    "type": "FeatureCollection",
    "features": [
        feature("LineString", LINE),
        feature("MultiLineString", [LINE, LINE]),
        feature("Polygon", [RING]),
        feature("MultiPolygon", [[RING], [RING, RING]]),
        feature("Point", place(-700, 300), name="Tower"),
        feature("MultiPoint", [place(1, 1), place(2, 2)]),
        {"type": "Feature", "properties": None, "geometry": None},
        {"type": "Feature", "properties": {}, "geometry": COLLECTION},
    ],
}


NO_GEOJSON: list[tuple[Any, str]] = [
    ([], "expected GeoJSON"),
    ({"type": "Topology"}, "coordinates"),
    ({"type": "LineString"}, "coordinates"),
    ({"type": "LineString", "coordinates": []}, "coordinates"),
    ({"type": "LineString", "coordinates": [[1, 100], [2, 3]]}, "degrees"),
    ({"type": "LineString", "coordinates": [["a", "b"]]}, "lists of longitude"),
    ({"type": "LineString", "coordinates": [[None, 1]]}, "coordinates"),
    ({"type": "LineString", "coordinates": [5]}, "lists of longitude"),
    ({"type": "Circle", "coordinates": [1, 2]}, "'Circle'"),
    ({"type": "FeatureCollection", "features": 5}, "features"),
]

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from plotfeed import testing
from plotfeed.feeds.page import scene_outline
from plotfeed.feeds.page.scene_outline import load_basemap
from plotfeed.feeds.scene.fields import Site
from plotfeed.feeds.scene.output_keys import BasemapImage, PageKeys
from plotfeed.feeds.telemetry.foreign_files import FileLimits
from plotfeed.proto.errors import PlotfeedError

SITE = Site(latitude_deg=40.45, longitude_deg=-3.73, height_m=650.0)
PNG = b"\x89PNG\r\n\x1a\n" + bytes(20)


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


def test_geojson_becomes_metres_from_the_site(tmp_path: Path) -> None:
    line = [place(0, 0), place(1000, 2000)]
    ring = [place(0, 0), place(500, 0), place(500, 500), place(0, 0)]
    tree = {
        "type": "FeatureCollection",
        "features": [
            feature("LineString", line),
            feature("MultiLineString", [line, line]),
            feature("Polygon", [ring]),
            feature("MultiPolygon", [[ring], [ring, ring]]),
            feature("Point", place(-700, 300), name="Tower"),
            feature("MultiPoint", [place(1, 1), place(2, 2)]),
            {"type": "Feature", "properties": None, "geometry": None},
            {
                "type": "Feature",
                "properties": {},
                "geometry": {
                    "type": "GeometryCollection",
                    "geometries": [{"type": "LineString", "coordinates": line}],
                },
            },
        ],
    }
    shapes = loaded(tmp_path, tree)
    assert {kind: len(found) for kind, found in shapes.items()} == {
        "lines": 4,
        "areas": 4,
        "points": 3,
    }
    np.testing.assert_allclose(shapes["lines"][0], [0, 0, 1000, 2000], atol=0.2)
    assert shapes["points"][0][2] == "Tower"
    np.testing.assert_allclose(shapes["points"][0][:2], [-700, 300], atol=0.2)


@pytest.mark.parametrize(
    ("tree", "why"),
    [
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
    ],
)
def test_what_is_no_geojson_is_one_line(tmp_path: Path, tree: Any, why: str) -> None:
    with pytest.raises(PlotfeedError, match=why) as error:
        loaded(tmp_path, tree)
    assert str(error.value).startswith("page.basemap: ")
    assert "\n" not in str(error.value)


def test_depth_and_size_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tree: Any = {"type": "Point", "coordinates": [0, 0]}
    for _ in range(20):
        tree = {"type": "GeometryCollection", "geometries": [tree]}
    with pytest.raises(PlotfeedError, match="expected GeoJSON"):
        loaded(tmp_path, tree)
    (tmp_path / "deep").write_text("[" * 100_000)
    with pytest.raises(PlotfeedError, match="deep"):
        load_basemap("deep", tmp_path / "deep", SITE)
    monkeypatch.setattr(scene_outline, "LIMITS", FileLimits(1 << 20, 3, 8))
    with pytest.raises(PlotfeedError, match="vertices"):
        loaded(tmp_path, {"type": "LineString", "coordinates": [[0, 0]] * 4})
    os.truncate(tmp_path / "deep", 33 << 20)
    with pytest.raises(PlotfeedError, match="larger"):
        load_basemap("deep", tmp_path / "deep", SITE)


def test_a_file_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(PlotfeedError, match=r"nowhere\.geojson: cannot be read: No such file"):
        load_basemap("nowhere.geojson", tmp_path / "nowhere.geojson", SITE)


def image(
    tmp_path: Path, corners: list[list[float]], content: bytes = PNG
) -> scene_outline.Basemap:
    (tmp_path / "map.png").write_bytes(content)
    latitude_first = [(latitude, longitude) for longitude, latitude in corners]
    settings = BasemapImage.model_validate({"image": "map.png", "corners": latitude_first})
    return load_basemap(settings, tmp_path / "map.png", SITE)


def test_an_image_lies_between_its_corners(tmp_path: Path) -> None:
    corners = [place(-100, 200), place(300, 220), place(320, -180), place(-80, -200)]
    found = image(tmp_path, corners)
    assert (found.media_type, found.content) == ("image/png", PNG)
    assert found.corners_m is not None
    np.testing.assert_allclose(found.corners_m, [[-100, 200], [300, 220], [-80, -200]], atol=0.1)


def test_corners_that_make_no_parallelogram_are_refused(tmp_path: Path) -> None:
    crossed = [place(-100, 200), place(300, -180), place(300, 220), place(-80, -200)]
    with pytest.raises(PlotfeedError, match="parallelogram"):
        image(tmp_path, crossed)
    with pytest.raises(PlotfeedError, match="parallelogram"):
        image(tmp_path, [place(0, 0)] * 4)


def test_only_images_are_images(tmp_path: Path) -> None:
    corners = [place(-100, 200), place(300, 200), place(300, -200), place(-100, -200)]
    with pytest.raises(PlotfeedError, match="PNG, JPEG or WebP"):
        image(tmp_path, corners, b"<svg onload='alert(1)'>")


def test_the_keys_of_the_page_are_checked() -> None:
    part = PageKeys.model_validate(
        {"basemap": {"image": "a.png", "corners": [[1, 2], [1, 3], [0, 3], [0, 2]]}}
    )
    assert isinstance(part.basemap, BasemapImage)
    assert PageKeys.model_validate({"basemap": "a.geojson"}).basemap == "a.geojson"
    wrong: list[dict[str, Any]] = [
        {"basemap": {"image": "a.png", "corners": [[1, 2], [1, 3], [0, 3]]}},
        {"basemap": {"image": "a.png", "corners": [[1, 2], [1, 3], [0, 3], [100, 2]]}},
        {"tracks_topic": "tracks/#"},
        {"tracks_topic": ""},
        {"afterglow_s": 0},
        {"map": "a.geojson"},
    ]
    for tree in wrong:
        with pytest.raises(ValidationError):
            PageKeys.model_validate(tree)

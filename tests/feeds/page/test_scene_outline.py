"""What the page is told of a scene before anything happens: its basemap, cover, and ways out."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from support.every_kind import FAR_SENSORS
from support.geojson_maps import NO_GEOJSON, SHAPES, SITE, loaded, place
from support.scene_files import radar, scene_file, scene_text

from plotfeed import testing
from plotfeed.feeds.engine.sensor_description import description_of
from plotfeed.feeds.page import scene_outline
from plotfeed.feeds.page.scene_outline import Basemap, connections, cover_of, load_basemap
from plotfeed.feeds.scene.output_keys import BasemapImage, PageKeys
from plotfeed.feeds.scene.scene import example, load
from plotfeed.feeds.telemetry.foreign_files import FileLimits
from plotfeed.proto.errors import PlotfeedError

PNG = b"\x89PNG\r\n\x1a\n" + bytes(20)


def test_geojson_becomes_metres_from_the_site(tmp_path: Path) -> None:
    shapes = loaded(tmp_path, SHAPES)
    assert {kind: len(found) for kind, found in shapes.items()} == {
        "lines": 4,
        "areas": 4,
        "points": 3,
    }
    np.testing.assert_allclose(shapes["lines"][0], [0, 0, 1000, 2000], atol=0.2)
    for area in shapes["areas"]:
        np.testing.assert_allclose(area, [0, 0, 500, 0, 500, 500, 0, 0], atol=0.2)
    assert shapes["points"][0][2] == "Tower"
    np.testing.assert_allclose(shapes["points"][0][:2], [-700, 300], atol=0.2)


@pytest.mark.parametrize(("tree", "why"), NO_GEOJSON)
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
    deep = tmp_path / "deep"
    deep.write_text("[" * 100_000)
    with pytest.raises(PlotfeedError, match="deep"):
        load_basemap("deep", deep, SITE)
    monkeypatch.setattr(scene_outline, "LIMITS", FileLimits(1 << 20, 3, 8))
    with pytest.raises(PlotfeedError, match="vertices"):
        loaded(tmp_path, {"type": "LineString", "coordinates": [[0, 0]] * 4})
    os.truncate(deep, 33 << 20)
    with pytest.raises(PlotfeedError, match="larger"):
        load_basemap("deep", deep, SITE)
    with pytest.raises(PlotfeedError, match=r"nowhere\.geojson: cannot be read: No such file"):
        load_basemap("nowhere.geojson", tmp_path / "nowhere.geojson", SITE)


def image(tmp_path: Path, corners: list[list[float]], content: bytes = PNG) -> Basemap:
    (tmp_path / "map.png").write_bytes(content)
    latitude_first = [(latitude, longitude) for longitude, latitude in corners]
    settings = BasemapImage.model_validate({"image": "map.png", "corners": latitude_first})
    return load_basemap(settings, tmp_path / "map.png", SITE)


def test_an_image_lies_between_its_corners_which_make_a_parallelogram(tmp_path: Path) -> None:
    corners = [place(-100, 200), place(300, 220), place(320, -180), place(-80, -200)]
    found = image(tmp_path, corners)
    assert (found.media_type, found.content) == ("image/png", PNG)
    assert found.corners_m is not None
    np.testing.assert_allclose(found.corners_m, [[-100, 200], [300, 220], [-80, -200]], atol=0.1)
    first, second, third, fourth = corners
    for wrong in ([first, third, second, fourth], [place(0, 0)] * 4):
        with pytest.raises(PlotfeedError, match="parallelogram"):
            image(tmp_path, wrong)
    with pytest.raises(PlotfeedError, match="PNG, JPEG or WebP"):
        image(tmp_path, corners, b"<svg onload='alert(1)'>")


def test_the_keys_of_the_page_are_checked() -> None:
    corners = [[1, 2], [1, 3], [0, 3], [0, 2]]
    part = PageKeys.model_validate({"basemap": {"image": "a.png", "corners": corners}})
    assert isinstance(part.basemap, BasemapImage)
    assert PageKeys.model_validate({"basemap": "a.geojson"}).basemap == "a.geojson"
    wrong: list[dict[str, Any]] = [
        {"basemap": {"image": "a.png", "corners": corners[:3]}},
        {"basemap": {"image": "a.png", "corners": [*corners[:3], [100, 2]]}},
        {"tracks_topic": "tracks/#"},
        {"tracks_topic": ""},
        {"afterglow_s": 0},
        {"map": "a.geojson"},
    ]
    for tree in wrong:
        with pytest.raises(ValidationError):
            PageKeys.model_validate(tree)


def test_the_cover_of_a_sensor_is_that_of_its_keys_as_they_are_now() -> None:
    sector = {"azimuth_min_deg": 10.0, "azimuth_max_deg": 50.0, "scan": testing.staring()}
    for keys, low_deg, span_deg in (
        (FAR_SENSORS["camera"] | {"horizontal_fov_deg": 20.0, "pan_deg": 60.0}, 50.0, 20.0),
        (testing.radar(**sector), 10.0, 40.0),
        (testing.radar(), -180.0, 360.0),
    ):
        (sensor,) = testing.scene([keys], seed=1).sensor
        cover = cover_of(sensor, SITE)
        assert (cover["azimuth_min_deg"], cover["azimuth_span_deg"]) == (low_deg, span_deg)
    jammer = {"east_m": 900.0, "north_m": -300.0, "above_site_m": 40.0, "eirp_w": 10.0}
    jammer |= {"frequency_hz": 9.4e9, "bandwidth_hz": 4e7}
    (sensor,) = testing.scene([testing.radar(jamming={"east": jammer})], seed=1).sensor
    assert cover_of(sensor, SITE)["jammers"] == [{"id": "east", "east_m": 900.0, "north_m": -300.0}]


URLS = {"MQTT": "mqtt://127.0.0.1:1884 (port 1884 is taken)"}
UDP = """
[[udp]]
destination = "239.255.0.1:8600"
interface = "lo"

[[udp]]
destination = "127.0.0.1:8601"
sensors = ["other"]
"""


def test_topics_are_those_that_the_sensors_describe() -> None:
    scene = example("field-day")
    told = connections(scene, URLS)
    assert told["brokers"] == [
        {"protocol": "MQTT", "url": "mqtt://127.0.0.1:1884", "needs_password": False}
    ]
    for sensor in scene.sensor:
        outputs = [o.topic for o in description_of(scene, scene.sea_level(), sensor).outputs]
        assert [t["topic"] for t in told["sensors"][sensor.id]["topics"]] == outputs != []
    assert "truth" not in json.dumps(told)
    assert "control" not in json.dumps(told)


def test_a_sensor_is_told_where_its_own_datagrams_go(tmp_path: Path) -> None:
    scene = load(scene_file(tmp_path, scene_text(sensors=radar("one") + radar("other")) + UDP))
    for sends_udp, expected in (
        (True, {"one": ["239.255.0.1:8600"], "other": ["239.255.0.1:8600", "127.0.0.1:8601"]}),
        (False, {"one": [], "other": []}),
    ):
        told = connections(scene, URLS, sends_udp=sends_udp)["sensors"]
        to = {name: [to["destination"] for to in each["udp"]] for name, each in told.items()}
        assert to == expected

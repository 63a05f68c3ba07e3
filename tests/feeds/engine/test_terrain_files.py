"""Files of the ground and of buildings: what is read of them, what is refused, and recordings."""

from __future__ import annotations

import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.command import plotfeed_here
from support.hills import METRES_PER_DEG, SIDE, TILE, footprint, write_buildings, write_ridge
from support.scene_files import DRONE, scene_file, scene_text

from plotfeed.feeds.engine.simulation import simulate
from plotfeed.feeds.engine.terrain_files import Horizons, ground_of, horizons_of, walls_of
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.models.effects.line_of_sight import Ground
from plotfeed.models.frames import geoid_undulation_m
from plotfeed.proto.errors import PlotfeedError
from plotfeed.testing import SITE, START_NS, held, radar, scene

HERE = np.array([SITE.latitude_deg]), np.array([SITE.longitude_deg])
SIMULATED = ("--speed", "max", "--broker", "none", "--json")


def named(folder: Path, **terrain: Any) -> Scene:
    return scene([radar()], seed=1, folder=folder, terrain=terrain)


def ground(folder: Path, file: str, above: str = "ellipsoid") -> Ground:
    found = ground_of(named(folder, elevation=[file], elevation_above=above))
    assert found is not None
    return found


def test_a_tile_lies_where_its_name_says_and_is_above_the_sea(tmp_path: Path) -> None:
    write_ridge(tmp_path, height_m=800)
    above_sea, plain = ground(tmp_path, TILE, "sea-level"), ground(tmp_path, TILE)
    north = HERE[0] + 3000 / METRES_PER_DEG
    assert plain.height_m(*HERE) == pytest.approx(500.0)
    assert plain.height_m(north, HERE[1]) == pytest.approx(800.0)
    undulation_m = geoid_undulation_m(*HERE)
    np.testing.assert_allclose(above_sea.height_m(*HERE), 500.0 + undulation_m)
    assert np.isnan(plain.height_m(HERE[0] + 1, HERE[1])).all()
    write_ridge(tmp_path, height_m=800, name="S41W004.hgt")
    south = ground(tmp_path, "S41W004.hgt")
    assert south.height_m(-HERE[0], HERE[1]) == pytest.approx(500.0)


def test_a_geotiff_in_any_projection_is_the_same_ground(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    from rasterio.transform import Affine

    place = Affine(30.0, 0.0, 438_100.0 - 6000, 0.0, -30.0, 4_477_900.0 + 6000)  # UTM zone 30
    metres = np.full((400, 400), 700.0, np.float32)
    metres[:200] = 900.0
    metres[0, 0] = -9999.0
    how = {"width": 400, "height": 400, "count": 1, "dtype": "float32", "crs": "EPSG:32630"}
    how |= {"nodata": -9999.0, "transform": place, "driver": "GTiff"}
    with rasterio.open(tmp_path / "utm.tif", "w", **how) as file:
        file.write(metres, 1)
    offsets = np.array([-3000.0, -200.0, 200.0, 3000.0]) / METRES_PER_DEG
    found = ground(tmp_path, "utm.tif").height_m(HERE[0] + offsets, HERE[1] + 0 * offsets)
    np.testing.assert_allclose(found, [700.0, 700.0, 900.0, 900.0])
    (tmp_path / "no.tif").write_bytes(b"II*\0nothing")
    with pytest.raises(PlotfeedError, match=r"no\.tif: not a GeoTIFF file that can be read"):
        ground(tmp_path, "no.tif")


def test_without_rasterio_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rasterio", None)
    with pytest.raises(PlotfeedError, match=r"needs rasterio: pip install 'plotfeed\[terrain\]'"):
        ground(tmp_path, "some.tif")


def polygon(coordinates: Any, height: Any = 10) -> str:
    feature = {"properties": {"height": height},
               "geometry": {"type": "Polygon", "coordinates": coordinates}}  # fmt: skip
    return json.dumps({"type": "FeatureCollection", "features": [feature]})


SQUARE = [[-3.7, 40.4], [-3.6, 40.4], [-3.6, 40.5]]
HEIGHT = "feature 0: expected its height in metres as"
RINGS = "feature 0: expected rings of longitude and latitude"


@pytest.mark.parametrize(
    ("name", "octets", "says"),
    [
        ("hill.hgt", "", "expected a name such as N40W004.hgt"),
        ("N40W004.hgt", "\0" * 10, "expected a square of 16-bit heights, not 5"),
        ("N40W004.hgt", None, "No such file"),
        ("N40W004.asc", "", r"expected a name that ends in \.hgt or \.tif"),
        ("c.geojson", "{", "not JSON"),
        ("c.geojson", "[]", "expected GeoJSON, an object with features"),
        ("c.geojson", polygon([SQUARE], None), "0: expected its height .* 'height', not None"),
        ("c.geojson", polygon([SQUARE], "tall"), HEIGHT),
        ("c.geojson", polygon([SQUARE], float("nan")), HEIGHT),
        ("c.geojson", polygon([SQUARE[:2]]), RINGS),
        ("c.geojson", polygon([[[400, 1], [2, 3], [4, 5]]]), RINGS),
        ("c.geojson", polygon([["a", "b", "c"]]), RINGS),
        ("c.geojson", polygon(7), RINGS),
    ],
)
def test_a_file_without_use_is_refused_in_a_line(
    tmp_path: Path, name: str, octets: str | None, says: str
) -> None:
    if octets is not None:
        (tmp_path / name).write_text(octets)
    made = named(tmp_path, **{"buildings" if "geojson" in name else "elevation": [name]})
    with pytest.raises(PlotfeedError, match=says) as told:
        walls_of(made, ground_of(made))
    assert "\n" not in str(told.value)


def test_heights_may_have_a_unit_and_what_has_no_area_is_passed_over(tmp_path: Path) -> None:
    ring = footprint(0.0, 500.0, 50.0)
    (tmp_path / "a.geojson").write_text(polygon([ring], "12 m"))
    lines = {"type": "LineString", "coordinates": ring}
    several = {"type": "MultiPolygon", "coordinates": [[ring], [ring, ring]]}
    low = {"properties": {"height": 3}, "geometry": several}
    features = [{"geometry": lines}, {"geometry": None}, "nothing", low]
    (tmp_path / "b.geojson").write_text(json.dumps({"features": features}))
    walls = walls_of(named(tmp_path, buildings=["a.geojson", "b.geojson"]), None)
    assert walls is not None
    assert len(walls) == 4 * 5
    heights_m = SITE.from_ecef(walls.from_ecef_m)[:, 2]
    np.testing.assert_allclose(heights_m[:5], 12.0, atol=0.05)
    np.testing.assert_allclose(heights_m[5:], 3.0, atol=0.05)


def test_buildings_stand_on_the_ground_where_it_is_known(tmp_path: Path) -> None:
    write_ridge(tmp_path, height_m=800)
    city = write_buildings(tmp_path, [(footprint(0.0, 3000.0, 50.0), 20.0)])
    made = named(tmp_path, elevation=[TILE], elevation_above="ellipsoid", buildings=[city])
    walls = walls_of(made, ground_of(made))
    assert walls is not None
    tops_m = SITE.to_geodetic(SITE.from_ecef(walls.from_ecef_m))[2]
    np.testing.assert_allclose(tops_m, 820.0, atol=1.0)


def test_terrain_that_names_nothing_is_refused() -> None:
    with pytest.raises(PlotfeedError, match="elevation: needed, or buildings"):
        named(Path(), diffraction=True)


RIDGE = f'\n[terrain]\nelevation = ["{TILE}"]\nelevation_above = "ellipsoid"\n'


def test_a_recording_brings_horizons_along_and_is_run_again_without_the_files(
    tmp_path: Path,
) -> None:
    write_ridge(tmp_path, height_m=760)
    near, behind = "north_m = 800.0, above_site_m = 200.0", "north_m = 5e3, above_site_m = 60.0"
    drones = DRONE.replace(near, behind)
    start = "2026-01-01T12:00:00Z"
    path = scene_file(tmp_path, scene_text(start_utc=start, port=1883, drones=drones) + RIDGE)
    record, again, looks = tmp_path / "record.mcap", tmp_path / "again.mcap", []
    for what, file in (([path, "--duration", "4"], record), ([record], again)):
        done = plotfeed_here("run", *what, "--record", file, *SIMULATED)
        assert done.returncode == 0, done.stderr
        (tmp_path / TILE).unlink(missing_ok=True)
        shown = plotfeed_here("show", file, "--list", "--topic", "plotfeed/truth").stdout
        looks.append([line for line in shown.splitlines() if "look" in line])
    assert record.stat().st_size < 2 * SIDE * SIDE
    assert looks[0]
    assert looks[0] == looks[1]


def test_horizons_are_the_same_after_a_recording_and_damage_is_told(tmp_path: Path) -> None:
    write_ridge(tmp_path, height_m=800)
    drones = [held("d", 0.0, 3.0, 4000.0)]
    made = scene([radar(power_w=5e4)], drones, seed=1, folder=tmp_path,
                 terrain={"elevation": [TILE], "diffraction": True})  # fmt: skip
    told = tmp_path / "horizons"
    told.write_bytes(horizons_of(made))
    enclosed = made.enclosed({"horizons": told})
    first, again = (simulate(s, 3, start_utc_ns=START_NS)["radar"] for s in (made, enclosed))
    assert first.looks.snr[0] > 0
    np.testing.assert_array_equal(first.looks.snr, again.looks.snr)
    assert made.terrain is not None
    with pytest.raises(PlotfeedError, match="does not hold it"):
        Horizons(made.enclosed({}), made.terrain)
    elsewhere = scene([radar(position_enu_m=[9.0, 0.0, 0.0])], seed=1,
                      terrain={"elevation": [TILE]}).enclosed({"horizons": told})  # fmt: skip
    with pytest.raises(PlotfeedError, match="the recording holds no horizon for sensor 'radar'"):
        simulate(elsewhere, 1, start_utc_ns=START_NS)
    for damaged in (told.read_bytes()[:-3], b"\xff" * 99, zlib.compress(b"\1")):
        told.write_bytes(damaged)
        with pytest.raises(PlotfeedError, match="horizons are damaged"):
            Horizons(enclosed, made.terrain)


def test_check_tells_of_terrain_and_of_a_sensor_below_the_ground(tmp_path: Path) -> None:
    write_ridge(tmp_path, height_m=760, plain_m=700)
    path = scene_file(tmp_path, scene_text(port=1883) + RIDGE)
    told = json.loads(plotfeed_here("check", path, "--json").stdout)["sensors"][0]
    assert told["effects"]["terrain"]["elevation"] == [TILE]
    assert any("50 m below the ground of terrain.elevation" in line for line in told["warnings"])
    assert max(row["pd"] for row in told["table"][2:]) < 1e-4
    write_ridge(tmp_path, height_m=760)
    told = json.loads(plotfeed_here("check", path, "--json").stdout)["sensors"][0]
    assert not any("below the ground" in line for line in told["warnings"])
    assert load(path).terrain is not None

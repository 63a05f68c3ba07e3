"""Heights above mean sea level in a scene's file stand above the ellipsoid by the geoid."""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.scene_files import scene_file, scene_text

from plotfeed.feeds.cli.check import report
from plotfeed.feeds.scene.fields import Location, frame_at, geodetic, site_frame
from plotfeed.feeds.scene.scene import Scene, SceneError, load
from plotfeed.models.frames import geodetic_to_ecef, geoid_undulation_m
from plotfeed.proto.errors import PlotfeedError

NODES = {  # of EGM96, every 15', by the US National Geospatial-Intelligence Agency
    "Canberra": (-35.5, 149.0, 19.167),
    "Madrid": (40.5, -3.5, 51.804),
    "Denver": (39.5, -105.0, -16.449),
    "Tokyo": (35.5, 139.5, 36.993),
    "Delhi": (28.5, 77.0, -52.176),
    "Reykjavik": (64.0, -22.0, 66.312),
}
ROUNDED_M = 0.0501  # Of a node of the package's grid, in whole decimetres
SITE = "latitude_deg = 40.45\nlongitude_deg = -3.73\nheight_m = 650.0\n"
ABOVE_SEA = SITE.replace("height_m", "height_msl_m")
NOISE = "id = 'far'\neirp_w = 1.0\nfrequency_hz = 9e9\nbandwidth_hz = 1e6\n"


def written(folder: Path, site: str = SITE, *, sensor: str = "", **others: Any) -> Scene:
    text = scene_text(port=1883, **{"telemetry": "", **others}).replace(SITE, site)
    return load(scene_file(folder, text.replace('id = "radar"', f'id = "radar"\n{sensor}')))


def site_at(latitude_deg: float, longitude_deg: float, height: str) -> str:
    return f"latitude_deg = {latitude_deg}\nlongitude_deg = {longitude_deg}\n{height}\n"


@pytest.mark.parametrize("name", NODES)
def test_what_is_above_the_sea_stands_so_far_above_the_geoid_where_it_is(
    name: str, tmp_path: Path
) -> None:
    """A site; a waypoint and a sensor 70 km off theirs, whose horizontal is 400 m above them."""
    latitude_deg, longitude_deg, undulation_m = NODES[name]
    scene = written(tmp_path, site_at(latitude_deg, longitude_deg, "height_msl_m = 577.0"))
    assert scene.scene.site.height_m == pytest.approx(577.0 + undulation_m, abs=ROUNDED_M)
    place = f"latitude_deg = {latitude_deg}, longitude_deg = {longitude_deg}, height_msl_m"
    path = f"[{{ {place} = 700 }}, {{ {place} = 800.5 }}]"
    drone = f"[[drone]]\nid = 'visitor'\nspeed_m_s = 5.0\npath = {path}\n"
    site = site_at(latitude_deg - 0.5, longitude_deg - 0.5, "height_m = 100.0")
    there = written(tmp_path, site, drones=drone)
    ends = [geodetic(there.scene.site, waypoint)[2] for waypoint in there.drone[0].path]
    assert ends == pytest.approx([700 + undulation_m, 800.5 + undulation_m], abs=ROUNDED_M)
    first = geodetic(there.scene.site, there.drone[0].path[0])
    frame = frame_at(there.scene.site, (0.0, 0.0, 0.0))
    east_m, north_m, _ = frame.from_ecef(geodetic_to_ecef(*first)).tolist()
    off = f"position_enu_m = [{east_m}, {north_m}, 0.0]\nheight_msl_m = 612.0"
    scene = written(tmp_path, site, drones=drone, sensor=off)
    stands = frame_at(scene.scene.site, scene.sensor[0].position_enu_m)
    assert stands.latitude_deg == pytest.approx(latitude_deg, abs=0.001)
    assert stands.height_m == pytest.approx(612.0 + undulation_m, abs=ROUNDED_M + 0.02)


@pytest.mark.parametrize("moved", [(0.0, 0.0, 0.0), (300.0, -400.0, 5.0)])
def test_a_place_off_its_site_is_east_and_north_of_it_by_so_much(
    moved: tuple[float, float, float], tmp_path: Path
) -> None:
    """At its height above the ellipsoid, and not above the horizontal of the site."""
    site = written(tmp_path).scene.site
    place = Location(east_m=2000.0, north_m=700.0, above_site_m=30.0)
    found = geodetic(site, place, moved)
    off_m = site_frame(site).from_ecef(geodetic_to_ecef(*found))
    assert off_m[:2] == pytest.approx([2000.0 + moved[0], 700.0 + moved[1]], abs=0.05)
    assert found[2] == pytest.approx(680.0 + moved[2])


def test_sea_level_is_where_the_scene_states_it_and_else_the_packages_geoid(tmp_path: Path) -> None:
    site = site_at(-35.3, 149.1, "height_msl_m = 577.0")
    scene = written(tmp_path, site, telemetry="geoid_undulation_m = 27.0")
    level = scene.sea_level()
    assert (scene.scene.site.height_m, level.level_m) == (604.0, 27.0)
    assert level.undulation_m([0.0, 90.0], 7.0).tolist() == [27.0, 27.0]
    assert scene.sea_level(stated_m=0.0).level_m == 0.0
    silent = written(tmp_path)
    assert silent.scene.site.height_m == 650.0  # above the ellipsoid, as it stands
    assert silent.sea_level().level_m is None
    assert silent.sea_level().undulation_m(40.45, -3.73) == geoid_undulation_m(40.45, -3.73)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"site": f"{SITE}height_msl_m = 6.0\n"}, "scene.site.height_msl_m: either it or height_m"),
        ({"site": SITE.replace("height_m = 650.0", "")}, "scene.site.height_m: missing"),
        ({"site": ABOVE_SEA.replace("650.0", '"650"')}, "valid number"),
        ({"site": ABOVE_SEA.replace("650.0", "1e5")}, "less than or equal"),
        ({"site": ABOVE_SEA.replace("650.0", "nan")}, "finite number"),
        ({"site": ABOVE_SEA, "telemetry": 'geoid_grid = "here.gtx"'},
         "scene.site.height_msl_m: counts from the package's geoid"),
        ({"telemetry": 'geoid_grid = "here.gtx"\ngeoid_undulation_m = 1.0'},
         "either it or geoid_undulation_m"),
        ({"sensor": "height_msl_m = 600.0\nposition_enu_m = [0.0, 0.0, 5.0]"},
         "sensor[0].height_msl_m of 'radar': gives the third of position_enu_m"),
        ({"drones": f"[[jammer]]\neast_m = 0.0\nnorth_m = 0.0\nheight_msl_m = 5.0\n{NOISE}"},
         "jammer[0]: a place has east_m, north_m and above_site_m, or"),
    ],
)  # fmt: skip
def test_what_is_not_one_height_is_refused_by_its_key(
    changes: dict[str, Any], told: str, tmp_path: Path
) -> None:
    with pytest.raises(SceneError) as refused:
        written(tmp_path, **changes)
    assert told in str(refused.value)


def gtx(path: Path) -> None:
    """Undulations of latitude + longitude / 2, every 10 degrees from 60 south to 60 north."""
    latitudes, longitudes = range(-60, 61, 10), range(-180, 181, 10)
    header = struct.pack(">4d2i", -60, -180, 10, 10, len(latitudes), len(longitudes))
    values = [latitude + longitude / 2 for latitude in latitudes for longitude in longitudes]
    path.write_bytes(header + struct.pack(f">{len(values)}f", *values))


def test_a_grid_of_proj_stands_in_its_place_as_far_as_it_reaches(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    folder = tmp_path / "two words"
    folder.mkdir()
    gtx(folder / "here.gtx")
    level = written(folder, telemetry='geoid_grid = "here.gtx"').sea_level()
    found = level.undulation_m(np.array([20.0, -20.0, 70.0]), np.array([30.0, -30.0, 0.0]))
    np.testing.assert_allclose(found, [35.0, -35.0, geoid_undulation_m(70.0, 0.0)], atol=1e-6)
    assert level.undulation_m(20.0, 30.0) == pytest.approx(35.0, abs=1e-6)


def test_a_grid_that_is_none_is_refused_by_its_path(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    for name in ("absent.gtx", "scene.toml"):
        scene = written(tmp_path, telemetry=f'geoid_grid = "{name}"')
        with pytest.raises(PlotfeedError, match=rf"{name}: telemetry\.geoid_grid: expected"):
            scene.sea_level()
        with pytest.raises(PlotfeedError, match=name):
            report(scene)


def test_without_pyproj_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gtx(tmp_path / "here.gtx")
    scene = written(tmp_path, telemetry='geoid_grid = "here.gtx"')
    monkeypatch.setitem(sys.modules, "pyproj", None)
    with pytest.raises(PlotfeedError, match=r"plotfeed\[geoid\]"):
        scene.sea_level()

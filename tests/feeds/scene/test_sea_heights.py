"""Heights above mean sea level in a scene's file stand above the ellipsoid by the geoid."""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from plotfeed.feeds.cli.check import report
from plotfeed.feeds.scene.fields import Location, frame_at, geodetic, site_frame
from plotfeed.feeds.scene.scene import Scene, SceneError
from plotfeed.models.frames import geodetic_to_ecef, geoid_undulation_m
from plotfeed.proto.errors import PlotfeedError
from plotfeed.testing import flown, radar, scene

NODES = {  # of EGM96, every 15', by the US National Geospatial-Intelligence Agency
    "Canberra": (-35.5, 149.0, 19.167),
    "Madrid": (40.5, -3.5, 51.804),
    "Denver": (39.5, -105.0, -16.449),
    "Tokyo": (35.5, 139.5, 36.993),
    "Delhi": (28.5, 77.0, -52.176),
    "Reykjavik": (64.0, -22.0, 66.312),
}
ROUNDED_M = 0.0501  # Of a node of the package's grid, in whole decimetres
PLACE = {"latitude_deg": 40.45, "longitude_deg": -3.73}
SITE = PLACE | {"height_m": 650.0}
HERE_GTX = {"geoid_grid": "here.gtx"}
NOISE = {"id": "far", "eirp_w": 1.0, "frequency_hz": 9e9, "bandwidth_hz": 1e6}


def placed(
    site: dict[str, Any] = SITE, sensor: dict[str, Any] | None = None, *drones: Any, **tables: Any
) -> Scene:
    general = {"name": "test", "seed": 1, "site": site}
    return scene([radar(**sensor or {})], drones, seed=1, scene=general, **tables)


def at(latitude_deg: float, longitude_deg: float, **height: float) -> dict[str, Any]:
    return {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg, **height}


@pytest.mark.parametrize("name", NODES)
def test_what_is_above_the_sea_stands_so_far_above_the_geoid_where_it_is(name: str) -> None:
    """A site; a waypoint and a sensor 70 km off theirs, whose horizontal is 400 m above them."""
    latitude_deg, longitude_deg, undulation_m = NODES[name]
    site = placed(at(latitude_deg, longitude_deg, height_msl_m=577.0)).scene.site
    assert site.height_m == pytest.approx(577.0 + undulation_m, abs=ROUNDED_M)
    away = at(latitude_deg - 0.5, longitude_deg - 0.5, height_m=100.0)
    ends_msl_m = 700.0, 800.5
    path = [at(latitude_deg, longitude_deg, height_msl_m=msl_m) for msl_m in ends_msl_m]
    there = placed(away, None, flown("visitor", *path))
    ends = [geodetic(there.scene.site, waypoint) for waypoint in there.drone[0].path]
    expected_m = [msl_m + undulation_m for msl_m in ends_msl_m]
    assert [height_m for _, _, height_m in ends] == pytest.approx(expected_m, abs=ROUNDED_M)
    frame = frame_at(there.scene.site, (0.0, 0.0, 0.0))
    east_m, north_m, _ = frame.from_ecef(geodetic_to_ecef(*ends[0])).tolist()
    off = placed(away, {"position_enu_m": [east_m, north_m, 0.0], "height_msl_m": 612.0})
    stands = frame_at(off.scene.site, off.sensor[0].position_enu_m)
    assert stands.latitude_deg == pytest.approx(latitude_deg, abs=0.001)
    assert stands.height_m == pytest.approx(612.0 + undulation_m, abs=ROUNDED_M + 0.02)


@pytest.mark.parametrize("moved", [(0.0, 0.0, 0.0), (300.0, -400.0, 5.0)])
def test_a_place_off_its_site_is_east_and_north_of_it_by_so_much(
    moved: tuple[float, float, float],
) -> None:
    """At its height above the ellipsoid, and not above the horizontal of the site."""
    site = placed().scene.site
    place = Location(east_m=2000.0, north_m=700.0, above_site_m=30.0)
    found = geodetic(site, place, moved)
    off_m = site_frame(site).from_ecef(geodetic_to_ecef(*found))
    assert off_m[:2] == pytest.approx([2000.0 + moved[0], 700.0 + moved[1]], abs=0.05)
    assert found[2] == pytest.approx(680.0 + moved[2])


def test_sea_level_is_where_the_scene_states_it_and_else_the_packages_geoid() -> None:
    stated = placed(at(-35.3, 149.1, height_msl_m=577.0), telemetry={"geoid_undulation_m": 27.0})
    level = stated.sea_level()
    assert (stated.scene.site.height_m, level.level_m) == (604.0, 27.0)
    assert level.undulation_m([0.0, 90.0], 7.0).tolist() == [27.0, 27.0]
    assert stated.sea_level(stated_m=0.0).level_m == 0.0
    silent = placed()
    assert silent.scene.site.height_m == 650.0  # above the ellipsoid, as it stands
    assert silent.sea_level().level_m is None
    assert silent.sea_level().undulation_m(40.45, -3.73) == geoid_undulation_m(40.45, -3.73)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"site": SITE | {"height_msl_m": 6.0}}, "scene.site.height_msl_m: either it or height_m"),
        ({"site": PLACE}, "scene.site.height_m: missing"),
        ({"site": PLACE | {"height_msl_m": "650"}}, "valid number"),
        ({"site": PLACE | {"height_msl_m": 1e5}}, "less than or equal"),
        ({"site": PLACE | {"height_msl_m": float("nan")}}, "finite number"),
        ({"site": PLACE | {"height_msl_m": 650.0}, "telemetry": HERE_GTX},
         "scene.site.height_msl_m: counts from the package's geoid"),
        ({"telemetry": HERE_GTX | {"geoid_undulation_m": 1.0}}, "either it or geoid_undulation_m"),
        ({"sensor": {"height_msl_m": 600.0, "position_enu_m": [0.0, 0.0, 5.0]}},
         "sensor[0].height_msl_m of 'radar': gives the third of position_enu_m"),
        ({"jammer": [NOISE | {"east_m": 0.0, "north_m": 0.0, "height_msl_m": 5.0}]},
         "jammer[0]: a place has east_m, north_m and above_site_m, or"),
    ],
)  # fmt: skip
def test_what_is_not_one_height_is_refused_by_its_key(changes: dict[str, Any], told: str) -> None:
    with pytest.raises(SceneError) as refused:
        placed(**changes)
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
    level = placed(folder=folder, telemetry=HERE_GTX).sea_level()
    found = level.undulation_m(np.array([20.0, -20.0, 70.0]), np.array([30.0, -30.0, 0.0]))
    np.testing.assert_allclose(found, [35.0, -35.0, geoid_undulation_m(70.0, 0.0)], atol=1e-6)
    assert level.undulation_m(20.0, 30.0) == pytest.approx(35.0, abs=1e-6)


def test_a_grid_that_is_none_is_refused_by_its_path(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    (tmp_path / "scene.toml").write_text("[scene]\n")
    for name in ("absent.gtx", "scene.toml"):
        there = placed(folder=tmp_path, telemetry={"geoid_grid": name})
        with pytest.raises(PlotfeedError, match=rf"{name}: telemetry\.geoid_grid: expected"):
            there.sea_level()
        with pytest.raises(PlotfeedError, match=name):
            report(there)


def test_without_pyproj_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gtx(tmp_path / "here.gtx")
    monkeypatch.setitem(sys.modules, "pyproj", None)
    with pytest.raises(PlotfeedError, match=r"plotfeed\[geoid\]"):
        placed(folder=tmp_path, telemetry=HERE_GTX).sea_level()

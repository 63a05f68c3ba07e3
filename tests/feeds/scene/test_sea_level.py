from __future__ import annotations

import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from support.scene_files import scene_file, scene_text

from plotfeed.feeds.cli.check import report
from plotfeed.feeds.scene.scene import Scene, SceneError, load
from plotfeed.models.frames import geoid_undulation_m
from plotfeed.proto.errors import PlotfeedError


def written(folder: Path, telemetry: str) -> Scene:
    return load(scene_file(folder, scene_text(telemetry=telemetry, port=1883)))


def gtx(path: Path) -> None:
    """Undulations of latitude + longitude / 2, every 10 degrees from 60 south to 60 north."""
    latitudes, longitudes = range(-60, 61, 10), range(-180, 181, 10)
    header = struct.pack(">4d2i", -60, -180, 10, 10, len(latitudes), len(longitudes))
    values = [latitude + longitude / 2 for latitude in latitudes for longitude in longitudes]
    path.write_bytes(header + struct.pack(f">{len(values)}f", *values))


def test_a_scene_that_says_nothing_has_the_packages_geoid(tmp_path: Path) -> None:
    level = written(tmp_path, "").sea_level()
    assert level.level_m is None
    assert level.undulation_m(40.45, -3.73) == geoid_undulation_m(40.45, -3.73)


def test_what_a_scene_states_stands_above_it(tmp_path: Path) -> None:
    scene = written(tmp_path, "geoid_undulation_m = 50.0")
    level = scene.sea_level()
    assert level.level_m == 50.0
    assert level.undulation_m([0.0, 90.0], 7.0).tolist() == [50.0, 50.0]
    assert scene.sea_level(stated_m=0.0).level_m == 0.0


def test_a_grid_of_proj_stands_in_its_place_as_far_as_it_reaches(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    folder = tmp_path / "two words"
    folder.mkdir()
    gtx(folder / "here.gtx")
    level = written(folder, 'geoid_grid = "here.gtx"').sea_level()
    found = level.undulation_m(np.array([20.0, -20.0, 70.0]), np.array([30.0, -30.0, 0.0]))
    np.testing.assert_allclose(found, [35.0, -35.0, geoid_undulation_m(70.0, 0.0)], atol=1e-6)
    assert level.undulation_m(20.0, 30.0) == pytest.approx(35.0, abs=1e-6)


def test_a_grid_that_is_none_is_refused_by_its_path(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    for name in ("absent.gtx", "scene.toml"):
        scene = written(tmp_path, f'geoid_grid = "{name}"')
        with pytest.raises(PlotfeedError, match=rf"{name}: telemetry\.geoid_grid: expected"):
            scene.sea_level()
        with pytest.raises(PlotfeedError, match=name):
            report(scene)


def test_without_pyproj_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gtx(tmp_path / "here.gtx")
    scene = written(tmp_path, 'geoid_grid = "here.gtx"')
    monkeypatch.setitem(sys.modules, "pyproj", None)
    with pytest.raises(PlotfeedError, match=r"plotfeed\[geoid\]"):
        scene.sea_level()


def test_one_key_says_where_sea_level_is(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="either it or geoid_undulation_m"):
        written(tmp_path, 'geoid_grid = "here.gtx"\ngeoid_undulation_m = 1.0')

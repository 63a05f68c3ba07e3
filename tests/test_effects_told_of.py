"""Each effect that a scene may name is told of wherever a user would look for it, and measured."""

from __future__ import annotations

import json
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from support.command import plotfeed_here
from support.hills import write_ridge
from support.random_scenes import optional_tables
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import SENSORS
from plotfeed.feeds.scene.sensors.effect_keys import EFFECTS
from plotfeed.feeds.testing.built_scene import toml_of

ROOT = Path(__file__).parents[1]
# Tables that say how a sensor reports, turns, or is made.
NO_EFFECTS = {"link", "tracks", "mount", "cooperative", "page", "telemetry", "classifier", "layout"}


def keys() -> list[str]:
    found = {"jamming"}.union(*map(optional_tables, (*SENSORS.values(), Scene)))
    return sorted(found - NO_EFFECTS)


@cache
def rows() -> dict[str, dict[str, Any]]:
    """Effects by what the benchmark calls them, each with its keys."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "tools" / "benchmarks")
        found: dict[str, dict[str, Any]] = import_module("bench_effects").EFFECTS
    return found


def measured() -> set[str]:
    return {key for row in rows().values() for key in row}


def test_effects_are_in_the_limits_the_equations_and_the_benchmark() -> None:
    docs = ROOT / "docs"
    limits, equations = ((docs / f"{page}.md").read_text() for page in ("limits", "equations"))
    assert {"bias", "doppler", "terrain", "weather"} <= set(keys()) <= measured()
    for key in keys():
        assert f"`{key}`" in limits
        assert f"`{key}`" in equations or f"`[{key}]`" in equations


def test_check_tells_of_scenes_that_name_every_effect(tmp_path: Path) -> None:
    """A radar for each effect of a sensor, with all that a scene names and spells of weather."""
    write_ridge(tmp_path, height_m=700)
    place = "east_m = 3000.0\nnorth_m = 0.0\nabove_site_m = 50.0\n"
    path = [{"east_m": e, "north_m": 0.0, "above_site_m": 80.0} for e in (2000.0, 4000.0)]
    of_scene: dict[str, Any] = {"birds": [{"id": "gulls", "count": 3, "path": path}]}
    sensors = ""
    for n, named in enumerate(rows().values()):
        scenes_own = {key: table for key, table in named.items() if key in Scene.model_fields}
        of_scene |= {k: t for k, t in scenes_own.items() if k not in {"birds", "weather"}}
        own = {key: table for key, table in named.items() if key in {*keys(), "decorrelation_s"}}
        own = {
            key: table for key, table in own.items() if key not in scenes_own or key == "weather"
        }
        sensors += radar(f"radar-{n}", more=toml_of(own))
    weather = "[[weather]]\nfrom_s = 10.0\nto_s = 20.0\nrain_mm_h = 25.0\n"
    jammer = f"[[jammer]]\nid = 'far'\nfrom_s = 5.0\neirp_w = 1.0\n{place}"
    jammer += "frequency_hz = 10e9\nbandwidth_hz = 1e8\n"
    text = toml_of(of_scene) + scene_text(sensors=sensors) + weather + jammer
    scene = scene_file(tmp_path, text)
    found = json.loads(plotfeed_here("check", scene, "--json").stdout)
    told = set().union(*(sensor["effects"] for sensor in found["sensors"]))
    assert told >= EFFECTS & measured()
    for sensor in found["sensors"]:
        assert [event["set"].keys() for event in sensor["events"]] == [{"weather"}, {"jamming"}]
    lines = plotfeed_here("check", scene).stdout
    assert "  from 10 s to 20 s, not in this table: weather (rain_mm_h 25)" in lines
    assert "  from 5 s on, not in this table: jamming (far (" in lines

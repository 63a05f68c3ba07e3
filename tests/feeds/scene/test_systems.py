"""A table of a scene that stands for the sensors of a commercial system."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from plotfeed.feeds.cli.main import cli
from plotfeed.feeds.scene.presets.preset import preset, system_names
from plotfeed.feeds.scene.presets.system import system
from plotfeed.feeds.scene.scene import Scene, SceneError, parsed
from plotfeed.testing import fly, held
from plotfeed.testing import scene as built


def scene(*systems: dict[str, Any], **tables: Any) -> Scene:
    return built([], seed=1, system=list(systems), **tables)


def problems(*systems: dict[str, Any], **rest: Any) -> list[tuple[str, str]]:
    with pytest.raises(SceneError) as caught:
        scene(*systems, **rest)
    return caught.value.problems


@pytest.mark.parametrize("name", system_names())
def test_a_system_alone_makes_its_sensors(name: str) -> None:
    found = scene({"id": "gate", "preset": name, "position_enu_m": [10.0, 20.0, 3.0]})
    expected = {f"gate-{of}": member.preset for of, member in system(name).members.items()}
    assert {s.id: s.preset for s in found.sensor} == expected
    assert {s.position_enu_m for s in found.sensor} == {(10.0, 20.0, 3.0)}
    assert all(s.type == preset(str(s.preset)).type for s in found.sensor)


def test_sensors_of_a_system_come_behind_those_of_the_scene_and_report() -> None:
    lone = {"id": "radar", "preset": "doruk"}
    found = scene(
        {"id": "gate", "preset": "dronesentry", "without": ["camera"]},
        sensor=[lone],
        drone=[held("d", 10.0, 20.0, 150.0, rcs_m2=1.0, sound_power_db=110.0)],
    )
    assert [s.id for s in found.sensor] == ["radar", "gate-radar", "gate-rf", "gate-audio"]
    road = fly(found, 3.0)
    assert len(road.plots("gate-radar"))
    assert len(road.plots("gate-audio"))


def test_keys_of_one_sensor_go_before_those_of_all_and_these_before_the_presets() -> None:
    every, radar = {"pfa": 1e-5, "link": {"latency_ms": 50.0}}, {"pfa": 1e-4, "range_max_m": 900.0}
    found = scene(
        {"id": "g", "preset": "dronesentry", "without": ["rf", "camera"], "every": every,
         "radar": radar, "audio": {"position_enu_m": [1.0, 2.0, 3.0]}}
    )  # fmt: skip
    mine, audio = found.sensor
    assert (mine.pfa, mine.range_max_m, audio.pfa) == (1e-4, 900.0, 1e-5)
    assert mine.link is not None
    assert mine.link.latency_ms == 50.0
    assert audio.position_enu_m == (1.0, 2.0, 3.0)


def test_a_member_may_be_another_product() -> None:
    keys = {"id": "g", "preset": "dronetracker", "radar": {"preset": "ranger-r8ss-3d"}}
    assert scene(keys).sensor[0].preset == "ranger-r8ss-3d"


def test_a_system_that_faces_east_looks_east() -> None:
    keys = {"id": "g", "preset": "dronesentry"}
    north, east = scene(keys), scene({**keys, "facing_deg": 90.0})
    for before, after in zip(north.sensor, east.sensor, strict=True):
        if before.type == "active_radar":
            assert (after.azimuth_min_deg, after.azimuth_max_deg) == (45.0, 135.0)
        if before.type == "camera":
            assert (before.pan_deg, after.pan_deg) == (0.0, 90.0)
        if before.type == "rf":
            assert after.azimuth_min_deg == before.azimuth_min_deg == -180.0


@pytest.mark.parametrize("name", system_names())
def test_the_radar_of_a_system_cues_its_camera(name: str) -> None:
    keys = {"id": "gate", "preset": name}
    for without, cuers in (((), ("gate-radar",)), (("radar",), ())):
        found = scene({**keys, "without": list(without)})
        camera = next(sensor for sensor in found.sensor if sensor.id == "gate-camera")
        assert camera.mount.cuers == cuers
        assert camera.mount.pan_rate_deg_s >= 60.0
    own = {**keys, "camera": {"mount": {"cued_by": []}}}
    camera = next(sensor for sensor in scene(own).sensor if sensor.id == "gate-camera")
    assert camera.mount.cuers == ()


def test_two_systems_are_numbered_apart() -> None:
    found = scene({"id": "a", "preset": "arms"}, {"id": "b", "preset": "arms"})
    assert len({(s.sac, s.sic) for s in found.sensor}) == len(found.sensor) == 4


GATE = {"id": "gate", "preset": "dronesentry"}
WRONG = [
    ({**GATE, "preset": "dronesentri"}, "system[0].preset",
     "no such system as 'dronesentri'; did you mean dronesentry?"),
    ({**GATE, "preset": "echodyne"}, "system[0].preset",
     "echodyne is one sensor: write [[sensor]]"),
    ({**GATE, "without": ["jammer"]}, "system[0].without[0]",
     "dronesentry has radar, rf, audio, camera; not 'jammer'"),
    ({**GATE, "detector": {}}, "system[0].detector", "dronesentry has radar, rf, audio, camera"),
    ({**GATE, "radar": {"id": "x"}}, "system[0].radar.id", "is the system's to say"),
    ({**GATE, "radar": {"powr_w": 1.0}}, "system[0].radar.powr_w",
     "no such key; did you mean power_w?"),
    ({**GATE, "camera": {"preset": "axis"}}, "system[0].camera.preset",
     "no such preset as 'axis'; did you mean axis-q6215-le?"),
    ({**GATE, "radar": {"pfa": 3.0}}, "system[0].radar.pfa", None),
    ({"id": "gate"}, "system[0].preset", "missing"),
]  # fmt: skip


@pytest.mark.parametrize(("table", "key", "text"), WRONG, ids=lambda x: str(x)[-24:])
def test_what_is_wrong_is_told_by_the_system(
    table: dict[str, Any], key: str, text: str | None
) -> None:
    found = problems(table, sensor=[{"id": "radar", "preset": "doruk"}])
    assert [where for where, _ in found] == [key]
    assert text is None or found[0][1] == text


def test_a_problem_names_line_and_system() -> None:
    found = problems(sensor=[{"id": "a", "preset": "dronesentry"}])
    says = "dronesentry is a system of several sensors: write [[system]]"
    assert found == [("sensor[0].preset", says)]
    text = """
[scene]
name = "s"
seed = 1
site = { latitude_deg = 1.0, longitude_deg = 1.0, height_m = 1.0 }
[[system]]
id = "gate"
preset = "arms"
[system.radar]
pfa = 7.0
"""
    with pytest.raises(SceneError) as caught:
        parsed(text.encode(), Path("s.toml"))
    assert str(caught.value).startswith("s.toml: line 10: system[0].radar.pfa of 'gate': ")


def test_the_command_knows_systems() -> None:
    listed = CliRunner().invoke(cli, ["sensors"])
    assert "dronesentry" in listed.output
    one = CliRunner().invoke(cli, ["sensors", "dronesentry"])
    assert "gate" not in one.output
    assert "droneopt" in one.output
    told = json.loads(CliRunner().invoke(cli, ["sensors", "xpeller", "--json"]).output)
    assert told["type"] == "system"
    assert told["sensors"]["radar"]["preset"] == "spexer-2000-3d-mkiii"

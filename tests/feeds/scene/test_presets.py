"""Presets of sensors and of systems of them in scenes, and the command that lists them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NoReturn

import pytest
from click.testing import CliRunner
from support.scene_files import scene_text

from plotfeed.feeds.cli.main import cli
from plotfeed.feeds.scene.presets.preset import (
    PresetRule,
    PresetTarget,
    UnknownPresetError,
    derive,
    names,
    preset,
    system_names,
)
from plotfeed.feeds.scene.presets.system import system
from plotfeed.feeds.scene.scene import Scene, SceneError, from_tree, parsed
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.proto.errors import PlotfeedError
from plotfeed.testing import fly, held, scene

DORUK = {"id": "radar", "preset": "doruk"}
GATE = {"id": "gate", "preset": "dronesentry"}
EVERY_SYSTEM = pytest.mark.parametrize("name", system_names())


def made(*systems: dict[str, Any], sensor: Any = (), **tables: Any) -> Scene:
    return scene(sensor, seed=1, system=list(systems), **tables)


def named(found: Scene, name: str) -> Any:
    (one,) = (sensor for sensor in found.sensor if sensor.id == name)
    return one


def of(**keys: Any) -> Sensor:
    (found,) = made(sensor=[{"id": "a"} | keys]).sensor
    return found


def run(*arguments: str) -> str:
    return CliRunner().invoke(cli, ["sensors", *arguments], catch_exceptions=False).output


def in_json(*arguments: str) -> Any:
    def refuse(constant: str) -> NoReturn:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(run(*arguments, "--json"), parse_constant=refuse)


def test_each_preset_alone_makes_a_sensor_and_is_numbered() -> None:
    tables = [{"id": f"p{i}", "preset": name} for i, name in enumerate(names())]
    before = [dict(table) for table in tables]
    for i, (name, found) in enumerate(zip(names(), made(sensor=tables).sensor, strict=True)):
        own = {"id": f"p{i}", "preset": name, "sic": i + 1}
        assert found.model_dump() == preset(name).sensor.model_dump() | own
    assert tables == before  # what a scene came from is left as it was


def test_keys_of_the_scene_go_first_and_what_was_solved_for_stays() -> None:
    """So that an overridden key has its effect; a scan is replaced as a whole."""
    plain = of(preset="echodyne")
    scan = {"kind": "rotating", "period_s": 2.0}
    found = of(preset="echodyne", pfa=1e-5, sic=9, noise_figure_db=15.0, scan=scan)
    assert (found.pfa, found.sic, found.noise_figure_db) == (1e-5, 9, 15.0)
    assert (found.scan.kind, found.scan.period_s) == ("rotating", 2.0)
    assert (found.azimuth_beamwidth_deg, found.power_w) == (2.0, plain.power_w)
    assert of(preset="doruk", type="active_radar").type == "active_radar"


@EVERY_SYSTEM
def test_a_system_alone_makes_its_sensors_whose_radar_cues_its_camera(name: str) -> None:
    keys = {"id": "gate", "preset": name}
    found = made({**keys, "position_enu_m": [10.0, 20.0, 3.0]})
    expected = {f"gate-{of}": member.preset for of, member in system(name).members.items()}
    assert {s.id: s.preset for s in found.sensor} == expected
    assert {s.position_enu_m for s in found.sensor} == {(10.0, 20.0, 3.0)}
    assert all(s.type == preset(str(s.preset)).type for s in found.sensor)
    for changes, cuers in (
        ({}, ("gate-radar",)),
        ({"without": ["radar"]}, ()),
        ({"camera": {"mount": {"cued_by": []}}}, ()),
    ):
        mount = named(made({**keys, **changes}), "gate-camera").mount
        assert mount.cuers == cuers
        assert mount.pan_rate_deg_s >= 60.0


def test_sensors_of_a_system_come_behind_those_of_the_scene_and_report() -> None:
    found = made(
        GATE | {"without": ["camera"]},
        sensor=[DORUK],
        drone=[held("d", 10.0, 20.0, 150.0, rcs_m2=1.0, sound_power_db=110.0)],
    )
    assert [s.id for s in found.sensor] == ["radar", "gate-radar", "gate-rf", "gate-audio"]
    road = fly(found, 3.0)
    assert len(road.plots("gate-radar"))
    assert len(road.plots("gate-audio"))


def test_keys_of_one_sensor_go_before_those_of_all_and_these_before_the_presets() -> None:
    every, radar = {"pfa": 1e-5, "link": {"latency_ms": 50.0}}, {"pfa": 1e-4, "range_max_m": 900.0}
    own = {"radar": radar, "audio": {"position_enu_m": [1.0, 2.0, 3.0]}}
    mine, audio = made(GATE | {"without": ["rf", "camera"], "every": every} | own).sensor
    assert (mine.pfa, mine.range_max_m, audio.pfa) == (1e-4, 900.0, 1e-5)
    assert mine.link is not None
    assert mine.link.latency_ms == 50.0
    assert audio.position_enu_m == (1.0, 2.0, 3.0)
    other = made(GATE | {"preset": "dronetracker", "radar": {"preset": "ranger-r8ss-3d"}})
    assert other.sensor[0].preset == "ranger-r8ss-3d"


def test_a_system_that_faces_east_looks_east() -> None:
    north, east = made(GATE), made(GATE | {"facing_deg": 90.0})
    sectors = named(east, "gate-radar"), named(north, "gate-rf"), named(east, "gate-rf")
    assert [s.azimuth_min_deg for s in sectors] == [45.0, -180.0, -180.0]
    assert sectors[0].azimuth_max_deg == 135.0
    assert [named(found, "gate-camera").pan_deg for found in (north, east)] == [0.0, 90.0]


def test_two_systems_are_numbered_apart() -> None:
    found = made({"id": "a", "preset": "arms"}, {"id": "b", "preset": "arms"})
    assert len({(s.sac, s.sic) for s in found.sensor}) == len(found.sensor) == 4


NO_NAME = "write the name of a preset, in quotes"
# Keys of a sensor whose preset is doruk, the key that is named, and what is said of it.
WRONG_SENSORS: list[tuple[dict[str, Any], str, str]] = [
    ({"type": "rf"}, "type", "the preset doruk is of type active_radar, not rf"),
    ({"scan": {"kind": "rotating"}}, "scan.period_s", "missing"),
    ({"preset": "dronesentry"}, "preset",
     "dronesentry is a system of several sensors: write [[system]]"),
    *(({"preset": wrong}, "preset", f"no such preset as {wrong!r}; {hint}") for wrong, hint in (
        ("echodine", "did you mean echodyne?"),
        ("Echodyne", "did you mean echodyne?"),
        ("ranger", "did you mean ranger-r8ss-3d?"),
        ("mkiii", "did you mean spexer-2000-3d-mkiii?"),
        ("rf-16", "did you mean dedrone-rf-160?"),
        ("zzz", "`plotfeed sensors` lists them"),
        ("", "`plotfeed sensors` lists them"),
        ("../doruk", "did you mean doruk?"),
    )),
    *(({"preset": wrong}, "preset", NO_NAME) for wrong in (7, True, [], {}, ["doruk"])),
]  # fmt: skip
# The same of a system whose preset is dronesentry.
WRONG_SYSTEMS: list[tuple[dict[str, Any], str, str]] = [
    ({"preset": "dronesentri"}, "preset",
     "no such system as 'dronesentri'; did you mean dronesentry?"),
    ({"preset": "echodyne"}, "preset", "echodyne is one sensor: write [[sensor]]"),
    ({"without": ["jammer"]}, "without[0]",
     "dronesentry has radar, rf, audio, camera; not 'jammer'"),
    ({"detector": {}}, "detector", "dronesentry has radar, rf, audio, camera"),
    ({"radar": {"id": "x"}}, "radar.id", "is the system's to say"),
    ({"radar": {"powr_w": 1.0}}, "radar.powr_w", "no such key; did you mean power_w?"),
    ({"camera": {"preset": "axis"}}, "camera.preset",
     "no such preset as 'axis'; did you mean axis-q6215-le?"),
    ({"radar": {"pfa": 3.0}}, "radar.pfa",
     "input should be less than or equal to 0.1, not 3.0"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("tables", "key", "says"),
    [
        *(({"sensor": [DORUK | keys]}, f"sensor[0].{key}", s) for keys, key, s in WRONG_SENSORS),
        *(
            ({"sensor": [DORUK], "system": [GATE | keys]}, f"system[0].{key}", says)
            for keys, key, says in WRONG_SYSTEMS
        ),
        ({"sensor": [DORUK], "system": [{"id": "gate"}]}, "system[0].preset", "missing"),
    ],
)
def test_what_is_wrong_is_one_problem_of_the_scenes_own_key(
    tables: dict[str, Any], key: str, says: str
) -> None:
    with pytest.raises(SceneError) as caught:
        made(*tables.get("system", ()), sensor=tables.get("sensor", ()))
    assert caught.value.problems == [(key, says)]


def test_a_wrong_name_is_told_in_a_short_line_and_no_problem_is_lost() -> None:
    with pytest.raises(SceneError) as caught:
        of(preset="x" * 100_000)
    assert len(str(caught.value)) < 300
    with pytest.raises(SceneError) as caught:
        made(
            sensor=[
                {"id": "a", "preset": "doruk", "pfa": 0.9},
                {"id": "b", "preset": "nothing-like-it"},
                {"id": "c", "preset": "rfone", "powr_w": 1.0},
                {"id": "d", "preset": "widealert", "scan": {"kind": "staring", "period_s": -1.0}},
            ]
        )
    keys = ("[0].pfa", "[1].preset", "[2].powr_w", "[3].scan.period_s")
    assert sorted(key for key, _ in caught.value.problems) == [f"sensor{key}" for key in keys]
    text = scene_text(sensors='[[system]]\nid = "gate"\npreset = "arms"\n[system.radar]\npfa = 7.0')
    at = text.split("\n").index("pfa = 7.0") + 1
    with pytest.raises(SceneError, match=rf"line {at}: system\[0\]\.radar\.pfa of 'gate': "):
        parsed(text.encode(), Path("s.toml"))


@pytest.mark.parametrize("wrong", [[], [1], {}, "x", [None]])
def test_sensors_that_are_no_tables_are_told_as_without_presets(wrong: object) -> None:
    general = scene([DORUK], seed=1).scene.model_dump(include={"name", "seed", "site"})
    with pytest.raises(SceneError):
        from_tree({"scene": general, "sensor": wrong}, Path("test.toml"))


def test_a_rule_that_nothing_meets_says_so() -> None:
    given = preset("doruk").keys | {"range_floor_m": 9.0}
    given = {key: value for key, value in given.items() if key not in {"type", "power_w"}}
    rule = PresetRule.model_validate({"note": "x", "solve": {"sigma_range_m": 1.0}})
    target = PresetTarget(range_m=6000.0, rcs_m2=0.01, note="x")
    with pytest.raises(PlotfeedError, match="power_w: no value gives sigma_range_m 1"):
        derive("active_radar", given, {"power_w": rule}, target)


@pytest.mark.parametrize("beams", [1, 2, 9])
def test_beams_side_by_side_lengthen_the_time_on_target(beams: int) -> None:
    """A turn of 3 s, a beam of 4 degrees: 1/30 s a beam, of which a share is integrated."""
    given = {"azimuth_beamwidth_deg": 4.0, "scan": {"kind": "rotating", "period_s": 3.0}}
    if beams > 1:  # 1 is the default
        given["receive_beams"] = beams
    rule = PresetRule.model_validate({"note": "x", "share_of_time_on_target": 0.75})
    target = PresetTarget(range_m=1000.0, rcs_m2=1.0, note="x")
    found = derive("active_radar", given, {"integration_s": rule}, target)
    assert found["integration_s"] == pytest.approx(0.75 * beams / 30, rel=1e-15)


def test_the_list_names_them_all_and_says_what_they_are() -> None:
    text, found = run(), in_json()
    assert all(f"\n{name} " in text for name in (*names(), *system_names()))
    for words in ("not measurements of the products", "2.10 km", "table 5 of the paper"):
        assert words in text
    assert [each["name"] for each in found] == [*names(), *system_names()]
    for each in found[: len(names())]:
        quoted_m = preset(each["name"]).target.range_m
        assert each["range_at_pd_80_percent_m"] == pytest.approx(quoted_m, rel=0.002)
        assert {"title", "maker", "type", "source", "target"} <= set(each)


def test_one_preset_shows_keys_marks_notes_and_the_table() -> None:
    text = run("ranger-r8ss-3d")
    for expected in (
        'stated   "Instrumented range: 7800 m"',
        "derived  such that pd = 0.8 at the quoted range.",
        "assumed  The default.",
        "For 0.001 m2: Pd 0.8 to 1.18 km, quoted 1.20 km.",
        "Stated and not modelled:",
        "range km   SNR dB      Pd",
        "not measurements of the products",
    ):
        assert expected in text
    for name in ("ranger-r8ss-3d", "rfone", "widealert", "triton-pt"):
        found = in_json(name)
        assert (found["name"], len(found["table"])) == (name, 10)
        assert {key["mark"] for key in found["keys"]} <= {"stated", "derived", "assumed"}


def test_the_command_knows_systems_and_refuses_other_names() -> None:
    told = in_json("xpeller")
    assert (told["type"], told["sensors"]["radar"]["preset"]) == ("system", "spexer-2000-3d-mkiii")
    assert "gate" not in run("dronesentry")
    assert "droneopt" in run("dronesentry")
    with pytest.raises(UnknownPresetError, match=r"did you mean doruk\?") as caught:
        CliRunner().invoke(cli, ["sensors", "dorak"], standalone_mode=False, catch_exceptions=False)
    assert caught.value.exit_code == 2

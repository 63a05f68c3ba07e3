"""Presets of sensors and of systems of them in scenes, and the command that lists them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
from click.testing import CliRunner
from support.scene_files import scene_text

from plotfeed.feeds.cli.main import cli
from plotfeed.feeds.cli.show_sensors import reach_m
from plotfeed.feeds.scene.presets.preset import (
    SCENE_ONLY,
    SITE,
    Preset,
    PresetRule,
    PresetTarget,
    UnknownPresetError,
    derive,
    names,
    predicted,
    preset,
    system_names,
)
from plotfeed.feeds.scene.presets.system import system
from plotfeed.feeds.scene.scene import Scene, SceneError, from_tree, parsed
from plotfeed.feeds.scene.sensors import Sensor, sensor_of
from plotfeed.models.propagation import C_M_S
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


# Each preset holds what its source states, and meets the rules that it names.

# By name the kind of sensor, the table of the paper (None: its text), and the range quoted there.
PRESETS: dict[str, tuple[str, int | None, int]] = {
    "aeroscope-portable": ("rf", None, 5000),
    "aeroscope-stationary": ("rf", None, 50_000),
    "art-midrange-3d": ("active_radar", 1, 5000),
    "axis-q6215-le": ("camera", 9, 1000),
    "dedrone-rf-160": ("rf", 7, 5000),
    "dedrone-rf-360": ("rf", 7, 5000),
    "doruk": ("active_radar", 6, 6000),
    "droneopt": ("camera", 13, 600),
    "dronesentry-x": ("rf", None, 2000),
    "dronetracker-audio": ("acoustic", 8, 80),
    "echodyne": ("active_radar", 4, 2500),
    "indra-arms": ("active_radar", 2, 2000),
    "indra-arms-optronic": ("camera", 11, 2000),
    "radarzero": ("active_radar", 13, 1500),
    "ranger-r8ss-3d": ("active_radar", 5, 2100),
    "rfone": ("rf", 13, 5000),
    "spexer-2000-3d-mkii": ("active_radar", 3, 6000),
    "spexer-2000-3d-mkiii": ("active_radar", 3, 6000),
    "spynel-c1000": ("camera", 12, 400),
    "spynel-s2000": ("camera", 12, 400),
    "spynel-x3500": ("camera", 12, 400),
    "triton-pt": ("camera", 10, 4000),
    "widealert": ("acoustic", 13, 200),
}
# What is derived lies between these.
REASON = {"power_w": (0.1, 1000), "loss_db": (0, 30), "sensitivity_db": (10, 50)}

EVERY_PRESET = pytest.mark.parametrize("name", names())


def pd_at(sensor: Sensor, target: PresetTarget, **changes: float) -> float:
    return predicted(sensor, target.model_copy(update=changes), "pd")


def test_every_system_of_the_papers_tables_is_a_preset() -> None:
    assert names() == list(PRESETS)
    assert system_names() == ["arms", "dronesentry", "dronetracker", "xpeller"]
    brought = {m.preset for name in system_names() for m in system(name).members.values()}
    assert brought <= set(names())


@EVERY_PRESET
def test_a_preset_is_as_its_table_says_and_sees_as_far_as_is_quoted(name: str) -> None:
    shown, (kind, table, range_m) = preset(name), PRESETS[name]
    assert (shown.type, shown.target.range_m) == (kind, range_m)
    assert table is None or str(table) in shown.source
    alarms = shown.sensor.model(SITE).false_alarms_per_scan
    if shown.sensor.scan.kind == "electronic":
        assert alarms == 0  # none is confirmed
    else:
        assert 0 < alarms < 10
    assert pd_at(shown.sensor, shown.target) == pytest.approx(0.8, abs=1e-6)
    assert pd_at(shown.sensor, shown.target, range_m=range_m * 1.1) < 0.75
    assert pd_at(shown.sensor, shown.target, range_m=range_m / 1.1) > 0.84
    # A receiver gets no warning, and a radar only that of the format.
    assert all(text.startswith("asterix-048 counts range") for text in shown.sensor.warnings(SITE))
    for key, (low, high) in REASON.items():
        assert key not in shown.keys or low < shown.keys[key] < high


@EVERY_PRESET
def test_every_rule_that_is_solved_is_met_by_the_whole_sensor(name: str) -> None:
    shown = preset(name)
    solved = [rule for rule in shown.derived.values() if rule.solve is not None]
    assert "pd" in [quantity for rule in solved for quantity in rule.solve or ()]
    for rule in solved:
        meant = shown.target if rule.other_target is None else shown.other_target[rule.other_target]
        for quantity, wanted in (rule.solve or {}).items():
            reached = predicted(shown.sensor, meant, quantity)
            assert reached == pytest.approx(wanted, rel=1e-6)


@EVERY_PRESET
def test_every_key_has_one_mark_and_a_reason(name: str) -> None:
    shown = preset(name)
    marked = {entry.key: entry for entry in shown.marked_keys()}
    assert set(marked) == set(type(shown.sensor).model_fields) - SCENE_ONLY
    assert set(shown.keys) - {"type"} <= set(marked)
    for key, entry in marked.items():
        assert entry.note
        assert bool(entry.rule) == (entry.mark == "derived")
        in_sensor = shown.sensor.model_dump()[key]
        if not isinstance(in_sensor, dict):
            assert entry.value == in_sensor or entry.value == list(in_sensor)


@pytest.mark.parametrize(
    ("name", "range_m", "within"),
    [
        ("spexer-2000-3d-mkii", 9000, 0.01),  # by the fourth root of its size
        ("spexer-2000-3d-mkiii", 9000, 0.01),
        ("ranger-r8ss-3d", 1200, 0.02),  # a decade of size less, and one more
        ("ranger-r8ss-3d", 4000, 0.07),
        ("dronetracker-audio", 500, 0.1),  # of a hundred times the sound
        *((name, None, 0.05) for name in ("axis-q6215-le", "droneopt", "triton-pt")),
    ],
)
def test_other_targets_are_seen_as_far_as_is_quoted(
    name: str, range_m: int | None, within: float
) -> None:
    others = preset(name).other_target
    (other,) = (each for each in others if range_m in (None, each.range_m))
    assert reach_m(preset(name), other) == pytest.approx(other.range_m, rel=within)
    if name == "dronetracker-audio":
        assert other.sound_power_db == 100


@pytest.mark.parametrize(
    ("name", "changes", "range_m"),
    [
        # Interference over the usual 6 dB brings Dedrone down to the shorter quoted range.
        ("dedrone-rf-160", {"noise_figure_db": 6.0 + 9.9}, 1600),
        ("dedrone-rf-360", {"noise_figure_db": 6.0 + 7.96}, 2000),
        ("rfone", {"path_loss": {"kind": "log-distance", "exponent": 2.466}}, 1000),  # in a town
    ],
)
def test_what_disturbs_a_receiver_brings_it_down_to_its_shorter_range(
    name: str, changes: dict[str, Any], range_m: float
) -> None:
    disturbed = sensor_of(preset(name).keys | {"id": "here"} | changes)
    assert pd_at(disturbed, preset(name).target, range_m=range_m) == pytest.approx(0.8, abs=0.01)


# By name what the tables of the paper, and section 2.3, state of a sensor; errors (`sigma_`) are
# those at the quoted range.
STATED = {
    "art-midrange-3d": {
        "range_max_m": 5000, "range_resolution_m": 1, "scan.period_s": 1,
        "azimuth_span_deg": 360, "elevation_span_deg": 10, "sigma_range_m": 0.25,
    },
    "indra-arms": {"scan.period_s": 1, "azimuth_span_deg": 360},
    "spexer-2000-3d-mkii": {"azimuth_span_deg": 120, "elevation_span_deg": 15},
    "spexer-2000-3d-mkiii": {"azimuth_span_deg": 360, "elevation_span_deg": 90},
    "echodyne": {
        "azimuth_span_deg": 120, "elevation_span_deg": 80, "scan.period_s": 0.1,
        "scan.revisit_s": 0.1, "scan.max_tracks": 20, "frequency_hz": 24.15e9,
        "azimuth_beamwidth_deg": 2, "elevation_beamwidth_deg": 6,
        "range_resolution_m": C_M_S / (2 * 200e6),
    },
    "ranger-r8ss-3d": {
        "range_max_m": 7800, "range_min_m": 10, "scan.period_s": 0.5,
        "azimuth_span_deg": 90, "elevation_span_deg": 40,
        "sigma_range_m": 3, "sigma_azimuth_deg": 0.8, "sigma_elevation_deg": 3,
    },
    "doruk": {
        "scan.period_s": 4, "azimuth_span_deg": 360, "range_resolution_m": 15,
        "elevation_beamwidth_deg": 20, "azimuth_beamwidth_deg": 2, "measures_elevation": False,
        "sigma_range_m": 5, "sigma_azimuth_deg": 1,
    },
    "aeroscope-stationary": {"range_max_m": 50_000, "azimuth_span_deg": 360},
    "aeroscope-portable": {"range_max_m": 5000, "azimuth_span_deg": 360},
    "dedrone-rf-160": {"classifies": True, "measures_azimuth": False},
    "dedrone-rf-360": {"classifies": True, "measures_azimuth": True},
    "dronetracker-audio": {"range_max_m": 500, "azimuth_span_deg": 90},
    "radarzero": {
        "azimuth_span_deg": 90, "elevation_span_deg": 80, "frequency_hz": 24.55e9,
        "azimuth_beamwidth_deg": 2, "elevation_beamwidth_deg": 6,
    },
}  # fmt: skip


@pytest.mark.parametrize("name", STATED)
def test_stated_figures_are_those_of_the_sensor(name: str) -> None:
    keys, stated = preset(name).sensor.model_dump(), STATED[name]
    errors = [key for key in stated if key.startswith("sigma_")]
    keys |= {key: predicted(preset(name).sensor, preset(name).target, key) for key in errors}
    keys |= {f"scan.{key}": value for key, value in keys["scan"].items()}
    for span in ("azimuth", "elevation"):
        if f"{span}_min_deg" in keys:
            keys[f"{span}_span_deg"] = keys[f"{span}_max_deg"] - keys[f"{span}_min_deg"]
    assert {key: keys[key] for key in stated} == pytest.approx(stated)


@pytest.mark.parametrize(
    ("name", "mrad"), [("spynel-c1000", 0.855), ("spynel-s2000", 0.560), ("spynel-x3500", 0.270)]
)
def test_pixels_of_panoramas_are_square(name: str, mrad: float) -> None:
    keys = preset(name).keys
    assert np.radians(360 / keys["pixels_across"]) * 1e3 == pytest.approx(mrad, rel=0.01)
    assert np.radians(20 / keys["pixels_down"]) * 1e3 == pytest.approx(mrad, rel=0.01)


@pytest.mark.parametrize(
    ("keys", "marks", "why"),
    [
        ("pfa", ("stated", "assumed"), "pfa has two marks"),
        ("id", ("assumed",), "id is for the scene to say"),
    ],
)
def test_a_key_has_one_mark_and_is_not_the_scenes(
    keys: str, marks: tuple[str, ...], why: str
) -> None:
    marked = {mark: {keys: {"value": 1.0, "note": "x"}} for mark in marks}
    with pytest.raises(ValueError, match=why):
        Preset.model_validate(preset("doruk").model_dump() | marked)

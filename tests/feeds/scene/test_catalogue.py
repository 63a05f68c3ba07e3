"""Each preset of the catalogue holds what its source states, and meets the rules that it names."""

from __future__ import annotations

import numpy as np
import pytest

from plotfeed.feeds.cli.show_sensors import reach_m
from plotfeed.feeds.scene.presets.preset import (
    SCENE_ONLY,
    SITE,
    Preset,
    PresetTarget,
    names,
    predicted,
    preset,
    system_names,
)
from plotfeed.feeds.scene.presets.system import system
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.models.propagation import C_M_S

RADARS = [
    "art-midrange-3d",
    "doruk",
    "echodyne",
    "indra-arms",
    "radarzero",
    "ranger-r8ss-3d",
    "spexer-2000-3d-mkii",
    "spexer-2000-3d-mkiii",
]
RECEIVERS = [
    "aeroscope-portable",
    "aeroscope-stationary",
    "dedrone-rf-160",
    "dedrone-rf-360",
    "dronesentry-x",
    "rfone",
]
MICROPHONES = ["dronetracker-audio", "widealert"]
CAMERAS = [
    "axis-q6215-le",
    "droneopt",
    "indra-arms-optronic",
    "spynel-c1000",
    "spynel-s2000",
    "spynel-x3500",
    "triton-pt",
]
# Of tables 1 to 13 of the paper, and of sections 2.3 and 2.4.
QUOTED_RANGE_M = {
    "art-midrange-3d": 5000,
    "doruk": 6000,
    "echodyne": 2500,
    "indra-arms": 2000,
    "radarzero": 1500,
    "ranger-r8ss-3d": 2100,
    "spexer-2000-3d-mkii": 6000,
    "spexer-2000-3d-mkiii": 6000,
    "aeroscope-portable": 5000,
    "aeroscope-stationary": 50_000,
    "dedrone-rf-160": 5000,
    "dedrone-rf-360": 5000,
    "dronesentry-x": 2000,
    "rfone": 5000,
    "dronetracker-audio": 80,
    "widealert": 200,
    "axis-q6215-le": 1000,
    "droneopt": 600,
    "indra-arms-optronic": 2000,
    "spynel-c1000": 400,
    "spynel-s2000": 400,
    "spynel-x3500": 400,
    "triton-pt": 4000,
}

each = pytest.mark.parametrize("name", names())


def sensor(name: str) -> Sensor:
    return preset(name).sensor


def pd_at(sensor: Sensor, target: PresetTarget, **changes: float) -> float:
    return predicted(sensor, target.model_copy(update=changes), "pd")


def test_the_systems_of_the_tables_are_there() -> None:
    kinds = {name: preset(name).type for name in names()}
    assert kinds == (
        dict.fromkeys(RADARS, "active_radar")
        | dict.fromkeys(RECEIVERS, "rf")
        | dict.fromkeys(MICROPHONES, "acoustic")
        | dict.fromkeys(CAMERAS, "camera")
    )


TABLES = {
    1: ["art-midrange-3d"],
    2: ["indra-arms"],
    3: ["spexer-2000-3d-mkii", "spexer-2000-3d-mkiii"],
    4: ["echodyne"],
    5: ["ranger-r8ss-3d"],
    6: ["doruk"],
    7: ["dedrone-rf-160", "dedrone-rf-360"],
    8: ["dronetracker-audio"],
    9: ["axis-q6215-le"],
    10: ["triton-pt"],
    11: ["indra-arms-optronic"],
    12: ["spynel-c1000", "spynel-s2000", "spynel-x3500"],
    13: ["radarzero", "rfone", "widealert", "droneopt"],
}
IN_ITS_TEXT = ["aeroscope-portable", "aeroscope-stationary", "dronesentry-x"]
SYSTEMS = ["arms", "dronesentry", "dronetracker", "xpeller"]


def test_every_system_of_the_papers_tables_is_a_preset() -> None:
    of_tables = [name for found in TABLES.values() for name in found]
    assert sorted([*of_tables, *IN_ITS_TEXT]) == names()
    for number, found in TABLES.items():
        assert all(str(number) in preset(name).source for name in found)
    assert system_names() == SYSTEMS
    brought = {m.preset for name in SYSTEMS for m in system(name).members.values()}
    assert brought <= set(names())


@each
def test_a_preset_makes_a_model(name: str) -> None:
    shown = preset(name)
    alarms = shown.sensor.model(SITE).false_alarms_per_scan
    if shown.sensor.scan.kind == "electronic":
        assert alarms == 0  # none is confirmed
    else:
        assert 0 < alarms < 10


@each
def test_pd_is_080_at_the_quoted_range(name: str) -> None:
    shown = preset(name)
    assert shown.target.range_m == QUOTED_RANGE_M[shown.name]
    assert pd_at(shown.sensor, shown.target) == pytest.approx(0.8, abs=1e-6)
    assert pd_at(shown.sensor, shown.target, range_m=shown.target.range_m * 1.1) < 0.75
    assert pd_at(shown.sensor, shown.target, range_m=shown.target.range_m / 1.1) > 0.84


@each
def test_every_rule_that_is_solved_is_met_by_the_whole_sensor(name: str) -> None:
    shown = preset(name)
    solved = [rule.solve for rule in shown.derived.values() if rule.solve is not None]
    assert "pd" in [goal.quantity for goal in solved]
    for goal in solved:
        meant = shown.target if goal.other_target is None else shown.other_target[goal.other_target]
        reached = predicted(shown.sensor, meant, goal.quantity)
        assert reached == pytest.approx(goal.wanted, rel=1e-6)


@each
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


@each
def test_a_receiver_gets_no_warning_and_a_radar_only_that_of_the_format(name: str) -> None:
    shown = preset(name)
    warnings = shown.sensor.warnings(SITE)
    assert all(text.startswith("asterix-048 counts range") for text in warnings)


@each
def test_nothing_is_derived_out_of_reason(name: str) -> None:
    shown = preset(name)
    power_w = shown.keys.get("power_w")
    assert power_w is None or 0.1 < power_w < 1000
    loss_db = shown.keys.get("loss_db")
    assert loss_db is None or 0 < loss_db < 30
    sensitivity_db = shown.keys.get("sensitivity_db")
    assert sensitivity_db is None or 10 < sensitivity_db < 50


@pytest.mark.parametrize("name", ["spexer-2000-3d-mkii", "spexer-2000-3d-mkiii"])
def test_the_other_target_of_the_spexers_agrees_with_the_fourth_root_of_its_size(name: str) -> None:
    (other,) = preset(name).other_target
    assert other.range_m == 9000
    assert reach_m(preset(name), other) == pytest.approx(9000, rel=0.01)


def test_the_other_targets_of_the_ranger_fit_a_decade_of_size_each() -> None:
    micro, small = preset("ranger-r8ss-3d").other_target
    assert (micro.range_m, small.range_m) == (1200, 4000)
    assert reach_m(preset("ranger-r8ss-3d"), micro) == pytest.approx(1200, rel=0.02)
    assert reach_m(preset("ranger-r8ss-3d"), small) == pytest.approx(4000, rel=0.07)


def test_the_longer_range_of_the_audio_detector_takes_a_hundred_times_the_sound() -> None:
    (loud,) = preset("dronetracker-audio").other_target
    assert loud.sound_power_db == 100
    assert reach_m(preset("dronetracker-audio"), loud) == pytest.approx(500, rel=0.1)


@pytest.mark.parametrize(
    ("name", "interference_db", "range_m"),
    [("dedrone-rf-160", 9.9, 1600), ("dedrone-rf-360", 7.96, 2000)],
)
def test_interference_brings_dedrone_down_to_the_shorter_quoted_range(
    name: str, interference_db: float, range_m: float
) -> None:
    noisy = sensor(name).model_copy(
        update={"noise_figure_db": sensor(name).model_dump()["noise_figure_db"] + interference_db}
    )
    assert pd_at(noisy, preset(name).target, range_m=range_m) == pytest.approx(0.8, abs=0.01)


def test_a_town_brings_rfone_down_to_its_urban_range() -> None:
    town = type(sensor("rfone")).model_validate(
        {
            **preset("rfone").keys,
            "id": "town",
            "path_loss": {"kind": "log-distance", "exponent": 2.466},
        }
    )
    assert pd_at(town, preset("rfone").target, range_m=1000) == pytest.approx(0.8, abs=0.02)


@pytest.mark.parametrize(
    ("name", "stated"),
    [
        # Table 1
        ("art-midrange-3d", {"range_max_m": 5000, "range_resolution_m": 1, "scan.period_s": 1}),
        ("art-midrange-3d", {"azimuth_span_deg": 360, "elevation_span_deg": 10}),
        # Table 2
        ("indra-arms", {"scan.period_s": 1, "azimuth_span_deg": 360}),
        # Table 3
        ("spexer-2000-3d-mkii", {"azimuth_span_deg": 120, "elevation_span_deg": 15}),
        ("spexer-2000-3d-mkiii", {"azimuth_span_deg": 360, "elevation_span_deg": 90}),
        # Table 4
        ("echodyne", {"azimuth_span_deg": 120, "elevation_span_deg": 80, "scan.period_s": 0.1}),
        ("echodyne", {"scan.revisit_s": 0.1, "scan.max_tracks": 20}),
        ("echodyne", {"azimuth_beamwidth_deg": 2, "elevation_beamwidth_deg": 6}),
        ("echodyne", {"frequency_hz": 24.15e9, "range_resolution_m": C_M_S / (2 * 200e6)}),
        # Table 5
        ("ranger-r8ss-3d", {"range_max_m": 7800, "range_min_m": 10, "scan.period_s": 0.5}),
        ("ranger-r8ss-3d", {"azimuth_span_deg": 90, "elevation_span_deg": 40}),
        # Table 6
        ("doruk", {"scan.period_s": 4, "azimuth_span_deg": 360, "range_resolution_m": 15}),
        ("doruk", {"elevation_beamwidth_deg": 20, "azimuth_beamwidth_deg": 2}),
        ("doruk", {"measures_elevation": False}),
        # Section 2.3 and table 7
        ("aeroscope-stationary", {"range_max_m": 50_000, "azimuth_span_deg": 360}),
        ("aeroscope-portable", {"range_max_m": 5000, "azimuth_span_deg": 360}),
        ("dedrone-rf-160", {"classifies": True, "measures_azimuth": False}),
        ("dedrone-rf-360", {"classifies": True, "measures_azimuth": True}),
        # Table 8
        ("dronetracker-audio", {"range_max_m": 500, "azimuth_span_deg": 90}),
        # Table 13
        ("radarzero", {"azimuth_span_deg": 90, "elevation_span_deg": 80, "frequency_hz": 24.55e9}),
        ("radarzero", {"azimuth_beamwidth_deg": 2, "elevation_beamwidth_deg": 6}),
    ],
)
def test_stated_figures_are_in_the_sensor(name: str, stated: dict[str, float]) -> None:
    keys = sensor(name).model_dump()
    keys |= {f"scan.{name}": value for name, value in keys["scan"].items()}
    for span in ("azimuth", "elevation"):
        if f"{span}_min_deg" in keys:
            keys[f"{span}_span_deg"] = keys[f"{span}_max_deg"] - keys[f"{span}_min_deg"]
    assert {key: keys[key] for key in stated} == pytest.approx(stated)


@pytest.mark.parametrize(
    ("name", "accuracies"),
    [
        ("art-midrange-3d", {"sigma_range_m": 0.25}),
        (
            "ranger-r8ss-3d",
            {"sigma_range_m": 3, "sigma_azimuth_deg": 0.8, "sigma_elevation_deg": 3},
        ),
        ("doruk", {"sigma_range_m": 5, "sigma_azimuth_deg": 1}),
    ],
)
def test_stated_accuracies_are_reached_at_the_quoted_range(
    name: str, accuracies: dict[str, float]
) -> None:
    target = preset(name).target
    reached = {key: predicted(sensor(name), target, key) for key in accuracies}
    assert reached == pytest.approx(accuracies, rel=1e-6)


def test_cameras_see_their_other_targets_as_far_as_is_quoted() -> None:
    for name in ("axis-q6215-le", "droneopt", "triton-pt"):
        (other,) = preset(name).other_target
        assert reach_m(preset(name), other) == pytest.approx(other.range_m, rel=0.05)


@pytest.mark.parametrize(
    ("name", "mrad"), [("spynel-c1000", 0.855), ("spynel-s2000", 0.560), ("spynel-x3500", 0.270)]
)
def test_pixels_of_panoramas_are_square(name: str, mrad: float) -> None:
    keys = preset(name).keys
    assert np.radians(360 / keys["pixels_across"]) * 1e3 == pytest.approx(mrad, rel=0.01)
    assert np.radians(20 / keys["pixels_down"]) * 1e3 == pytest.approx(mrad, rel=0.01)


def test_a_key_cannot_have_two_marks() -> None:
    given = {"value": 1.0, "note": "x"}
    tree = preset("doruk").model_dump() | {"stated": {"pfa": given}, "assumed": {"pfa": given}}
    with pytest.raises(ValueError, match="pfa has two marks"):
        Preset.model_validate(tree)


def test_a_preset_leaves_to_the_scene_what_is_the_scenes() -> None:
    tree = preset("doruk").model_dump() | {"assumed": {"id": {"value": "x", "note": "x"}}}
    with pytest.raises(ValueError, match="id is for the scene to say"):
        Preset.model_validate(tree)

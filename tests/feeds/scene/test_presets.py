"""Presets in scenes, and the command that lists them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NoReturn

import pytest
from click.testing import CliRunner

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
from plotfeed.feeds.scene.scene import Scene, SceneError, from_tree
from plotfeed.proto.errors import PlotfeedError

PATH = Path("test.toml")


SITE = {"latitude_deg": 40.0, "longitude_deg": -3.0, "height_m": 0.0}
GENERAL = {"name": "test", "seed": 1, "site": SITE}


def scene(*sensors: dict[str, Any]) -> Scene:
    return from_tree({"scene": GENERAL, "sensor": list(sensors)}, PATH)


def problems(*sensors: dict[str, Any]) -> list[tuple[str, str]]:
    with pytest.raises(SceneError) as caught:
        scene(*sensors)
    return caught.value.problems


def run(*arguments: str) -> str:
    result = CliRunner().invoke(cli, ["sensors", *arguments], standalone_mode=False)
    if result.exception:
        raise result.exception
    return result.output


def strict_json(text: str) -> Any:
    def refuse(constant: str) -> NoReturn:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


def test_each_preset_alone_makes_a_sensor_and_is_numbered() -> None:
    made = scene(*({"id": f"p{i}", "preset": name} for i, name in enumerate(names())))
    for i, (name, found) in enumerate(zip(names(), made.sensor, strict=True)):
        own = {"id": f"p{i}", "preset": name, "sic": i + 1}
        assert found.model_dump() == preset(name).sensor.model_dump() | own


def test_keys_of_the_scene_go_first_and_what_was_solved_for_stays() -> None:
    """So that an overridden key has its effect."""
    plain, found = scene(
        {"id": "a", "preset": "echodyne"},
        {"id": "b", "preset": "echodyne", "pfa": 1e-5, "sic": 9, "noise_figure_db": 15.0},
    ).sensor
    assert (found.pfa, found.sic, found.noise_figure_db) == (1e-5, 9, 15.0)
    assert found.azimuth_beamwidth_deg == 2.0
    assert found.power_w == plain.power_w


def test_a_scan_is_replaced_as_a_whole() -> None:
    rotating = {"kind": "rotating", "period_s": 2.0}
    (found,) = scene({"id": "a", "preset": "echodyne", "scan": rotating}).sensor
    assert (found.scan.kind, found.scan.period_s) == ("rotating", 2.0)
    assert problems({"id": "a", "preset": "art-midrange-3d", "scan": {"kind": "rotating"}}) == [
        ("sensor[0].scan.period_s", "missing")
    ]


def test_a_type_may_be_given_if_it_is_the_presets() -> None:
    assert scene({"id": "a", "preset": "doruk", "type": "active_radar"}).sensor
    ((key, text),) = problems({"id": "a", "preset": "doruk", "type": "rf"})
    assert key == "sensor[0].type"
    assert text == "the preset doruk is of type active_radar, not rf"


@pytest.mark.parametrize(
    ("wrong", "hint"),
    [
        ("echodine", "did you mean echodyne?"),
        ("Echodyne", "did you mean echodyne?"),
        ("ranger", "did you mean ranger-r8ss-3d?"),
        ("mkiii", "did you mean spexer-2000-3d-mkiii?"),
        ("rf-16", "did you mean dedrone-rf-160?"),
        ("zzz", "`plotfeed sensors` lists them"),
        ("", "`plotfeed sensors` lists them"),
        ("../doruk", "did you mean doruk?"),
    ],
)
def test_a_wrong_name_is_one_line_with_a_suggestion(wrong: str, hint: str) -> None:
    ((key, text),) = problems({"id": "a", "preset": wrong})
    assert key == "sensor[0].preset"
    assert text == f"no such preset as {wrong!r}; {hint}"


def test_a_preset_is_a_name_told_in_one_short_line() -> None:
    ((_, text),) = problems({"id": "a", "preset": "x" * 100_000})
    assert len(text) < 200
    says = [("sensor[0].preset", "write the name of a preset, in quotes")]
    wrong: list[object] = [7, True, [], {}, ["doruk"]]
    assert all(problems({"id": "a", "preset": each}) == says for each in wrong)


def test_problems_name_the_scenes_keys_and_none_is_lost() -> None:
    found = problems(
        {"id": "a", "preset": "doruk", "pfa": 0.9},
        {"id": "b", "preset": "nothing-like-it"},
        {"id": "c", "preset": "rfone", "powr_w": 1.0},
        {"id": "d", "preset": "widealert", "scan": {"kind": "staring", "period_s": -1.0}},
    )
    assert sorted(key for key, _ in found) == [
        "sensor[0].pfa",
        "sensor[1].preset",
        "sensor[2].powr_w",
        "sensor[3].scan.period_s",
    ]


@pytest.mark.parametrize("wrong", [[], [1], {}, "x", [None]])
def test_sensors_that_are_no_tables_are_told_as_without_presets(wrong: object) -> None:
    with pytest.raises(SceneError):
        from_tree({"scene": GENERAL, "sensor": wrong}, PATH)


def test_the_tree_that_a_scene_came_from_is_left_as_it_was() -> None:
    own = {"id": "a", "preset": "doruk"}
    scene(own)
    assert own == {"id": "a", "preset": "doruk"}


def test_a_rule_that_nothing_meets_says_so() -> None:
    given = preset("doruk").keys | {"range_floor_m": 9.0}
    given = {key: value for key, value in given.items() if key not in {"type", "power_w"}}
    rules: dict[str, PresetRule] = {
        "power_w": PresetRule.model_validate({"note": "x", "solve": {"sigma_range_m": 1.0}})
    }
    with pytest.raises(PlotfeedError, match="power_w: no value gives sigma_range_m 1"):
        derive("active_radar", given, rules, PresetTarget(range_m=6000.0, rcs_m2=0.01, note="x"))


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
    text, found = run(), strict_json(run("--json"))
    assert all(f"\n{name} " in text for name in names())
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
        found = strict_json(run(name, "--json"))
        assert (found["name"], len(found["table"])) == (name, 10)
        assert {key["mark"] for key in found["keys"]} <= {"stated", "derived", "assumed"}


def test_an_unknown_name_is_wrong_use() -> None:
    with pytest.raises(UnknownPresetError, match=r"did you mean doruk\?") as caught:
        run("dorak")
    assert caught.value.exit_code == 2

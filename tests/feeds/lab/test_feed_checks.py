"""Feeds beside their claims: planted faults have their names; right feeds pass, in every scene."""

from __future__ import annotations

import json
import math
import tomllib
from functools import cache
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from scipy import stats
from support.command import plotfeed_here, refusal
from support.doc_commands import doc_command
from support.every_kind import GATE, SENSORS, drones
from support.ledgers import record_session
from support.random_scenes import tree_with
from support.significance import assert_chance

from plotfeed.feeds.engine.simulation import SimulatedSensor, simulate
from plotfeed.feeds.lab.gathering import FeedReport
from plotfeed.feeds.lab.judge import FALSE_RATES, NOT_AS_STATED, Against, FeedTally, simulated_feed
from plotfeed.feeds.lab.report import feed_lines
from plotfeed.feeds.scene.scene import Scene, from_tree, load
from plotfeed.feeds.testing.built_scene import toml_of
from plotfeed.models.residuals import Check, wrong_at
from plotfeed.testing import flown, held, radar, scene, waypoint

FALSE_RATE = FALSE_RATES["claimed"]
NS = 10**9
START_NS = 1_767_268_800 * NS
# What writes the tables of docs/feed-checks.md: the radars of one scene, and their faults by name.
COMMAND = doc_command("write_feed_checks")
TITLES = COMMAND["TITLES"]
SPREADS = TITLES["lying"][1]
SEEDS, SECONDS = 20, 15.0


def checks_of(made: Scene, seen: SimulatedSensor) -> dict[str, Check]:
    """What a simulated sensor claims, checked."""
    tally = FeedTally("claimed")
    tally.take(simulated_feed(made, seen))
    return {check.name: check for check in tally.checks()}


def simulated(kind: str, **keys: object) -> dict[str, Check]:
    """Of a sensor of that kind, at drones that hover."""
    made = scene([SENSORS[kind] | keys], drones(kind), seed=21)
    return checks_of(made, simulate(made, 20.0, start_utc_ns=START_NS)["radar"])


def made_of(tree: dict[str, Any]) -> Scene:
    return from_tree(tree, Path("made.toml"), toml_of(tree))


@cache
def scenes() -> dict[str, Scene]:
    return {path.stem: load(path) for path in COMMAND["SCENES"]}


@pytest.mark.parametrize("fault", TITLES)
def test_a_fault_is_seen_and_named(fault: str) -> None:
    found = COMMAND["called_wrong"](scenes()["feed-faults"], fault, SEEDS, SECONDS)
    # Of 100 seeds all were seen (docs/feed-checks.md): at a rate of 98 %, less than 15 of 20 come
    # once in a million.
    names = TITLES[fault][1]
    assert sum(bool(names & each) for each in found) >= 15, found
    assert sum(bool(each - names - SPREADS) for each in found) <= 4, found  # 1 % each


def test_right_feeds_pass_but_for_as_many_as_is_said() -> None:
    found = COMMAND["called_wrong"](scenes()["feed-faults"], "clean", 100, SECONDS)
    failed = sum(map(bool, found))
    assert_chance(float(stats.binom.sf(failed - 1, 100, 0.01)), f"{failed} of 100: {found}")


def test_asterix_is_judged_by_its_steps_and_a_fault_is_seen_through_them(tmp_path: Path) -> None:
    """A right radar and two that are not, as the command tells of them."""
    tree = tomllib.loads(COMMAND["SCENE"].read_text())
    radars = [each for each in tree["sensor"] if each["id"] in ("clean", "askew", "late")]
    tree["sensor"] = [each | {"report": ["asterix-048"]} for each in radars]
    record = record_session(made_of(tree), tmp_path / "faults.mcap", 40.0)
    done = plotfeed_here("score", record, "--feed", "--json")
    assert (done.returncode, done.stderr) == (1, "")
    told = json.loads(done.stdout)
    assert {each["plots_from"] for each in told["sensors"]} == {"asterix/048, as delivered"}
    wrong = told["verdicts"]["wrong"]
    assert {"askew: azimuth", "late: time"} <= {*wrong}
    found = {(each["sensor"], each["check"]): each for each in told["verdicts"]["checks"]}
    for which, planted in ((("askew", "azimuth"), 2.0), (("late", "time"), 1.0)):
        assert found[which]["found"] == pytest.approx(planted, abs=5 * found[which]["sigma"])
    assert not [each for each in wrong if each.startswith("clean")]
    told = FeedReport(record, "claimed")
    assert "differs from its claims" in "\n".join(feed_lines(told))
    said = refusal("score", record, "--feed", "--profile", "example-f3411")
    assert "--profile is about a tracker" in said


@pytest.mark.parametrize("kind", SENSORS)
def test_every_kind_is_judged_as_far_as_it_measures(kind: str) -> None:
    """Drones that hover; of those that cannot be judged it is said why."""
    checks = simulated(kind)
    assert not any(wrong_at(list(checks.values()), 1e-4)), checks
    assert not math.isnan(checks["Pd"].p) or checks["Pd"].why_not
    of_kind = {
        "rf": {"azimuth"},
        "passive": {"azimuth", "bistatic range"},
        "microphones": {"azimuth", "elevation"},
    }.get(kind, {"azimuth", "range", "elevation", "height"})
    assert {name.removesuffix(" spread") for name in checks if name.endswith(" spread")} == of_kind


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("layout", "a layout of microphones"),
        ("acoustic_pair", "errors and false alarms, as detections are joined to places"),
        ("multistatic_mimo", "false alarms, as detections are joined to places"),
        ("multistatic_passive", "false alarms, as detections are joined to places"),
        ("active_radar", ""),
    ],
)
def test_what_is_not_judged_is_said_with_the_reason(kind: str, reason: str, tmp_path: Path) -> None:
    """Half of the plots of a line of microphones are on its wrong side, and that is right."""
    if kind == "layout":
        layout = {"shape": "line", "spacing_m": 0.5}
        sensor = SENSORS["microphones"] | {"layout": layout, "microphones": 8}
        del sensor["elevation_beamwidth_deg"]
        made = scene([sensor], drones("microphones"), seed=22)
    else:
        made = made_of(tree_with(kind, ["plain"], 1))
    record = record_session(made, tmp_path / "one.mcap", 5.0)
    for against in get_args(Against):
        told = FeedReport(record, against)
        (only,) = told.sensors
        assert reason in only.unjudged
        assert bool(reason) == bool(only.unjudged)
        assert bool(reason) == any(": not judged: " in line for line in feed_lines(told))
        checks = {check.name: check for check in told.verdicts.checks if not check.link}
        assert checks["Pd"].p > 1e-4 or checks["Pd"].why_not
        ghosts = "joined" in reason
        assert ("ghosts" in checks["false alarms"].why_not) == ghosts
        if against == "claimed" and (kind == "layout" or reason.startswith("errors")):
            of_errors = [checks[name] for name in ("azimuth", "range", "time")]
            assert {check.why_not for check in of_errors} == {NOT_AS_STATED}
            assert np.isnan([check.p for check in of_errors]).all()


def test_a_bearing_that_is_off_is_seen_without_a_range() -> None:
    checks = simulated("rf", bias={"azimuth_offset_deg": 2.0})
    assert checks["azimuth"].p < 1e-6
    assert abs(checks["azimuth"].found - 2.0) < 5 * checks["azimuth"].sigma


def test_a_steered_beam_that_is_late_is_not_called_off_in_range() -> None:
    """Although its looks that search, and those that confirm a millisecond later, tell no speed."""
    perimeter = scenes()["perimeter"]
    gate = next(s for s in perimeter.sensor if s.id == "north-gate")
    late = gate.model_dump(exclude_unset=True) | {"bias": {"time_offset_s": 1.0}}
    made = perimeter.model_copy(update={"sensor": (type(gate).model_validate(late),)})
    checks = checks_of(made, simulate(made, 120.0, start_utc_ns=START_NS)["north-gate"])
    assert checks["time"].p < 1e-9
    assert checks["time"].found == pytest.approx(1.0, abs=5 * checks["time"].sigma)
    assert checks["range"].p > 1e-4


# The others together have every kind of sensor, mount and link, drones that report themselves, and
# those with planted faults; the command judges all of them.
SPARED = {"bad-link", "radar-udp", "stadium", "utm", "valley"}


def test_right_feeds_of_every_scene_pass_live_and_recorded_and_planted_faults_are_named() -> None:
    """Half a minute of some, each judged twice: of right feeds 1 % are called wrong."""
    wrong: dict[str, list[set[str]]] = {}
    for path in (each for each in COMMAND["SCENES"] if each.stem not in SPARED):
        verdicts = COMMAND["scene_verdicts"](path, 1, 30.0)
        wrong[path.stem] = [COMMAND["of_right_feeds"](path.stem, each) for each in verdicts]
        assert all(COMMAND["names_all"](path.stem, each) for each in verdicts), verdicts
    found = [bool(each) for both in wrong.values() for each in both]
    assert len(found) >= 16
    assert_chance(float(stats.binom.sf(sum(found) - 1, len(found), FALSE_RATE)), str(wrong))


def test_detections_of_drones_whose_echoes_merge_are_not_judged_and_it_is_said_why() -> None:
    drones = [held(f"d{i}", 40.0 + 0.2 * i, 5.0, 2000.0, rcs_m2=4.0**i) for i in range(4)]
    alone = held("alone", 200.0, 5.0, 2000.0, rcs_m2=1.0)
    sensor = radar(merging={}, azimuth_beamwidth_deg=2.0)

    def judged(*present: dict[str, Any]) -> dict[str, Check]:
        made = scene([sensor], present, seed=3)
        return checks_of(made, simulate(made, 40.0, start_utc_ns=START_NS)["radar"])

    checks = judged(*drones)
    assert np.isnan(checks["Pd"].p)
    assert "merging" in checks["Pd"].why_not
    # Merged plots are the means of their echoes, and nobody's false alarms.
    assert checks["azimuth"].of == 40
    assert not any(wrong_at(list(checks.values()), 1e-4)), checks
    assert judged(*drones, alone)["Pd"].of == 40  # of the one that stands alone


def test_sectors_without_a_plot_count_among_those_in_which_false_alarms_might_have_come() -> None:
    made = scenes()["field-day"]
    seen = simulate(made, 20.0, seed=1, start_utc_ns=START_NS)["camera"]
    assert len({*seen.plots.scan.tolist()}) < 200
    assert simulated_feed(made, seen).scans == pytest.approx(200.0)


@pytest.mark.parametrize(
    ("sensor", "seconds", "names"),
    [
        # Steps of 25 feet of altitude above mean sea level, which is 51 m above the ellipsoid.
        (radar(report=["asterix-048"]), 60.0, {"height", "height spread"}),
        # 3.0001 m, the rounding of ranges in it, are told as 3.1.
        (GATE | {"report": ["asterix-015"]}, 200.0, {"range", "range spread"}),
    ],
    ids=["heights", "sigmas"],
)
def test_what_a_format_tells_in_coarse_steps_is_expected_so(
    tmp_path: Path, sensor: dict[str, Any], seconds: float, names: set[str]
) -> None:
    drones = [
        flown(f"d{i}", *(waypoint(12.0 * i + n, 4.0 + n, 900.0 + 90.0 * i) for n in (0.0, 1.5)))
        for i in range(30)
    ]
    record = record_session(scene([sensor], drones, seed=7), tmp_path / "steps.mcap", seconds)
    checks = [c for c in FeedReport(record, "asked").verdicts.checks if c.name in names]
    assert len(checks) == 2
    for check in checks:
        assert check.of > 800
        assert_chance(check.p, f"{check}")

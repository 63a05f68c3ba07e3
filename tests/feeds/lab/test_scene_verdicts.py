"""Verdicts on the feeds of every scene: right feeds pass, and faults among many are named."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from support.claimed_feeds import claims_of
from support.doc_commands import doc_command
from support.every_kind import GATE
from support.ledgers import record_session
from support.significance import assert_chance

from plotfeed.feeds.engine.simulation import SimulatedSensor, simulate
from plotfeed.feeds.lab.gathering import FeedReport
from plotfeed.feeds.lab.judge import FALSE_RATES, simulated_feed
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.scene.sensors.effect_keys import BiasKeys, DegradationKeys
from plotfeed.models.residuals import Check, wrong_at
from plotfeed.testing import flown, held, radar, scene, waypoint

FALSE_RATE = FALSE_RATES["claimed"]
SEED, SECONDS = 1, 30.0
NS = 10**9


@cache
def scenes() -> dict[str, Scene]:
    return {path.stem: load(path) for path in doc_command("write_feed_checks")["SCENES"]}


def with_sensor(name: str, sensor: str, **keys: Any) -> tuple[Scene, SimulatedSensor]:
    """A scene with one of its sensors alone, whose keys are changed, and what that did."""
    whole = scenes()[name]
    (alone,) = (each for each in whole.sensor if each.id == sensor)
    made = whole.model_copy(update={"sensor": (alone.model_copy(update=keys),)})
    return made, simulate(made, 60.0, seed=SEED, start_utc_ns=1_767_268_800 * NS)[sensor]


def checks_of(made: Scene, seen: SimulatedSensor) -> dict[str, Check]:
    return {check.name: check for check in claims_of(made, seen)}


def test_right_feeds_of_every_scene_pass_live_and_recorded_and_planted_faults_are_named() -> None:
    """Half a minute of each, 13 sessions judged twice: of right feeds 1 % are called wrong."""
    command = doc_command("write_feed_checks")
    wrong: dict[str, list[set[str]]] = {}
    for path in command["SCENES"]:
        verdicts = command["scene_verdicts"](path, SEED, SECONDS)
        wrong[path.stem] = [command["of_right_feeds"](path.stem, each) for each in verdicts]
        assert all(command["names_all"](path.stem, each) for each in verdicts), verdicts
    found = [bool(each) for both in wrong.values() for each in both]
    assert len(found) >= 26
    assert_chance(float(stats.binom.sf(sum(found) - 1, len(found), FALSE_RATE)), str(wrong))


@pytest.mark.parametrize(
    ("name", "sensor"),
    [
        ("perimeter", "north-gate"),  # looks several times at a drone within a period
        ("coast", "passive"),  # a fine and a coarse transmitter, and plots near a baseline
        ("field-day", "rf"),  # bearings of many drones, closer than their errors
        ("field-day", "tower"),
    ],
)
def test_as_many_looks_are_hit_as_drones_were_plotted(name: str, sensor: str) -> None:
    made, seen = with_sensor(name, sensor)
    drones = int((seen.plots.drone >= 0).sum())
    steered = sensor == "north-gate"  # whose search makes no plot by itself
    checks, plottable = checks_of(made, seen), int((seen.looks.channel > 0).sum())
    plottable = plottable if steered else len(seen.looks)
    assert checks["Pd"].of > 0.9 * plottable
    assert checks["Pd"].found == pytest.approx(drones / plottable, abs=0.02)


@pytest.mark.parametrize(
    ("keys", "named"),
    [
        ({"bias": BiasKeys(azimuth_offset_deg=2.0)}, "azimuth"),
        ({"degradation": DegradationKeys(error_factor=2.5)}, "azimuth spread"),
        ({"degradation": DegradationKeys(pd_factor=0.6)}, "Pd"),
    ],
)
@pytest.mark.parametrize("name", ["rf", "tower"])
def test_among_drones_closer_than_errors_a_fault_is_named(
    name: str, keys: dict[str, Any], named: str
) -> None:
    checks = checks_of(*with_sensor("field-day", name, **keys))
    wrong = wrong_at(list(checks.values()), FALSE_RATE)
    assert named in {each for each, is_wrong in zip(checks, wrong, strict=True) if is_wrong}


@pytest.mark.parametrize("name", ["rf", "ears"])
def test_bearings_closer_than_their_errors_do_not_seem_to_scatter_less(name: str) -> None:
    spread = checks_of(*with_sensor("field-day", name))["azimuth spread"]
    assert_chance(spread.p, f"{spread.found:.2f} of {spread.of}")


def test_drones_whose_echoes_merge_are_not_judged_and_it_is_said_why() -> None:
    drones = [held(f"d{i}", 40.0 + 0.2 * i, 5.0, 2000.0, rcs_m2=1.0) for i in range(4)]
    alone = held("alone", 200.0, 5.0, 2000.0, rcs_m2=1.0)
    sensor = radar(merging={}, azimuth_beamwidth_deg=2.0)

    def judged(*present: dict[str, Any]) -> dict[str, Check]:
        made = scene([sensor], present, seed=3)
        return checks_of(made, simulate(made, 40.0, start_utc_ns=1_700_000_000 * NS)["radar"])

    checks = judged(*drones)
    assert np.isnan(checks["Pd"].p)
    assert "merging" in checks["Pd"].why_not
    assert "tells apart" in checks["range"].why_not
    assert checks["false alarms"].p > 1e-4  # the merged plots are nobody's false alarms
    assert judged(*drones, alone)["Pd"].of == 40  # of the one that stands alone


def test_sectors_without_a_plot_count_among_those_in_which_false_alarms_might_have_come() -> None:
    made, seen = with_sensor("field-day", "camera")
    assert simulated_feed(made, seen).scans == pytest.approx(600.0)


@pytest.mark.parametrize(
    ("sensor", "seconds", "names"),
    [
        # Steps of 25 feet of altitude above mean sea level, which is 51 m above the ellipsoid.
        (radar(report=["asterix-048"]), 60.0, {"height", "height spread"}),
        # 3.0001 m, the rounding of ranges in it, are told as 3.1.
        (GATE | {"report": ["asterix-015"]}, 400.0, {"range", "range spread"}),
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
    path = tmp_path / "steps.toml"
    path.write_text(scene([sensor], drones, seed=7).text)
    record = record_session(path, tmp_path / "steps.mcap", seconds)
    checks = [c for c in FeedReport(record, "asked").verdicts.checks if c.name in names]
    assert len(checks) == 2
    for check in checks:
        assert check.of > 800
        assert_chance(check.p, f"{check}")

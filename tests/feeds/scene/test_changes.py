from __future__ import annotations

from typing import Any

import pytest
from support.every_kind import GATE

from plotfeed.feeds.scene.changes import (
    MAX_COMMAND_OCTETS,
    ChangeError,
    ControlError,
    changed,
    merged,
    parsed,
)
from plotfeed.feeds.scene.scene import Scene, SceneError
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.testing import flown, radar, scene, waypoint


def sensor(**keys: Any) -> Sensor:
    return scene([radar(**keys)], seed=1).sensor[0]


def test_changes_go_over_the_sensors_own_keys_and_earlier_ones_and_over_no_others() -> None:
    before = sensor(pfa=1e-6)
    assert changed(before, {"pfa": 1e-5}).model_dump() == before.model_dump() | {"pfa": 1e-5}
    assert changed(before) == before
    after = changed(before, {"pfa": 1e-5, "loss_db": 1.0}, {"pfa": 1e-4}).model_dump()
    assert after == before.model_dump() | {"pfa": 1e-4, "loss_db": 1.0}
    factor = changed(before, {"pfa_factor": 10}).model_dump()  # of the scene's own pfa
    assert factor["pfa"] == pytest.approx(1e-5)


def test_the_link_is_changed_key_by_key_and_a_null_takes_one_away() -> None:
    before = sensor(link={"latency_ms": 100.0, "jitter_ms": 5.0})
    assert changed(before, {"link": {"latency_ms": 50.0}}).link.jitter_ms == 5.0  # type: ignore[union-attr]
    assert changed(before, {"link": {"jitter_ms": None}}).link.jitter_ms == 0.0  # type: ignore[union-attr]
    assert changed(before, {"link": None}).link is None
    # A table of another kind begins anew.
    tree = {"loss": {"kind": "random", "probability": 0.1}}
    other = {"loss": {"kind": "gilbert-elliott", "mean_loss": 0.1, "mean_burst": 4.0}}
    assert merged(tree, other) == other
    same_kind = merged(tree, {"loss": {"probability": 0.2}})
    assert same_kind == {"loss": {"kind": "random", "probability": 0.2}}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"pf": 1e-5}, "pf: no such key; did you mean pfa?"),
        ({"pfa": 2.0}, "pfa: input should be less than or equal to 0.1, not 2.0"),
        ({"pfa": "much"}, "pfa: input should be a valid number, not 'much'"),
        ({"id": "other"}, "id: cannot change while the sensor is at work"),
        ({"scan": {"period_s": 2.0}}, "scan: cannot change while the sensor is at work"),
        ({"pfa_factor": -1}, "pfa_factor: expected a number above 0, not -1"),
        ({"pfa_factor": True}, "pfa_factor: expected a number above 0, not True"),
        ({"pfa_factor": 1e9}, "pfa: input should be less than or equal to 0.1"),
        ({"link": {"latency": 5}}, "link.latency: no such key; did you mean latency_ms?"),
        ({"link": 5}, "link: expected a table, not 5"),
        ({"link": {"loss": {"kind": "rnd"}}}, "link.loss.kind: expected one of"),
        ({"power_w": None}, "power_w: missing"),
    ],
)
def test_a_change_that_no_sensor_can_have_is_a_line_that_names_the_key(
    change: dict[str, Any], words: str
) -> None:
    with pytest.raises(ChangeError) as refused:
        changed(sensor(), change)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_sensor_without_pfa_has_no_factor_on_it() -> None:
    with pytest.raises(ChangeError, match="pfa_factor: sensor 'radar' has no pfa"):
        changed(scene([GATE], seed=1).sensor[0], {"pfa_factor": 10})


@pytest.mark.parametrize(
    ("event", "words"),
    [
        ({"from_s": 5.0, "to_s": 5.0, "set": {"pfa": 1e-5}}, ".to_s of 'radar': must be above"),
        ({"from_s": 5.0, "set": {}}, ".set"),
        ({"from_s": 5.0, "set": {"pf": 1e-5}}, ".set of 'radar': pf: no such key"),
        ({"from_s": 5.0, "set": {"pfa": 0.1}}, ".*false alarms a scan"),
        ({"to_s": 5.0, "set": {"pfa": 1e-5}}, ".from_s of 'radar': missing"),
    ],
)
def test_an_event_that_cannot_happen_is_refused_with_the_scene(
    event: dict[str, Any], words: str
) -> None:
    with pytest.raises(SceneError, match=rf"event\[0\]{words}"):
        scene([radar(event=[event])], seed=1)


def test_weather_and_jammers_of_all_are_events_of_each_sensor_behind_its_own() -> None:
    place = {"east_m": 1.0, "north_m": 2.0, "above_site_m": 3.0}
    noise = place | {"eirp_w": 5.0, "frequency_hz": 1e9, "bandwidth_hz": 1e6}
    tables = {
        "weather": [{"from_s": 5.0, "to_s": 9.0, "rain_mm_h": 20.0}],
        "jammer": [{"id": "far", "from_s": 3.0, **noise}],
    }
    own = {"from_s": 1.0, "set": {"pfa": 1e-5}}
    (made,) = scene([radar(event=[own])], seed=1, **tables).sensor
    assert [(e.from_s, e.to_s, e.set) for e in made.event] == [
        (1.0, None, {"pfa": 1e-5}),
        (5.0, 9.0, {"weather": {"rain_mm_h": 20.0}}),
        (3.0, None, {"jamming": {"far": noise}}),
    ]


def test_a_command_is_of_a_sensor_or_of_the_clock() -> None:
    command = parsed(b'{"sensor": "radar", "set": {"link": {"latency_ms": 250}}}')
    assert (command.sensor, command.set) == ("radar", {"link": {"latency_ms": 250}})
    assert parsed(b'{"sensor": "radar", "reset": true}').reset
    clock = parsed(b'{"clock": {"speed": 10}}').clock
    assert clock is not None
    assert (clock.speed, clock.paused, clock.step_s) == (10.0, None, None)


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"", "not JSON: expected such as"),
        (b"[]", "expected an object such as"),
        (b"{}", "expected one of sensor, drone, clock, story and undo"),
        (b'{"sensor": "radar"}', 'with a sensor, expected either "set" or "reset"'),
        (b'{"sensor": "radar", "set": {}, "reset": true}', 'either "set" or "reset"'),
        (b'{"sensor": "radar", "set": {}, "clock": {"paused": true}}', "expected one of sensor"),
        (b'{"story": "outage", "sensor": "radar"}', "expected one of sensor, drone, clock"),
        (b'{"story": "outage", "set": {}}', "set is of a sensor"),
        (b'{"undo": true, "reset": true}', "undo has no reset"),
        (b'{"undo": false}', "expected one of sensor, drone, clock"),
        (b'{"drone": "a"}', "with a drone, expected one of"),
        (b'{"drone": "a", "reset": true, "claim": {"freeze": true}}', "with a drone, expected one"),
        (b'{"sensor": "a", "reset": true, "claim": {"freeze": true}}', "are of a drone"),
        (b'{"drone": "a", "contingency": {"kind": "hold", "at_s": 3.0}}', "it happens at once"),
        (b'{"drone": "a", "contingency": {"kind": "tea"}}', "contingency.kind: expected one of"),
        (b'{"drone": "a", "claim": {"freeze": true, "to_s": 9.0}}', "it holds from now on"),
        (b'{"drone": "a", "claim": {}}', "drop_out, delay_s, bias_enu_m, walk_m, freeze or spoof"),
        (b'{"sensor": 5, "set": {}}', "sensor: input should be a valid string, not 5"),
        (b'{"clock": {}}', "clock: expected paused, speed or step_s"),
        (b'{"clock": {"speed": 0}}', "clock.speed: input should be greater"),
        (b'{"clock": {"sped": 2}}', "clock.sped: no such key; did you mean speed"),
        (b"x" * (MAX_COMMAND_OCTETS + 1), "at most 65536 are taken"),
        (b"[" * 60_000, "not JSON"),
    ],
)
def test_what_is_no_command_is_refused_in_a_line(payload: bytes, words: str) -> None:
    with pytest.raises(ControlError) as refused:
        parsed(payload)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


# Stories: what they may say, and those that any scene has.

USUAL = {"bad-link", "outage", "drift", "jamming", "swarm"}
WAY = waypoint(90.0, 8.0, 900.0), waypoint(90.0, 8.0, 2000.0)
WET = {"sensor": "radar", "set": {"weather": {"rain_mm_h": 20.0}}}
RAIN = {"id": "rain", "title": "A shower", "change": [WET]}


def telling(*stories: dict[str, Any]) -> Scene:
    return scene([radar()], [flown("visitor", *WAY)], seed=1, story=list(stories))


def swarm(name: str) -> dict[str, Any]:
    """A story of a swarm of that name."""
    line = {"kind": "line", "spacing_m": 10.0}
    keys = {"id": name, "number": 2, "formation": line, "speed_m_s": 10.0, "path": list(WAY)}
    return {"id": "x", "swarm": [keys]}


def test_a_scene_tells_stories_of_its_own_and_in_place_of_the_usual() -> None:
    stories = telling(RAIN, RAIN | {"id": "outage"}).stories
    assert stories.keys() == USUAL | {"rain"}
    assert stories["outage"].title == "A shower"
    assert stories["rain"].sets == {"radar": {"weather": {"rain_mm_h": 20.0}}}


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"sensor": "nobody", "set": {"pfa": 1e-4}}, "no sensor has the id 'nobody'"),
        ({"sensor": "radar", "set": {"pfa": 2.0}}, "change[0].set: pfa"),
        ({"sensor": "radar", "set": {"id": "b"}}, "cannot change while the sensor is at work"),
        ({"sensor": "radar"}, "expected set with a sensor"),
        (WET | {"drone": "visitor"}, "expected either sensor or drone"),
        ({"drone": "visitor"}, "expected contingency or claim with a drone"),
        ({"drone": "nobody", "contingency": {"kind": "hold"}}, "the scene flies no 'nobody'"),
        ({"drone": "visitor", "contingency": {"kind": "hold", "at_s": 3.0}}, "the story begins"),
        ({"drone": "visitor", "claim": {"freeze": True}}, "it is not [cooperative]"),
    ],
)
def test_a_story_that_cannot_be_told_is_refused_by_its_key(
    change: dict[str, Any], why: str
) -> None:
    with pytest.raises(SceneError) as refused:
        telling({"id": "x", "change": [change]})
    assert "story[0]" in str(refused.value)
    assert why in str(refused.value)


def test_a_swarm_of_a_story_has_names_of_its_own_and_waits() -> None:
    fleet = telling(swarm("bees")).fleet
    assert (fleet.names, fleet.waiting_names) == (["visitor"], ["bees-1", "bees-2"])
    for stories, why in (
        ([swarm("visitor")], r"story\[0\]\.swarm\[0\]\.id: .*used twice"),
        ([{"id": "x"}], r"story\[0\].*has changes or swarms"),
        ([RAIN, RAIN], r"story\[1\]\.id: .*used twice"),
    ):
        with pytest.raises(SceneError, match=why):
            telling(*stories)

"""What is asked of sensors, drones and stories in mid-run: what it does to messages, and undo."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
from support.scene_files import radar, scene_text

from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.changes import ControlError, command_of, joined
from plotfeed.feeds.scene.scene import parsed
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS

STORIES = """
[[story]]
id = "late"
title = "All is late"
change = [
    { sensor = "radar", set = { link = { latency_ms = 150.0 } } },
    { sensor = "other", set = { link = { latency_ms = 90.0 } } },
    { drone = "visitor", contingency = { kind = "hold" } },
]
"""
SENSORS = radar(period_s=6.0, sectors=96) + radar("other", period_s=6.0, sectors=96)


class Asked:
    """An engine that is asked something now and then, and what it reports in between."""

    def __init__(self) -> None:
        text = scene_text(sensors=SENSORS, port=1883) + STORIES
        self.scene = parsed(text.encode(), Path("scene.toml"))
        self.engine, self.t_ns = Engine(self.scene, START_NS), START_NS
        self.seen: set[str] = set()

    def say(self, **what: Any) -> dict[str, Any]:
        """What is then in force."""
        return self.engine.obey(command_of(what), self.t_ns)

    def refused(self, words: str, **what: Any) -> None:
        with pytest.raises(ControlError, match=words):
            self.say(**what)

    def next_messages(self) -> dict[str, list[Message]]:
        """Of half a second from now on, by sensor."""
        self.t_ns += NS // 2
        found: dict[str, list[Message]] = defaultdict(list)
        for batch in self.engine.until(self.t_ns):
            for sensor, messages in zip(batch.sectors.sensor, batch.messages, strict=True):
                found[batch.sensors[sensor]] += messages
            self.seen |= {batch.names[drone] for drone in batch.looks.drone}
        return found

    def delays_ms(self) -> dict[str, set[float]]:
        """Of all messages of half a second from now on, by sensor."""
        return {
            sensor: {(one.leaves_utc_ns - one.due_utc_ns) / 1e6 for one in messages}
            for sensor, messages in self.next_messages().items()
        }

    @property
    def controlled(self) -> dict[str, Any]:
        """What control asks of the radar."""
        return dict(joined(self.engine.changes.layers["radar"]))

    @property
    def on(self) -> list[str]:
        """Stories."""
        return [one.id for one, since_ns in self.engine.changes.stories if since_ns is not None]

    @property
    def doing(self) -> str:
        return self.engine.drones.doing("visitor", self.t_ns)

    @property
    def flying(self) -> set[str]:
        trajectories = self.engine.trajectories
        return {trajectories.names[i] for i in trajectories.state_at(self.t_ns).drone}


@pytest.fixture
def asked() -> Asked:
    return Asked()


def test_commands_change_a_sensor_at_once_add_up_and_are_taken_back(asked: Asked) -> None:
    told = asked.say(sensor="radar", set={"link": {"latency_ms": 150}})
    assert told["link"] == {"latency_ms": 150}
    assert asked.delays_ms() == {"radar": {150.0}, "other": {0.0}}
    told = asked.say(sensor="radar", set={"link": {"loss": {"kind": "random", "probability": 1}}})
    assert told["link"]["latency_ms"] == 150
    assert {one.fate for one in asked.next_messages()["radar"]} == {pb.LOST}
    told = asked.say(sensor="radar", set={"link": None, "pfa": 1e-2})
    assert told["pfa"] == 1e-2
    assert asked.delays_ms()["radar"] == {0.0}
    asked.say(sensor="radar", set={"enabled": False})
    assert asked.controlled == {"link": None, "pfa": 1e-2, "enabled": False}
    assert asked.next_messages().keys() == {"other"}
    asked.say(sensor="radar", reset=True)
    assert (asked.controlled, asked.delays_ms()["radar"]) == ({}, {0.0})
    assert tuple(asked.engine.sensors.sensors) == asked.scene.sensor


def test_a_story_is_told_and_taken_back_to_what_was_before(asked: Asked) -> None:
    asked.say(sensor="radar", set={"link": {"latency_ms": 40}})
    assert asked.say(story="late")["stories"] == ["late"]
    assert asked.controlled == {"link": {"latency_ms": 150.0}}
    assert asked.delays_ms() == {"radar": {150.0}, "other": {90.0}}
    assert asked.doing == "hold"
    asked.say(story="outage")
    assert asked.controlled == {"link": {"latency_ms": 150.0, "down": True}}
    assert {one.fate for one in asked.next_messages()["radar"]} == {pb.OUTAGE}
    assert asked.on == ["outage", "late"]
    asked.refused("'late' is on already", story="late")
    asked.refused("there is no 'tea'; expected one of bad-link", story="tea")
    asked.say(sensor="radar", set={"pfa": 1e-4})  # in the midst of them
    asked.say(story="late", reset=True)
    assert asked.controlled == {"link": {"latency_ms": 40, "down": True}, "pfa": 1e-4}
    assert asked.delays_ms()["other"] == {0.0}
    assert asked.doing != "hold"
    asked.refused("'late' is not on", story="late", reset=True)
    asked.say(story="outage", reset=True)
    assert asked.say(sensor="radar", set={"pfa": None})["link"] == {"latency_ms": 40}
    assert asked.delays_ms()["radar"] == {40.0}
    asked.say(story="late")
    asked.say(sensor="radar", reset=True)  # the story's, too
    assert (asked.controlled, asked.on) == ({}, ["late"])
    asked.say(story="late", reset=True)
    assert tuple(asked.engine.sensors.sensors) == asked.scene.sensor


def test_a_swarm_is_there_for_as_long_as_its_story(asked: Asked) -> None:
    swarm = {f"story-swarm-{n}" for n in range(1, 13)}

    def flies_when(there: bool, **what: Any) -> None:
        asked.say(**what)
        asked.seen.clear()
        for _ in range(60):
            asked.next_messages()
        assert asked.flying == ({"visitor"} | swarm if there else {"visitor"})
        assert bool(asked.seen & swarm) == there

    for _ in range(2):  # and again
        flies_when(True, story="swarm")
        flies_when(False, story="swarm", reset=True)
    flies_when(True, undo=True)
    flies_when(False, undo=True)


def test_undo_takes_back_one_change_after_the_other(asked: Asked) -> None:
    asked.refused("undo: nothing was asked", undo=True)
    steps: list[dict[str, Any]] = [
        {"sensor": "radar", "set": {"pfa": 1e-4}},
        {"story": "late"},
        {"sensor": "radar", "set": {"link": {"latency_ms": 10}}},
        {"story": "late", "reset": True},
        {"story": "late"},
        {"sensor": "radar", "reset": True},
    ]
    before = []
    for step in steps:
        before.append((asked.controlled, asked.on))
        asked.say(**step)
    assert asked.engine.changes.undoes == "radar: as in the scene"
    for controlled, on in reversed(before):
        asked.say(undo=True)
        assert (asked.controlled, asked.on) == (controlled, on)
    asked.refused("undo: nothing was asked", undo=True)
    assert asked.delays_ms() == {"radar": {0.0}, "other": {0.0}}


def test_a_story_is_over_with_the_last_of_its_keys_and_on_again_with_the_undo(asked: Asked) -> None:
    asked.say(story="outage")
    for sensor in ("other", "radar"):
        asked.say(sensor=sensor, reset=True)
    assert asked.on == []
    asked.say(undo=True)
    assert asked.on == ["outage"]

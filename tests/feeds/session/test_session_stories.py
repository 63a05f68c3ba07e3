"""Stories and undo over a real broker: what they do to messages, and that all is as before."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
from support.brokers import free_port, own_broker
from support.scene_files import radar, scene_file, scene_text
from support.sessions import AtWork, at_work
from support.waiting import until

from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.testing import MqttMessage, MqttReceiver

MS = 1_000_000
CONTROL, SETTINGS, ERRORS = "plotfeed/control", "plotfeed/radar/settings", "plotfeed/errors"
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


def scene(folder: Path) -> Scene:
    sensors = radar(period_s=6.0, sectors=96) + radar("other", period_s=6.0, sectors=96)
    text = scene_text(sensors=sensors, mqtt="truth = false", port=1883)
    return load(scene_file(folder, text + STORIES))


class Storyteller:
    """Says something on the control topic, and hears what is in force of the radar then."""

    def __init__(self, ears: MqttReceiver, session: AtWork) -> None:
        self.ears, self.session = ears, session

    async def say(self, **what: Any) -> dict[str, Any]:
        await asyncio.to_thread(self.ears.wait_for, is_settings)
        since = len(self.ears.heard)
        self.ears.publish(CONTROL, json.dumps(what).encode())
        heard = await asyncio.to_thread(self.ears.wait_for, is_settings, since)
        told: dict[str, Any] = json.loads(heard.payload)
        return told

    async def refused(self, words: str, **what: Any) -> None:
        before = len(self.ears.on(ERRORS))
        self.ears.publish(CONTROL, json.dumps(what).encode())
        await until(lambda: len(self.ears.on(ERRORS)) > before)
        assert words in json.loads(self.ears.on(ERRORS)[-1])["detail"]

    async def next_messages(self, sensor: str = "radar") -> list[pb.Sent]:
        """What the ledger says of sectors that end from now on."""
        since_ns = self.session.clock.now_ns() + 70 * MS  # one may be worked out already

        def found() -> list[pb.Sent]:
            mine = (entry for entry in self.session.entries if entry.sensor == sensor)
            return [m for entry in mine for m in entry.messages if m.due_utc_ns > since_ns]

        await until(lambda: len(found()) >= 4)
        return found()

    def on(self) -> list[str]:
        states = self.session.session.changes.stories
        return [story.id for story, since_utc_ns in states if since_utc_ns is not None]


def is_settings(message: MqttMessage) -> bool:
    return message.topic == SETTINGS


def delays_ns(messages: list[pb.Sent]) -> set[int]:
    return {one.link_due_utc_ns - one.due_utc_ns for one in messages}


@pytest.mark.asyncio
async def test_a_story_is_told_on_the_wire_and_taken_back_to_what_was_before(
    tmp_path: Path,
) -> None:
    port = free_port()
    with own_broker(tmp_path, port), MqttReceiver(port, 5, "plotfeed/#") as ears:
        async with at_work(scene(tmp_path), port) as session:
            teller = Storyteller(ears, session)
            before = await teller.say(sensor="radar", set={"link": {"latency_ms": 40}})
            told = await teller.say(story="late")
            assert told["controlled"] == {"link": {"latency_ms": 150.0}}
            assert delays_ns(await teller.next_messages()) == {150 * MS}
            assert delays_ns(await teller.next_messages("other")) == {90 * MS}
            doing = session.session.engine.drones.doing
            assert doing("visitor", session.clock.now_ns()) == "hold"
            told = await teller.say(story="outage")
            assert told["controlled"] == {"link": {"latency_ms": 150.0, "down": True}}
            assert {one.fate for one in await teller.next_messages()} == {pb.OUTAGE}
            assert teller.on() == ["outage", "late"]
            await teller.refused("'late' is on already", story="late")
            await teller.refused("there is no 'tea'; expected one of bad-link", story="tea")
            told = await teller.say(sensor="radar", set={"pfa": 1e-4})  # in the midst of them
            told = await teller.say(story="late", reset=True)
            assert told["controlled"] == {"link": {"latency_ms": 40, "down": True}, "pfa": 1e-4}
            assert delays_ns(await teller.next_messages("other")) == {0}
            assert doing("visitor", session.clock.now_ns()) != "hold"
            await teller.refused("'late' is not on", story="late", reset=True)
            await teller.say(story="outage", reset=True)
            told = await teller.say(sensor="radar", set={"pfa": None})
            assert told["in_force"].items() >= {"link": before["in_force"]["link"]}.items()
            assert delays_ns(await teller.next_messages()) == {40 * MS}
            await teller.say(story="late")
            told = await teller.say(sensor="radar", reset=True)  # the story's, too
            assert (told["controlled"], teller.on()) == ({}, ["late"])
            await teller.say(story="late", reset=True)
            scene_now = session.session.scene.sensor
            assert tuple(t.sensor for t in session.session.sensors.values()) == scene_now
    assert session.totals.refused == 3


@pytest.mark.asyncio
async def test_a_swarm_is_there_for_as_long_as_its_story(tmp_path: Path) -> None:
    port = free_port()
    with own_broker(tmp_path, port), MqttReceiver(port, 5, ERRORS) as ears:
        async with at_work(scene(tmp_path), port) as session:
            trajectories = session.session.trajectories

            def flying() -> set[str]:
                drones = trajectories.state_at(session.clock.now_ns()).drone.tolist()
                return {trajectories.names[drone] for drone in drones}

            def seen() -> set[str]:
                return {look.drone for entry in session.entries[-96:] for look in entry.looks}

            swarm = {f"story-swarm-{n}" for n in range(1, 13)}
            for _ in range(2):  # and again
                ears.publish(CONTROL, b'{"story": "swarm"}')
                await until(lambda: flying() == swarm | {"visitor"})
                await until(lambda: seen() & swarm)
                ears.publish(CONTROL, b'{"story": "swarm", "reset": true}')
                await until(lambda: flying() == {"visitor"})
                session.entries.clear()
            ears.publish(CONTROL, b'{"undo": true}')
            await until(lambda: flying() == swarm | {"visitor"})
            ears.publish(CONTROL, b'{"undo": true}')
            await until(lambda: flying() == {"visitor"})
    assert not ears.on(ERRORS)


@pytest.mark.asyncio
async def test_undo_takes_back_one_change_after_the_other(tmp_path: Path) -> None:
    port = free_port()
    with own_broker(tmp_path, port), MqttReceiver(port, 5, "plotfeed/#") as ears:
        async with at_work(scene(tmp_path), port) as session:
            teller = Storyteller(ears, session)
            await teller.refused("undo: nothing was asked", undo=True)
            steps: list[dict[str, Any]] = [
                {"sensor": "radar", "set": {"pfa": 1e-4}},
                {"story": "late"},
                {"sensor": "radar", "set": {"link": {"latency_ms": 10}}},
                {"story": "late", "reset": True},
                {"story": "late"},
                {"sensor": "radar", "reset": True},
            ]
            told, on = [{}], [teller.on()]
            for step in steps:
                told.append((await teller.say(**step))["controlled"])
                on.append(teller.on())
            words = session.session.changes.undoes
            assert words == "radar: as in the scene"
            for before, on_before in zip(told[-2::-1], on[-2::-1], strict=True):
                assert (await teller.say(undo=True))["controlled"] == before
                assert teller.on() == on_before
            await teller.refused("undo: nothing was asked", undo=True)
            assert delays_ns(await teller.next_messages("other")) == {0}

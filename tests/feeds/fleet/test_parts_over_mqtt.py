"""The parts of a scene over a broker: the bytes of one process, one sender at a time, gaps told."""

from __future__ import annotations

import asyncio
import json
from collections import defaultdict
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from support.brokers import free_port, mosquitto, own_broker, quiet_mosquitto
from support.fleets import Verdict, by_topic, judged, reference, stateless
from support.servers import Proxy, proxied
from support.sessions import AtWork, Start
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.fleet import part_hold
from plotfeed.feeds.fleet.part_hold import NOT_HELD, BrokerHold, PartTakenError, run_part
from plotfeed.feeds.fleet.parts import partition
from plotfeed.feeds.scene.scene import Scene, example
from plotfeed.feeds.session import session
from plotfeed.feeds.session.part import SessionPart
from plotfeed.feeds.timing.clock import InstantClock, WallClock
from plotfeed.feeds.transport.mqtt.connection import MqttError
from plotfeed.proto.utc import NS, utc_ns
from plotfeed.testing import START_NS, MqttMessage, MqttReceiver, fly


@pytest.fixture(autouse=True)
def _hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who is silent for a second has died; a process that stalls itself counts none of that."""
    for name, seconds in (("SAY_EVERY_S", 0.1), ("LEASE_S", 0.6), ("PATIENCE_S", 0.9)):
        monkeypatch.setattr(part_hold, name, seconds)
    monkeypatch.setattr(part_hold, "NEWS_S", 0.2)


@pytest.mark.asyncio
async def test_the_parts_of_a_shipped_scene_send_what_one_process_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its links, which lose and delay, among them; a broker's connections, simulated time."""
    monkeypatch.setattr(part_hold, "LEASE_S", PATIENCE_S)  # a machine that stalls loses no lease
    scene, port, duration_s = example("field-day"), free_port(), 12.0
    parts = partition(scene, 3)
    with quiet_mosquitto(tmp_path, port), MqttReceiver(port, 5, "plotfeed/#") as client:
        sent = await asyncio.to_thread(lambda: fly(scene, duration_s).messages)
        whole = by_topic(sent)
        sessions = [
            run_part(
                SessionPart(number=k, parts=3, sensors=sensors, began_utc_ns=START_NS),
                scene=scene,
                clock=InstantClock(START_NS - NS),
                broker=f"mqtt://127.0.0.1:{port}",
                duration_s=duration_s,
            )
            for k, sensors in enumerate(parts, 1)
        ]
        await asyncio.gather(*sessions)
        messages = sum(map(len, whole.values()))

        def ended() -> bool:
            """All of them have, and all has come."""
            last = {m.topic: m.payload for m in [*client.heard] if "/fleet/" in m.topic}
            states = [json.loads(last[f"plotfeed/fleet/{k}"])["state"] for k in (1, 2, 3)]
            heard = sum(m.topic in whole for m in [*client.heard])
            return states == ["ENDED"] * 3 and heard >= messages

        await until(ended)
    heard = defaultdict(list)
    for message in client.heard:
        if message.topic in whole:
            heard[message.topic].append(message.payload)
    assert messages > 400
    assert heard == whole
    assert not any(message.topic.endswith("/gaps") for message in client.heard)


def only_part(scene: Scene, began_ns: int = START_NS) -> SessionPart:
    """Of all sensors."""
    return SessionPart(sensors=tuple(s.id for s in scene.sensor), began_utc_ns=began_ns)


@pytest.mark.asyncio
async def test_a_part_that_may_not_read_its_own_status_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "FIRST_CONNECTION_S", 1.0)
    scene, port = example("valley"), free_port()
    rights = tmp_path / "rights"
    rights.write_text("topic write plotfeed/#\n")
    rights.chmod(0o700)
    settings = f"listener {port} 127.0.0.1\nallow_anonymous true\nacl_file {rights}\n"
    told = "nothing comes back from plotfeed/fleet/1: does its access"
    how = {"clock": WallClock(), "broker": f"mqtt://127.0.0.1:{port}"}
    with mosquitto(tmp_path, port, settings), pytest.raises(MqttError, match=told):
        await run_part(only_part(scene), scene=scene, **how)


@dataclass
class Process:
    """A session of the one part that there is, as of a process of its own."""

    watch: AtWork
    stop: asyncio.Event
    task: asyncio.Task[Any]


@dataclass
class Part:
    """A scene as one part, by as many processes as want to run it; and what is heard."""

    scene: Scene
    port: int
    client: MqttReceiver
    network: Proxy  # What lies between the first process and the broker
    began_ns: int
    processes: list[Process] = field(default_factory=list)

    def another(self) -> Process:
        """One more."""
        clock, stop = WallClock(), asyncio.Event()
        watch = AtWork(clock)
        broker = f"mqtt://127.0.0.1:{self.port if self.processes else self.network.port}"
        how = {"clock": clock, "broker": broker, "stop": stop, "observers": [watch]}
        work = run_part(only_part(self.scene, self.began_ns), scene=self.scene, **how)
        self.processes.append(Process(watch, stop, asyncio.create_task(work)))
        return self.processes[-1]

    def said(self, level: str = "") -> list[Any]:
        """What was said of the part, one after the other."""
        topic = f"plotfeed/fleet/1{level}"
        return [json.loads(m.payload) for m in [*self.client.heard] if m.topic == topic]

    def states(self, topic: str = "plotfeed/fleet/1/session") -> list[str]:
        """What was said there of how somebody is, one after the other."""
        heard = [json.loads(m.payload) for m in [*self.client.heard] if m.topic == topic]
        return [told["state"] for told in heard]

    async def sends(self, claim: int) -> None:
        """A process that has that claim does."""
        running = (claim, "RUNNING")
        await until(lambda: any((t["claim"], t["state"]) == running for t in self.said()))
        await self.more()

    async def more(self) -> None:
        since, reports = len(self.client.heard), f"plotfeed/{self.scene.sensor[0].id}/asterix"
        await until(lambda: any(m.topic.startswith(reports) for m in self.client.heard[since:]))

    def verdict(self) -> Verdict:
        duration_s = (WallClock().now_ns() - self.began_ns) / NS + 1
        wanted = reference(self.scene, self.began_ns, duration_s)
        topics, heard = {m.topic for m in wanted}, defaultdict(list)
        for message in self.client.heard:
            if message.topic in topics:
                heard[message.topic].append(message.payload)
        return judged(wanted, heard, (self.said("/gaps") or [[]])[-1])


@asynccontextmanager
async def a_part(folder: Path, start: Start = quiet_mosquitto) -> AsyncIterator[Part]:
    """At the end: nothing twice, nothing foreign, and what is missing is told."""
    port = free_port()
    with start(folder, port), MqttReceiver(port, 5, "plotfeed/#") as client:
        async with proxied(port) as network:
            began_ns = WallClock().now_ns() + NS // 2
            part = Part(stateless(), port, client, network, began_ns)
            try:
                yield part
            finally:
                for process in part.processes:
                    process.stop.set()
                tasks = [each.task for each in part.processes]
                await asyncio.gather(*tasks, return_exceptions=True)
        ended = [each for each in part.processes if each.task.exception() is None]
        await until(lambda: not ended or part.said()[-1]["state"] == "ENDED")
        verdict = await asyncio.to_thread(part.verdict)
    assert (verdict.twice, verdict.foreign_topics, verdict.disordered) == (0, set(), 0)
    assert not verdict.missing
    assert verdict.heard
    # By QoS 1, who was cut off would say once more what another has said otherwise since.
    of_part = [m for m in part.client.heard if m.topic.startswith("plotfeed/fleet/1")]
    assert {m.qos for m in of_part if not m.topic.endswith("/session")} == {0}
    for before, told in pairwise(part.said()):  # no more was sent than when the last came back
        if before["process"] == told["process"]:
            then_ns = max(utc_ns(before["time_utc"]) or 0, part.began_ns)
            assert told["sent_until_utc_ns"] <= then_ns


async def taken_from(process: Process) -> None:
    with pytest.raises(PartTakenError, match="has taken it over"):
        await process.task


@pytest.mark.asyncio
async def test_who_stands_by_goes_on_when_the_will_of_who_sent_says_that_it_died(
    tmp_path: Path,
) -> None:
    """The network of one is cut off for good: that is what a broker sees of a dead process."""
    async with a_part(tmp_path, own_broker) as part:
        first = part.another()
        await part.sends(1)
        second = part.another()
        await until(lambda: len(part.said()) > 4 and not second.watch.begins.is_set())
        part.network.is_closed = True
        part.network.cut()
        await part.sends(2)
        await until(lambda: part.states() == ["RUNNING", "DIED", "RUNNING"])
        status = f"plotfeed/{part.scene.sensor[0].id}/status"
        await until(lambda: part.states(status)[-1] == "ONLINE")
        part.network.is_closed = False
        await taken_from(first)


@pytest.mark.asyncio
async def test_who_is_cut_off_sends_nothing_by_any_way_until_it_is_heard_again(
    tmp_path: Path,
) -> None:
    """Nobody is there to go on: then it does so itself, and tells what is missing."""
    async with a_part(tmp_path) as part:
        only = part.another()
        await part.sends(1)
        part.network.is_closed = True
        part.network.cut()
        await until(lambda: only.watch.totals.undelivered_to[NOT_HELD] > 3)
        part.network.is_closed = False
        await until(lambda: part.said("/gaps"))
        await part.more()
        assert part.said()[-1]["claim"] == 1


@pytest.mark.asyncio
async def test_who_wakes_up_when_another_has_its_part_ends_and_takes_nothing_back(
    tmp_path: Path,
) -> None:
    """What it sends while its network holds everything back goes nowhere, when that lets go too."""
    async with a_part(tmp_path) as part:
        first = part.another()
        await part.sends(1)
        part.another()
        await until(lambda: len(part.said()) > 4)
        part.network.hold()
        await part.sends(2)
        for wire in part.network._wires:
            wire.open.set()
        await taken_from(first)
        await part.more()
        await until(lambda: {told["claim"] for told in part.said()[-2:]} == {2})


def is_running(message: MqttMessage) -> bool:
    """A part says that it does."""
    told = json.loads(message.payload) if message.topic == "plotfeed/fleet/1" else {}
    return bool(told.get("state") == "RUNNING")


@pytest.mark.parametrize("stalls", [False, True])
@pytest.mark.asyncio
async def test_who_joins_late_has_told_what_is_missing_before_it_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stalls: bool
) -> None:
    """So that it is known even if that process dies at once; also where it stalls as it joins."""
    monkeypatch.setattr(part_hold, "LEASE_S", PATIENCE_S)  # else a machine that stalls loses it
    begin = BrokerHold.begin

    def begins(hold: BrokerHold) -> None:
        hold._until_s = float("-inf") if stalls else hold._until_s
        begin(hold)

    monkeypatch.setattr(BrokerHold, "begin", begins)
    async with a_part(tmp_path) as part:
        await asyncio.sleep(1.0)
        # It hears little else: of much by QoS 1, a broker has some wait while QoS 0 goes on.
        with MqttReceiver(part.port, 5, "plotfeed/fleet/#") as ears:
            part.another()
            runs = await asyncio.to_thread(ears.wait_for, is_running)
            said = ears.heard[: ears.heard.index(runs)]
        await part.more()
        gap, *_ = next(json.loads(m.payload) for m in said if m.topic.endswith("/gaps"))
    assert (gap["from_utc_ns"], gap["why"]) == (part.began_ns, "nobody had begun")


@pytest.mark.asyncio
async def test_of_two_that_begin_together_one_sends(tmp_path: Path) -> None:
    async with a_part(tmp_path) as part:
        both = [part.another(), part.another()]
        await part.sends(1)
        # Who said it later has ended, or stands by if it had heard the other before.
        await until(lambda: sum(e.watch.begins.is_set() and not e.task.done() for e in both) == 1)
        await until(lambda: len({told["process"] for told in part.said()[-4:]}) == 1)
        await part.more()


@pytest.mark.asyncio
async def test_what_ends_in_order_is_ended_and_who_begins_anew_goes_on(tmp_path: Path) -> None:
    """As where every process of a fleet is started anew; what was told before is told on."""
    async with a_part(tmp_path) as part:
        await asyncio.sleep(1.0)
        first = part.another()
        await part.sends(1)
        first.stop.set()
        await first.task
        await until(lambda: part.said()[-1]["state"] == "ENDED")
        await until(lambda: part.states() == ["RUNNING", "ENDED"])
        part.another()
        await part.sends(2)
        told = part.said("/gaps")[-1]
        (gap,) = [each for each in told if each["why"].endswith("no longer sends")]
        assert gap["to_utc_ns"] > gap["from_utc_ns"]
        assert "nobody had begun" in [each["why"] for each in told]

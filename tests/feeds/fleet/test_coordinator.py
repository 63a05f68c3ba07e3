"""Who looks after a fleet: dead and silent workers are replaced, and sensors change hands.

In real time, on a machine that may be slow: scans that it leaves out are gaps that are told.
"""

from __future__ import annotations

import asyncio
import json
from collections import defaultdict
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from support.brokers import free_port
from support.fleet_oracle import judged, reference
from support.fleet_scenes import stateless
from support.mqtt_client import Client, listening
from support.road import NS
from support.sessions import quiet_mosquitto
from support.waiting import until

from plotfeed.feeds.fleet.coordinator import Coordinator
from plotfeed.feeds.fleet.fleet_link import FleetLink, health
from plotfeed.feeds.fleet.fleet_parts import LATE, FleetSettings, Gaps, PartHeld, WorkerDiedError
from plotfeed.feeds.fleet.part_server import PartServer
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.outputs import broker_address
from plotfeed.feeds.transport.leased import NO_LEASE


class Here:
    """A worker in this process, which can die, or answer nothing."""

    def __init__(self, number: int) -> None:
        self.name = f"here:{number}"
        self.server = PartServer(self.name)
        self.is_dead = self.has_left = False
        self.answers = asyncio.Event()
        self.answers.set()
        self._calls: set[asyncio.Task[Any]] = set()

    def __getattr__(self, method: str) -> Any:
        async def call(*words: Any) -> Any:
            if method != "serve":
                await self.answers.wait()
            if self.is_dead:
                raise WorkerDiedError
            task = asyncio.create_task(getattr(self.server, method)(*words))
            self._calls.add(task)
            try:
                found = await task
            except asyncio.CancelledError:
                if self.is_dead:
                    raise WorkerDiedError from None
                raise
            if method != "serve":
                await self.answers.wait()
            return found

        return call

    def die(self) -> None:
        self.is_dead = True
        for task in self._calls:
            task.cancel()

    def leave(self) -> None:
        self.has_left = True


class Fleet:
    """One of workers in this process, over a broker."""

    def __init__(
        self, port: int, client: Client, workers: int, made: Scene, **settings: Any
    ) -> None:
        self.scene = made
        self.broker = f"mqtt://127.0.0.1:{port}"
        self.workers: list[Here] = []
        asked = {"lease_s": 30.0} | settings
        self.at_work = Coordinator(
            made, FleetSettings(workers=workers, broker=self.broker, **asked), self.another
        )
        self.client = client

    async def another(self) -> Here:
        self.workers.append(Here(len(self.workers)))
        return self.workers[-1]

    def worker_of(self, part: int) -> Here:
        found = self.at_work.parts[part].worker
        assert isinstance(found, Here)
        return found

    async def sends(self) -> None:
        """All parts do."""
        await until(lambda: self.at_work.parts and all(p.joined_utc_ns for p in self.at_work.parts))
        for part in self.at_work.parts:
            await self.more_of(part.sensors[0])

    async def more_of(self, sensor: str) -> None:
        since = len(self.client.heard)
        await until(
            lambda: any(
                m.topic.startswith((f"plotfeed/{sensor}/asterix", f"plotfeed/{sensor}/plots"))
                for m in self.client.heard[since:]
            ),
            f"nothing of {sensor}",
        )

    async def verdict(self) -> Any:
        return await asyncio.to_thread(self._verdict)

    def _verdict(self) -> Any:
        began_ns = self.at_work.began_utc_ns
        duration_s = (self.at_work.now_utc_ns - began_ns) / NS + 1
        wanted = reference(self.scene, began_ns, duration_s)
        topics, heard = {m.topic for m in wanted}, defaultdict(list)
        for message in self.client.heard:
            if message.topic in topics:
                heard[message.topic].append(message.payload)
        return judged(wanted, heard, health(self.at_work)["gaps"])


@asynccontextmanager
async def fleet(
    folder: Path, workers: int, made: Scene | None = None, **settings: Any
) -> AsyncIterator[Fleet]:
    port, stop = free_port(), asyncio.Event()
    with quiet_mosquitto(folder, port), listening(port, 5, "plotfeed/#") as client:
        found = Fleet(port, client, workers, made or stateless(), **settings)
        running = asyncio.create_task(found.at_work.run(stop))
        try:
            await found.sends()
            yield found
        finally:
            for worker in found.workers:
                worker.answers.set()
            stop.set()
            await running
        verdict = await found.verdict()
        assert (verdict.twice, verdict.foreign_topics) == (0, set())
        assert not verdict.missing
        assert verdict.disordered == 0
        assert verdict.heard


@pytest.mark.asyncio
async def test_another_goes_on_with_the_sensors_of_who_died(tmp_path: Path) -> None:
    async with fleet(tmp_path, 2) as found:
        dead = found.worker_of(1)
        dead.die()
        await until(lambda: found.at_work.takeovers == 1)
        await found.sends()
        assert found.worker_of(1) is not dead
        (gap,) = [each for each in found.at_work.gaps if each.why.endswith(" died")]
        assert gap.sensors == found.at_work.parts[1].sensors
        assert gap.to_utc_ns == found.at_work.parts[1].joined_utc_ns > gap.from_utc_ns
        await until(lambda: len(found.workers) == 4)  # two, who took over, and the next to


@pytest.mark.asyncio
async def test_who_answers_nothing_loses_its_sensors_and_is_a_spare_when_it_is_back(
    tmp_path: Path,
) -> None:
    """It is still connected, and sends nothing any more: another has its client id."""
    async with fleet(tmp_path, 2, lease_s=2.0) as found:
        silent = found.worker_of(0)
        silent.answers.clear()
        await until(lambda: found.at_work.takeovers > 0)
        await until(lambda: found.at_work.parts[0].worker not in (None, silent))
        await found.sends()
        silent.answers.set()
        holders = [part.worker for part in found.at_work.parts]
        await until(lambda: silent in found.at_work._idle or silent in holders or silent.has_left)


@pytest.mark.asyncio
async def test_a_fleet_says_over_mqtt_how_it_does(tmp_path: Path) -> None:
    async with fleet(tmp_path, 2) as found:
        link = FleetLink(found.at_work, broker_address(stateless(), found.broker))
        async with link.link.connected(60.0):
            saying = asyncio.create_task(link.run())

            def told() -> dict[str, Any]:
                heard = [m.payload for m in found.client.heard if m.topic == "plotfeed/fleet"]
                return dict(json.loads(heard[-1])) if heard else {"parts": ()}

            await until(lambda: [p["sends"] for p in told()["parts"]] == [True, True])
            assert sum(len(p["sensors"]) for p in told()["parts"]) == len(stateless().sensor)
            saying.cancel()
            await asyncio.gather(saying, return_exceptions=True)
            await until(lambda: told()["state"] == "ENDED")


@pytest.mark.asyncio
async def test_what_a_holder_cannot_send_is_a_gap_that_is_told(tmp_path: Path) -> None:
    """As one that was frozen for less than its lease, which has lapsed when it wakes."""
    async with fleet(tmp_path, 1) as found:
        (served,) = found.worker_of(0).server._served.values()
        lease, session = served.result().lease, served.result().session
        assert session is not None
        lease._until_s = float("-inf")
        await until(lambda: session.totals.undelivered_to[NO_LEASE] > 3)
        lease._wanted.set()
        await until(lambda: any(gap.why.endswith(LATE) for gap in found.at_work.gaps))
        await found.sends()


def test_gaps_of_a_holder_that_stays_late_are_one() -> None:
    part, gaps = PartHeld("0", ("a", "b", "c"), True, "beginning", NS), Gaps()
    gaps.leave_out(part, "w", {})
    assert not gaps
    gaps.leave_out(part, "w", {"c": (5 * NS, 6 * NS)})
    gaps.leave_out(part, "w", {"a": (6 * NS, 7 * NS), "c": (6 * NS, 8 * NS)})
    (gap,) = gaps
    assert (gap.sensors, gap.why) == (("a", "c"), f"w {LATE}")
    assert (gap.from_utc_ns, gap.to_utc_ns) == (5 * NS - 1, 8 * NS)
    gaps.leave_out(part, "w", {"a": (20 * NS, 21 * NS)})
    part.sent_until_utc_ns = 30 * NS
    for why in ("w died", "v failed"):
        gaps.begin(part, why)
    assert [each.to_utc_ns for each in gaps] == [8 * NS, 21 * NS, None]
    part.joined_utc_ns = 40 * NS
    gaps.end(part)
    assert (gaps[-1].why, gaps[-1].from_utc_ns, gaps[-1].to_utc_ns) == ("w died", 30 * NS, 40 * NS)

"""Sessions in the test's own event loop, over a real broker or in simulated time, seen within."""

from __future__ import annotations

import asyncio
import json
import subprocess
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractContextManager, asynccontextmanager
from pathlib import Path
from typing import Any

from support.waiting import until

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import Session, run
from plotfeed.feeds.timing.clock import Clock, InstantClock, WallClock
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import entries_in
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS

Start = Callable[[Path, int], AbstractContextManager["subprocess.Popen[bytes]"]]
Asked = tuple[float, str, bytes]  # Seconds after the beginning, a topic and what is said on it


class StallingClock(InstantClock):
    """The machine stands still for a while, once."""

    leaps = False

    def __init__(self, start_utc_ns: int, after_s: float, for_s: float) -> None:
        super().__init__(start_utc_ns)
        self.stall_ns, self.for_ns = start_utc_ns + round(after_s * NS), round(for_s * NS)

    async def sleep_until(self, t_utc_ns: int, *, exactly: bool = True) -> None:
        await super().sleep_until(t_utc_ns, exactly=exactly)
        if self.for_ns and t_utc_ns >= self.stall_ns:
            await super().sleep_until(t_utc_ns + self.for_ns)
            self.for_ns = 0


class AtWork(Observer):
    """What can be seen of it, and what it is asked meanwhile."""

    session: Session
    totals: SessionCounters

    def __init__(self, clock: Clock, asked: Sequence[Asked] = ()) -> None:
        self.clock, self.start_ns = clock, clock.now_ns()
        self.begins = asyncio.Event()
        self.sectors: list[Batch] = []
        self.settled_as: list[Sensor] = []  # Sensors as they are from some time on
        self.said: list[tuple[Message, int]] = []  # Messages, and when they left
        self.received_on: list[str] = []  # Topics of what was taken out of the queue
        self.most_waiting = 0  # Waiting in the queue, whenever a sector was reported
        self._asked = [(self.start_ns + round(s * NS), topic, said) for s, topic, said in asked]
        self._ledgers: list[bytes] = []
        self._entries: list[pb.Ledger] = []

    def begun(self, session: Session) -> None:
        self.session, self.totals = session, session.totals
        self.begins.set()

    def next_input_ns(self) -> int | None:
        return self._asked[0][0] if self._asked else None

    def before_due(self, due_utc_ns: int) -> None:
        while self._asked and self._asked[0][0] < due_utc_ns:
            at_ns, topic, payload = self._asked.pop(0)
            self.session.intake.receive([(topic, payload, None)], at_ns)

    def report(self, batch: Batch) -> None:
        self.sectors.append(batch)
        self.most_waiting = max(self.most_waiting, len(self.session.intake))

    def settings(self, sensor: Sensor) -> None:
        self.settled_as.append(sensor)

    def received(self, topic: str, *_: object) -> None:
        self.received_on.append(topic)

    def after_link(self, message: Message, sent_utc_ns: int) -> None:
        self.said.append((message, sent_utc_ns))

    def ledger(self, message: Message) -> None:
        self._ledgers.append(message.payload)

    @property
    def taken(self) -> int:
        """Messages taken out of the queue: telemetry and commands, accepted or not."""
        return len(self.received_on)

    @property
    def entries(self) -> list[pb.Ledger]:
        """Of the ledger."""
        payloads, self._ledgers = self._ledgers, []
        self._entries += [entry for payload in payloads for entry in entries_in(payload)]
        return self._entries

    @property
    def sent(self) -> list[pb.Sent]:
        """What the ledger tells of messages."""
        return [one for entry in self.entries for one in entry.messages]

    @property
    def reported(self) -> dict[str, list[bytes]]:
        """What trackers get, by topic, in its order."""
        found: dict[str, list[bytes]] = {}
        for message, _ in self.said:
            if "/asterix/" in message.topic or message.topic.endswith("/plots"):
                found.setdefault(message.topic, []).append(message.payload)
        return found

    def on(self, topic: str) -> list[bytes]:
        """Payloads on a topic, behind the prefix."""
        return [m.payload for m, _ in self.said if m.topic == f"plotfeed/{topic}"]

    def told(self, topic: str) -> list[dict[str, Any]]:
        """What was said in JSON on a topic."""
        return [json.loads(payload) for payload in self.on(topic)]

    async def sectors_more(self, number: int) -> None:
        """It goes on reporting."""
        wanted = len(self.sectors) + number
        await until(lambda: len(self.sectors) >= wanted)


def simulated(
    scene: Scene,
    for_s: float | None,
    asked: Sequence[Asked] = (),
    *more: Observer,
    clock: Clock | None = None,
) -> AtWork:
    """A session that is over, in simulated time unless a clock is given."""
    watch = AtWork(clock or InstantClock(scene.scene.start_utc_ns or START_NS), asked)
    running = run(
        scene, clock=watch.clock, broker="none", duration_s=for_s, observers=[watch, *more]
    )
    watch.totals = asyncio.run(running)
    return watch


@asynccontextmanager
async def at_work(
    scene: Scene,
    port: int | None,
    *more: Observer,
    clock: Clock | None = None,
    duration_s: float | None = None,
) -> AsyncIterator[AtWork]:
    """A session over the broker of that port, or none; it is over when this is."""
    clock = clock or WallClock()
    watch, stop = AtWork(clock), asyncio.Event()
    broker = "none" if port is None else f"mqtt://127.0.0.1:{port}"
    observers = [watch, *more]
    running = asyncio.create_task(
        run(
            scene, clock=clock, broker=broker, duration_s=duration_s, stop=stop, observers=observers
        )
    )
    beginning = asyncio.create_task(watch.begins.wait())
    await asyncio.wait({running, beginning}, return_when=asyncio.FIRST_COMPLETED)
    beginning.cancel()
    if running.done():
        running.result()
    try:
        yield watch
    finally:
        if duration_s is None:
            stop.set()
        await running

"""Sessions in the test's own event loop, over a real broker, watched from within."""

from __future__ import annotations

import asyncio
import subprocess
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractContextManager, asynccontextmanager
from pathlib import Path

import pytest
from support.brokers import mosquitto, own_broker
from support.waiting import until

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.observer import Observer, RunningSession
from plotfeed.feeds.session.session import Session, run
from plotfeed.feeds.timing.clock import Clock, InstantClock, WallClock
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import entries_in
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS

Start = Callable[[Path, int], AbstractContextManager["subprocess.Popen[bytes]"]]


def quiet_mosquitto(folder: Path, port: int) -> AbstractContextManager[subprocess.Popen[bytes]]:
    """Whose own queues are not what is tested."""
    listener = f"listener {port} 127.0.0.1\nallow_anonymous true\n"
    return mosquitto(folder, port, f"{listener}max_queued_messages 0\n")


every_broker = pytest.mark.parametrize(
    "start", [quiet_mosquitto, own_broker], ids=["mosquitto", "embedded"]
)


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
    """What can be seen of it."""

    session: Session
    totals: SessionCounters

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.begins = asyncio.Event()
        self.sectors: list[Batch] = []
        self.entries: list[pb.Ledger] = []
        self.taken = 0  # Messages taken out of the queue: telemetry and commands, accepted or not
        self.most_waiting = 0  # Waiting in the queue, whenever a sector was reported

    def begun(self, session: Session) -> None:
        self.session, self.totals = session, session.totals
        self.begins.set()

    def report(self, report: Batch) -> None:
        self.sectors.append(report)
        self.most_waiting = max(self.most_waiting, len(self.session.intake))

    def received(self, *_: object) -> None:
        self.taken += 1

    def ledger(self, message: Message) -> None:
        self.entries += entries_in(message.payload)

    @property
    def sent(self) -> list[pb.Sent]:
        """What the ledger tells of messages."""
        return [one for entry in self.entries for one in entry.messages]

    async def sectors_more(self, number: int) -> None:
        """It goes on reporting."""
        wanted = len(self.sectors) + number
        await until(lambda: len(self.sectors) >= wanted)


Asked = tuple[float, str, bytes]  # Seconds after the beginning, a topic and what is said on it


class Asks(Observer):
    """Hands a session that begins at `road.START_NS` what it is asked, each at its time."""

    def __init__(self, asked: Sequence[Asked]) -> None:
        self._asked = [(START_NS + round(s * 1e9), topic, said) for s, topic, said in asked]
        self._session: RunningSession | None = None

    def begun(self, session: RunningSession) -> None:
        self._session = session

    def next_input_ns(self) -> int | None:
        return self._asked[0][0] if self._asked else None

    def before_due(self, due_utc_ns: int) -> None:
        while self._asked and self._asked[0][0] < due_utc_ns:
            assert self._session is not None
            at_ns, topic, payload = self._asked.pop(0)
            self._session.receive([(topic, payload, None)], at_ns)


@asynccontextmanager
async def at_work(
    scene: Scene, port: int | None, *, clock: Clock | None = None, duration_s: float | None = None
) -> AsyncIterator[AtWork]:
    """A session over the broker of that port, or none; it is over when this is."""
    clock = clock or WallClock()
    watch, stop = AtWork(clock), asyncio.Event()
    broker = "none" if port is None else f"mqtt://127.0.0.1:{port}"
    running = asyncio.create_task(
        run(scene, clock=clock, broker=broker, duration_s=duration_s, stop=stop, observers=[watch])
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

"""A worker: it runs parts of scenes as it is told, and sends only while it holds their leases."""

from __future__ import annotations

import asyncio
import os
import socket
import time
from collections import defaultdict
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from plotfeed.feeds.console.process import GARBAGE_OF_SESSION, keep_freed, undisturbed
from plotfeed.feeds.fleet.lease import WorkerLease
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.recorder import Recorder, SessionRecorder, attachments_of
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.observer import Observer, RunningSession
from plotfeed.feeds.session.outputs import brokers_of
from plotfeed.feeds.session.presence import RUNNING, session_message
from plotfeed.feeds.session.session import Session, run_over
from plotfeed.feeds.session.session_part import SessionPart
from plotfeed.feeds.timing.clock import Clock, InstantClock, WallClock
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

MARGIN_NS = NS // 20
"""By which who takes over begins after now: so much may clocks of hosts differ."""
BEGINNING, TAKING_OVER = "beginning", "taking over"
"""How a worker joins: when the part begins, or as soon as it can."""


class PartFailedError(PlotfeedError):
    """A part that could not be run, as it is told to whoever asked for it."""

    exit_code = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class PartOrder:
    """What a worker is to run, and how it begins."""

    scene: Scene
    name: str
    """Of the part: no two of a fleet that run at a time have one."""
    epoch: int
    """Which holder of the part this one is."""
    sensors: tuple[str, ...]
    leads: bool
    fleet: str
    """Begins client ids: the same for whoever runs the scene on its prefix."""
    began_utc_ns: int
    """When the scene began, by its own time."""
    began_world_ns: int
    """The same by the world's."""
    joins: str
    joins_utc_ns: int
    """When the part begins."""
    lease_s: float
    broker: str | None
    """URL, or none for no MQTT."""
    duration_s: float | None = None
    """Of the scene."""
    is_simulated: bool = False
    """As fast as it can."""
    record: Path | None = None
    """A file."""

    @property
    def key(self) -> str:
        """Which order it is."""
        return f"{self.name}.{self.epoch}"


@dataclass(frozen=True, slots=True)
class Question:
    """What a worker asks, and what it tells on that occasion."""

    number: int
    sent_until_utc_ns: int
    """All that was due by then has been sent, or is told as not sent; 0 before it sends."""
    joined_utc_ns: int
    """What ends after that it sends; 0 before it does."""
    not_sent: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    """From when until when some of what was due was not sent, by sensor, since the last question:
    it was late, had no lease or no broker. Times by which that was due, UTC."""


class _Served(Observer):
    """A part at work."""

    def __init__(self, lease_s: float) -> None:
        self.lease = WorkerLease(lease_s)
        self.stop = asyncio.Event()
        self.session: Session | None = None

    def begun(self, session: RunningSession) -> None:
        """The part sends from now on."""
        if isinstance(session, Session):
            self.session = session


@dataclass
class PartServer:
    """Runs parts, one at a time unless another is handed to it."""

    name: str = field(default_factory=lambda: f"{socket.gethostname()}:{os.getpid()}")
    _quiet: ExitStack = field(default_factory=ExitStack)
    _served: dict[str, asyncio.Future[_Served]] = field(
        default_factory=lambda: defaultdict(lambda: asyncio.get_running_loop().create_future())
    )

    async def prepare(self) -> str:
        """Make ready a process that is the worker's alone; its name."""
        keep_freed()
        self._quiet.enter_context(undisturbed(GARBAGE_OF_SESSION))
        return self.name

    async def serve(self, order: PartOrder) -> dict[str, Any]:
        """Run a part to its end: how it ended, and its counts. Raises `PartFailedError`."""
        served = _Served(order.lease_s)
        self._served[order.key].set_result(served)
        clock, file = _clock_of(order), order.record

        async def join(_caught_up_until_utc_ns: int) -> int:
            if order.joins == BEGINNING:
                return order.joins_utc_ns
            return max(clock.now_ns() + MARGIN_NS, order.joins_utc_ns)

        part = SessionPart(
            name=order.name,
            sensors=order.sensors,
            leads=order.leads,
            began_utc_ns=order.began_utc_ns,
            client_id=f"{order.fleet}-{order.name}",
            wills=order.fleet,
            lease=None if order.is_simulated else served.lease,
            join=join,
            told={"worker": self.name, "epoch": order.epoch},
        )
        began_s = time.process_time()
        watch = asyncio.create_task(_stop_when_forgotten(served, order))
        try:
            with ExitStack() as files:
                observers: list[Observer] = [served]
                if file is not None:
                    attachments = attachments_of(order.scene, order.began_utc_ns)
                    recorder = files.enter_context(
                        Recorder(file, attachments=attachments, waits=order.is_simulated)
                    )
                    is_sent = order.scene.mqtt.truth
                    records = SessionRecorder(recorder, ledger_is_sent=is_sent)
                    records.after_link(_of_whole(order), order.began_utc_ns)
                    observers.append(records)
                async with brokers_of(order.scene, order.broker) as brokers:
                    totals = await run_over(
                        brokers,
                        order.scene,
                        clock=clock,
                        duration_s=order.duration_s,
                        stop=served.stop,
                        observers=observers,
                        part=part,
                    )
        except PlotfeedError as error:
            raise PartFailedError(str(error)) from None
        finally:
            watch.cancel()
            del self._served[order.key]
        counts = ("looks", "plots", "false_alarms", "messages", "undelivered", "missed_scans")
        return {
            "lost": served.lease.lost,
            "not_sent": served.session.ticks.take_not_sent() if served.session else {},
            "processor_s": time.process_time() - began_s,
            **{name: getattr(totals, name) for name in counts},
        }

    async def asks(self, key: str) -> Question:
        """Return when the lease of an order is to be renewed."""
        served = await self._served[key]
        number = await served.lease.until_to_be_asked()
        session = served.session
        if session is None:
            return Question(number, 0, 0)
        ticks = session.ticks
        return Question(number, ticks.sent_until_ns, ticks.joined_ns, ticks.take_not_sent())

    async def granted(self, key: str, number: int) -> None:
        """Hold the lease, from when that question was asked."""
        if (served := self._of(key)) is not None:
            served.lease.granted(number)

    async def refused(self, key: str) -> None:
        """Send nothing more of an order, whose part somebody else has."""
        if (served := self._of(key)) is not None:
            served.lease.lose()
            served.stop.set()

    async def stop(self, key: str) -> None:
        """End a part, and say so."""
        if (served := self._of(key)) is not None:
            served.stop.set()

    def _of(self, key: str) -> _Served | None:
        found = self._served.get(key)
        return found.result() if found is not None and found.done() else None


async def _stop_when_forgotten(served: _Served, order: PartOrder) -> None:
    """End a part of which nobody has wanted to hear for long: whoever looked after it is gone.

    Simulated time needs no lease: it may leave nobody a turn for long.
    """
    await served.lease.overdue()
    if order.is_simulated:
        return
    served.lease.lose()
    served.stop.set()


def _of_whole(order: PartOrder) -> Message:
    """What a session of the whole would say when it begins: with it a recording is a session's."""
    of = {"session": order.fleet, "state": RUNNING, "heard": []}
    return session_message(order.scene, of, order.began_utc_ns, order.began_utc_ns)


def _clock_of(order: PartOrder) -> Clock:
    """The time of the scene, which began when the order says."""
    if order.is_simulated:
        return InstantClock(order.began_utc_ns)
    if order.began_utc_ns == order.began_world_ns:
        return WallClock()
    clock = WallClock(order.began_utc_ns + time.time_ns() - order.began_world_ns)
    clock.start()
    return clock

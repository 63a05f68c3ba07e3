"""The one process at a time that may send a part of a scene.

Several processes may be started for a part. Each listens to `{prefix}/fleet/{part}`, where the one
that sends says how it does, twice a second. The others work out the same and send nothing, until a
last will says that it has died, or nothing was heard of it for `PATIENCE_S`. Then one of them says
there that it has the part, with a higher claim, and connects under the part's client id, for which
the broker cuts off whoever had it. Whoever hears of a higher claim than its own ends. And whoever
has not heard its own words come back for `LEASE_S`, since it was frozen or the network was cut,
sends nothing by any way until it does: by then others may have the part.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import socket
from collections import deque
from collections.abc import AsyncIterator, Callable, Collection, Sequence
from typing import Any
from uuid import uuid4

from plotfeed.feeds.console.posix import alive_s
from plotfeed.feeds.link.counters import SessionCounters, lateness_us
from plotfeed.feeds.link.outbox import Outbox
from plotfeed.feeds.messages.message import Message, retained_message
from plotfeed.feeds.messages.transports import Client, Transport
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.part import PartHold, SessionPart
from plotfeed.feeds.session.presence import ENDED, RUNNING, session_told
from plotfeed.feeds.session.session import FIRST_CONNECTION_S, Session, run_over
from plotfeed.feeds.timing.clock import Clock
from plotfeed.feeds.transport.brokers import brokers_of
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.mqtt.connection import MqttConnection, OnMessage
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS, iso_utc

log = logging.getLogger(__name__)

JOINING = "JOINING"  # Before it is RUNNING, and at last ENDED
# The last is longer than the one before: who was silent for it sends nothing any more.
SAY_EVERY_S, LEASE_S, PATIENCE_S = 0.5, 2.0, 3.0
NEWS_S = 0.5  # By then a broker has passed on what it retains
LOOK_S = 0.05
# Who takes over begins so much after now: clocks of machines may differ by that.
MARGIN_NS = NS // 20
# Of what has left, as much may still be on its way, and lost where a connection is.
ON_THE_WAY_NS = NS // 2
MOST_GAPS = 1000
COUNTED = ("drones", "telemetry", "plots", "messages", "undelivered", "missed_scans")
# What the ledger calls the place where messages of a part did not get that others may send.
NOT_HELD = "another process"


class PartTakenError(PlotfeedError):
    """A part that another process has taken over."""

    exit_code = 1


async def run_part(
    part: SessionPart, *, scene: Scene, clock: Clock, broker: str | None, **session: Any
) -> SessionCounters:
    """Run some of a scene's sensors, as `run_over` does; raises `PlotfeedError`.

    At a broker another process may have the part: then this one stands by.
    """
    async with brokers_of(scene, broker) as brokers:
        hold = BrokerHold(part, scene, clock) if brokers[0] else None
        return await run_over(brokers, scene, clock=clock, part=part, hold=hold, **session)


class BrokerHold(PartHold):
    """Whether this process has a part: it says so, and hears whether another does."""

    client_id: str

    def __init__(self, part: SessionPart, scene: Scene, clock: Clock) -> None:
        self.process = uuid4().hex[:12]
        self.source = part.source(scene)
        self.client_id = f"{scene.mqtt.prefix}-part-{part.number}".replace("/", "-")
        self.margin_ns = MARGIN_NS
        # What nobody sent: sensors, from when, until when, why.
        self.gaps: deque[dict[str, Any]] = deque(maxlen=MOST_GAPS)
        self._gaps_are_told = True
        self._state = JOINING  # As it says, until it has told what nobody sent before it joined
        # What was due by then has been sent, or is told that it was not: as of when it said what
        # has come back, however late that was.
        self._sent_until_ns = part.began_utc_ns
        self.joined_ns = 0  # What ends after that this process sends; 0 before it does
        self.watch: MqttTransport  # The connection by which it hears and says all this
        self._part, self._scene, self._clock = part, scene, clock
        self._session: Session  # Of the part; known once it is kept
        # What another process said last, before this one had the part.
        self._other: dict[str, Any] | None = None
        # Which process has ended or died, as the part's session message says.
        self._session_gone = ""
        self._silent_s = 0.0
        self._claim = 0
        self._number = 0
        self._says_next_s = 0.0  # When it says again how it does
        # When it said what has those numbers, and until when all was sent by then.
        self._said: dict[int, tuple[float, int]] = {}
        self._held_from_s = self._until_s = float("-inf")
        self._taken: dict[str, Any] | None = None

    def link(
        self, to: BrokerAddress, topics: Sequence[str], on_message: OnMessage, **how: Any
    ) -> MqttTransport:
        """The link of whoever has the part; the watch hears those topics, whoever that is."""
        self._on_message = on_message
        every = [self.source, f"{self.source}/gaps", *topics]
        self.watch = MqttTransport(
            to, f"{self.client_id}-watch", subscribe=every, on_message=self._hear
        )
        self._out = Outbox(self._clock, [self.watch])
        return _PartLink(to, self, **how)

    def guarded(self, transport: Transport) -> Transport:
        """A transport that takes nothing, and says so, while another process may have the part."""
        return _HeldTransport(transport, self)

    @property
    def holds(self) -> bool:
        """Whether messages may be sent now."""
        return self.joined_ns > 0 and alive_s() < self._until_s

    @property
    def is_free(self) -> bool:
        """Whether no other process has the part, as far as is known."""
        if not self.watch.is_up or self._silent_s < NEWS_S:
            return False
        other = self._other
        is_gone = other is None or other["state"] == ENDED or other["process"] == self._session_gone
        return is_gone or self._silent_s >= PATIENCE_S

    @property
    def is_claimed(self) -> bool:  # type: ignore[override]
        """Whether this process has said that it has the part."""
        return self._claim > 0

    @property
    def is_taken(self) -> bool:  # type: ignore[override]
        """Whether another process has taken the part over from this one."""
        return self._taken is not None

    async def wait_for_turn(self, session: Session, end_ns: int | None) -> None:
        """Have the session stand by until this process has the part, or that time has come."""

        def has_ended() -> bool:
            return end_ns is not None and self._clock.now_ns() >= end_ns

        await self.watch.wait_until_up(FIRST_CONNECTION_S)
        await session.stand_by(lambda: self.is_free or has_ended())
        if has_ended():
            return
        if self._other is not None and self._other["state"] != ENDED:
            log.info("part %s: takes over from %s", self._part.name, self._other["worker"])
        self._claim = 1
        if self._other is not None:
            self._claim += self._other["claim"]
            self._sent_until_ns = self._other["sent_until_utc_ns"]
        self._say()

    async def renewed(self) -> None:
        """Return once what was said after this call has come back."""
        since_s = alive_s()
        while not since_s <= self._held_from_s <= alive_s() < self._until_s:  # noqa: ASYNC110
            await asyncio.sleep(LOOK_S / 10)

    def begin(self) -> None:
        """Send from now on what ends after the time at which the session has joined."""
        self.joined_ns = self._session.joined_ns
        self._session.take_not_sent()
        from_ns, why = self._part.began_utc_ns, "nobody had begun"
        if self._other is not None and self._other["began_utc_ns"] == from_ns:
            from_ns = max(from_ns, self._other["sent_until_utc_ns"] - ON_THE_WAY_NS)
            why = f"{self._other['worker']} no longer sends"
        if self.joined_ns > from_ns:
            self._tell_gap(self._part.sensors, from_ns, self.joined_ns, why)
        if self.holds:  # else as soon as it does
            self._tell_gaps()

    def cut_off(self) -> None:
        """Tell that what was on its way to the broker may be lost: the connection was."""
        from_ns = max(self._sent_until_ns - ON_THE_WAY_NS, self.joined_ns)
        why = "the connection to the broker was lost"
        self._tell_gap(self._part.sensors, from_ns, self._clock.now_ns(), why)

    @contextlib.asynccontextmanager
    async def kept(self, session: Session, tasks: asyncio.TaskGroup) -> AsyncIterator[None]:
        """Listen and say how the part does meanwhile; at the end, that it has ended."""
        self._session = session
        keeping = [tasks.create_task(self.watch.run()), tasks.create_task(self._keep())]
        try:
            yield
            if self._claim and not self.is_taken:
                self._state = ENDED  # whatever is said again meanwhile
                self._say()
                await self.watch.drain()
        finally:
            for task in keeping:
                task.cancel()

    async def _keep(self) -> None:
        """Say how the part does, and note whether another says so, until cancelled.

        Raises `PartTakenError` where another process has taken it over.
        """
        while True:
            await asyncio.sleep(LOOK_S)
            self._silent_s = self._silent_s + LOOK_S if self.watch.is_up else 0.0
            if self._taken is not None:
                raise PartTakenError(
                    f"part {self._part.name}: {self._taken['worker']} has taken it over"
                )
            if self._claim and self.watch.is_up and alive_s() >= self._says_next_s:
                self._says_next_s = alive_s() + SAY_EVERY_S
                self._say()

    def _hear(self, topic: str, payload: bytes, content_type: str | None) -> None:
        if topic == self.source:
            if (status := part_status(payload)) is not None:
                self._hear_status(status)
        elif topic == f"{self.source}/gaps":
            told = told_gaps(payload)
            if not self._claim:
                began_ns = self._part.began_utc_ns
                self.gaps = deque([gap for gap in told if gap["to_utc_ns"] > began_ns], MOST_GAPS)
            elif told == [*self.gaps]:
                self._gaps_are_told = True
                self._tell_gaps()
        else:
            if topic == f"{self.source}/session":
                self._hear_session(payload)
            self._on_message(topic, payload, content_type)

    def _hear_status(self, told: dict[str, Any]) -> None:
        if told["process"] == self.process:
            said = self._said.get(told["number"])
            if said is not None and self._taken is None:
                self._held_from_s, self._sent_until_ns = said
                self._until_s = self._held_from_s + LEASE_S
                self._tell_gaps()  # not before: it may be another's part by now
            return
        self._silent_s = 0.0
        if not self._claim:
            if self._other is None and told["state"] != ENDED:
                log.info("part %s: stands by, as %s has it", self._part.name, told["worker"])
            self._other = told
        elif (told["claim"], told["process"]) > (self._claim, self.process):
            self._taken, self._until_s = told, float("-inf")

    def _hear_session(self, payload: bytes) -> None:
        if (told := session_told(payload)) is None:
            return
        gone = self._session_gone = "" if told["state"] == RUNNING else told["session"]
        if gone and self._other is not None and self._other["process"] == gone:
            self._silent_s = NEWS_S  # it is known without waiting

    def _say(self) -> None:
        if self.joined_ns and (not_sent := self._session.take_not_sent()):
            from_ns = min(first_ns for first_ns, _ in not_sent.values()) - 1
            to_ns = max(last_ns for _, last_ns in not_sent.values())
            self._tell_gap(not_sent.keys(), from_ns, to_ns, "it could not be sent in time")
        if self._state == ENDED:  # then all is known
            self._tell_gaps()
        sent_until_ns = self._session.sent_until_ns if self.joined_ns else self._sent_until_ns
        self._number += 1
        self._said[self._number] = alive_s(), sent_until_ns
        self._said.pop(self._number - 8, None)
        part, totals, now_ns = self._part, self._session.totals, self._clock.now_ns()
        p50_us, p99_us = lateness_us(totals.lateness_ns, 50, 99)
        said = {
            "part": part.number,
            "parts": part.parts,
            "state": self._state,
            "process": self.process,
            "worker": f"{socket.gethostname()}:{os.getpid()}",
            "claim": self._claim,
            "number": self._number,
            "scene": self._scene.scene.name,
            "began_utc_ns": part.began_utc_ns,
            "time_utc": iso_utc(now_ns),
            "sent_until_utc": iso_utc(self._sent_until_ns),
            "sent_until_utc_ns": self._sent_until_ns,
            "sensors": list(part.sensors),
            **{name: getattr(totals, name) for name in COUNTED},
            "lateness_p50_us": p50_us,
            "lateness_p99_us": p99_us,
        }
        self._out.send_past_link(self._message(str(part.number), said, now_ns))

    def _message(self, kind: str, said: object, now_ns: int) -> Message:
        source = self.source if kind == "gaps" else self.source.rpartition("/")[0]
        message = retained_message(source, kind, json.dumps(said).encode(), now_ns)
        message.qos = 0  # by QoS 1 it would be sent again when another may have the part
        return message

    def _tell_gap(self, sensors: Collection[str], from_ns: int, to_ns: int, why: str) -> None:
        """Tell what nobody sent; where that goes on, as one gap."""
        last = self.gaps[-1] if self.gaps else None
        if last is not None and last["why"] == why and from_ns <= last["to_utc_ns"] + NS:
            self.gaps.pop()
            sensors = {*sensors, *last["sensors"]}
            from_ns = min(from_ns, last["from_utc_ns"])
            to_ns = max(to_ns, last["to_utc_ns"])
        in_order = [name for name in self._part.sensors if name in sensors]
        gap = {"sensors": in_order, "from_utc_ns": from_ns, "to_utc_ns": to_ns, "why": why}
        self.gaps.append(gap)
        self._gaps_are_told = False

    def _tell_gaps(self) -> None:
        """Tell what nobody sent, until that has come back; who has joined runs then.

        Not before, as it may die as soon as others hear that it runs; soon after it says so.
        """
        if not self._gaps_are_told and self.watch.is_up:
            now_ns = self._clock.now_ns()
            self._out.send_past_link(self._message("gaps", [*self.gaps], now_ns))
        elif self._gaps_are_told and self.joined_ns and self._state == JOINING:
            self._state, self._says_next_s = RUNNING, 0.0


WORDS = ("process", "state", "worker", "scene", "time_utc", "sent_until_utc")
# Of what a part says of itself, beside its sensors and its lateness.
NUMBERS = ("part", "parts", "claim", "number", "began_utc_ns", "sent_until_utc_ns", *COUNTED)


def part_status(payload: bytes) -> dict[str, Any] | None:
    """What a part says of itself, if it is that."""
    try:
        told = json.loads(payload)
        kinds = dict.fromkeys(WORDS, str) | dict.fromkeys(NUMBERS, int) | {"sensors": list}
        is_one = all(type(told[key]) is kind for key, kind in kinds.items())
        told["lateness_p99_us"] = float(told["lateness_p99_us"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return dict(told) if is_one else None


def told_gaps(payload: bytes) -> list[dict[str, Any]]:
    """What nobody sent of a part, as it was told; nothing where the payload is nothing such."""
    try:
        return [
            {
                "sensors": [str(name) for name in gap["sensors"]],
                "from_utc_ns": int(gap["from_utc_ns"]),
                "to_utc_ns": int(gap["to_utc_ns"]),
                "why": str(gap["why"]),
            }
            for gap in json.loads(payload)
        ]
    except (ValueError, KeyError, TypeError, RecursionError):
        return []


class _HeldTransport:
    """A transport that takes nothing, and says so, while the part may be another process's."""

    def __init__(self, transport: Transport, hold: BrokerHold) -> None:
        self._transport, self._hold = transport, hold
        self.waiting_of: Callable[[Client], int] = transport.waiting_of
        self.carries: Callable[[Message], bool] = transport.carries
        self.prepare: Callable[[Sequence[Message]], None] = transport.prepare
        self.drain = transport.drain

    def publish(self, messages: Sequence[Message]) -> bool:
        """Send them, or settle them as undelivered."""
        if self._hold.holds:
            return self._transport.publish(messages)
        for one in messages:
            one.settle(delivered=False, to=NOT_HELD)
        return False


class _PartLink(MqttTransport):
    """The link of a part: under the part's client id, and only where this process has the part."""

    def __init__(self, address: BrokerAddress, hold: BrokerHold, **how: Any) -> None:
        super().__init__(address, hold.client_id, client_id=hold.client_id, **how)
        self._hold = hold

    async def _connect(self) -> MqttConnection:
        before, topic = self.last_error, self._hold.source
        self.last_error = (
            f"nothing comes back from {topic}: does its access list let it write and read there?"
        )
        await self._hold.renewed()
        self.last_error = before
        return await super()._connect()

    def _send_by(self, connection: MqttConnection | None) -> None:
        if connection is None and self._connection is not None:
            self._hold.cut_off()
        super()._send_by(connection)

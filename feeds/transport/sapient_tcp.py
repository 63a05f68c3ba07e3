"""A node's own connection to a SAPIENT middleware: framed, registered first, kept up."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Iterator, Sequence
from typing import Any, cast

from plotfeed.feeds.delivery.counters import ClientCounters
from plotfeed.feeds.delivery.delivery import Delivery, MakeDeliveries
from plotfeed.feeds.formats import Announcer
from plotfeed.feeds.formats.sapient.sapient_node import CONTENT_TYPE, is_registration
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import split_address
from plotfeed.feeds.timing.clock import Clock
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.proto.sapient.decode_sapient import Answer, decode_answer

LENGTH_OCTETS = 4
MAX_MESSAGE_OCTETS = 1 << 20
"""Of what is taken from a peer; the answers to a sensor are some hundred octets."""


def framed(payload: bytes) -> bytes:
    """A message as it goes over TCP."""
    return len(payload).to_bytes(LENGTH_OCTETS, "little") + payload


class Deframer:
    """Puts messages together from octets as they come. It holds at most one that is not whole."""

    def __init__(self) -> None:
        self._octets = bytearray()

    def feed(self, octets: bytes) -> Iterator[bytes]:
        """The messages that are now whole; raises `DecodeError` at a length that is none."""
        self._octets += octets
        start = 0
        while len(self._octets) - start >= LENGTH_OCTETS:
            length = int.from_bytes(self._octets[start : start + LENGTH_OCTETS], "little")
            if length > MAX_MESSAGE_OCTETS:
                self._octets.clear()
                raise DecodeError(f"a length of {length}; at most {MAX_MESSAGE_OCTETS} is taken")
            end = start + LENGTH_OCTETS + length
            if end > len(self._octets):
                break
            yield bytes(self._octets[start + LENGTH_OCTETS : end])
            start = end
        del self._octets[:start]


log = logging.getLogger(__name__)

CONNECT_TIMEOUT_S = 2.0
ACK_TIMEOUT_S = 2.0
BACKOFF_S = (0.25, 0.5, 1.0, 2.0, 4.0)
STEADY_S = 5.0
"""A connection that lasted less counts as a failure: whoever hangs up at once is not hurried."""
MAX_UNSENT_OCTETS = 8 << 20
MAX_STALL_S = 0.5
"""While the socket has taken nothing for so long, nothing more is taken; it would come too late."""
GIVE_UP_S = 5.0
"""After so long a stall the connection is made anew."""
MAX_SAID = 200


class SapientError(PlotfeedError):
    """A middleware that cannot be reached."""

    exit_code = 1


class SapientTcpTransport:
    """One sensor's connection: kept up while `run` runs, publishing once it is registered."""

    def __init__(self, address: str, sensor: str, announcer: Announcer, clock: Clock) -> None:
        self.address = address
        self.name = f"sapient-{sensor}"
        self.connections = 0
        self.last_error = ""
        self._announcer = announcer
        self._clock = clock
        self._wire: _Wire | None = None
        self._up = asyncio.Event()

    async def wait_until_up(self, timeout_s: float | None = None) -> None:
        """Return once it is registered; raises `SapientError` if it is not in that time."""
        try:
            async with asyncio.timeout(timeout_s):
                await self._up.wait()
        except TimeoutError:
            why = f" ({self.last_error})" if self.last_error else ""
            raise SapientError(f"no SAPIENT middleware answers at {self.address}{why}") from None

    async def run(self) -> None:
        """Connect, and connect again whenever the connection is lost, until cancelled."""
        loop = asyncio.get_running_loop()
        attempt = 0
        try:
            while True:
                began_s = loop.time()
                try:
                    await self._stay_connected()
                except SapientError as error:
                    self.last_error = str(error)
                    if attempt == 0 and self.connections:  # else whoever waits is told
                        log.warning("%s: %s: %s", self.name, self.address, error)
                attempt = 0 if loop.time() - began_s > STEADY_S else attempt
                await asyncio.sleep(BACKOFF_S[min(attempt, len(BACKOFF_S) - 1)])
                attempt += 1
        finally:
            self._up.clear()
            await self._hang_up()

    def publish(self, *deliveries: Delivery) -> None:
        """Send what is SAPIENT, and settle at once whether the connection, if any, took it."""
        for delivery in deliveries:
            message = delivery.message
            delivered = True
            # It registers by itself, whenever it connects.
            if message.content_type == CONTENT_TYPE and not is_registration(message):
                wire = self._wire if self._up.is_set() else None
                delivered = wire is not None and wire.send(message.payload)
                if delivered:
                    delivery.leave()
            delivery.settle(delivered=delivered)

    def publish_together(self, _messages: Sequence[Message], made: MakeDeliveries) -> bool:
        """Send what is SAPIENT, and settle each."""
        self.publish(*made())
        return False

    def waiting_of(self, _client: ClientCounters) -> int:
        """Nothing waits."""
        return 0

    def prepare(self, messages: Sequence[Message]) -> None:
        """Nothing can be done ahead of time."""

    async def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until the socket has taken what was published, or the time is up."""
        loop = asyncio.get_running_loop()
        deadline_s = loop.time() + timeout_s
        while self._wire is not None and self._up.is_set() and self._wire.unsent_octets:
            if loop.time() > deadline_s:
                return
            await asyncio.sleep(0.001)

    async def _stay_connected(self) -> None:
        """One connection, from its beginning to its end; raises `SapientError` if there is none."""
        self._wire = wire = await self._connected()
        try:
            await self._register(wire)
            self.connections += 1
            self._up.set()
            await wire.lost
            raise SapientError(wire.reason or "the connection was closed")
        except SapientError:
            wire.abort()
            raise
        finally:
            self._up.clear()

    async def _connected(self) -> _Wire:
        host, port = split_address(self.address)
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(CONNECT_TIMEOUT_S):
                _, wire = await loop.create_connection(lambda: _Wire(self.name), host, port)
        except TimeoutError:
            raise SapientError("no answer") from None
        except (OSError, UnicodeError) as error:
            why = (error.strerror if isinstance(error, OSError) else None) or str(error)
            raise SapientError(why) from None
        return wire

    async def _register(self, wire: _Wire) -> None:
        """Register, take note of the answer, and go on whatever it is."""
        registration, _ = self._announcer.opening(self._clock.now_ns())
        wire.send(registration.payload)
        either: set[asyncio.Future[Any]] = {wire.acknowledged, wire.lost}
        await asyncio.wait(either, timeout=ACK_TIMEOUT_S, return_when=asyncio.FIRST_COMPLETED)
        if wire.lost.done():
            raise SapientError(wire.reason or "the connection was closed at the registration")
        if not wire.acknowledged.done():
            log.warning("%s: %s did not acknowledge the registration", self.name, self.address)
        elif not wire.acknowledged.result().accepted:
            why = _said(wire.acknowledged.result())
            log.warning("%s: %s refused the registration%s", self.name, self.address, why)
        _, status = self._announcer.opening(self._clock.now_ns())
        wire.send(status.payload)

    async def _hang_up(self) -> None:
        """Let what is not sent yet leave, and close."""
        wire, self._wire = self._wire, None
        if wire is None:
            return
        wire.close()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(1.0):
                await asyncio.shield(wire.lost)
        wire.abort()


class _Wire(asyncio.Protocol):
    """Octets to and from one connection. What comes is read, whatever it is, and little is kept."""

    def __init__(self, name: str) -> None:
        loop = asyncio.get_running_loop()
        self.lost: asyncio.Future[None] = loop.create_future()
        self.acknowledged: asyncio.Future[Answer] = loop.create_future()
        self.reason = ""
        self._name = name
        self._loop = loop
        self._deframer = Deframer()
        self._transport: asyncio.Transport | None = None
        self._stalled_since_s: float | None = None
        self._complained = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        self._transport.set_write_buffer_limits(high=0)  # to be told as soon as anything waits

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None
        if exc is not None and not self.reason:
            self.reason = str(exc)
        if not self.lost.done():
            self.lost.set_result(None)

    def pause_writing(self) -> None:
        self._stalled_since_s = self._loop.time()

    def resume_writing(self) -> None:
        self._stalled_since_s = None

    def data_received(self, data: bytes) -> None:
        try:
            for message in self._deframer.feed(data):
                self._hear(message)
        except DecodeError as error:  # from here on there is no telling where a message begins
            self.reason = f"it sent {error}"
            self.abort()

    @property
    def unsent_octets(self) -> int:
        """What the socket has not taken yet."""
        return self._transport.get_write_buffer_size() if self._transport else 0

    def send(self, payload: bytes) -> bool:
        """Hand a message to the socket; False if it is gone or has stalled."""
        if self._transport is None or self._transport.is_closing():
            return False
        if self._stalled_since_s is not None:
            stall_s = self._loop.time() - self._stalled_since_s
            if stall_s > GIVE_UP_S:
                self.reason = f"it has read nothing for {GIVE_UP_S:g} s"
                self.abort()
            if stall_s > MAX_STALL_S or self.unsent_octets + len(payload) > MAX_UNSENT_OCTETS:
                return False
        self._transport.write(framed(payload))
        return True

    def close(self) -> None:
        """Close when all is sent."""
        if self._transport is not None:
            self._transport.close()

    def abort(self) -> None:
        """Close at once."""
        if self._transport is not None:
            self._transport.abort()

    def _hear(self, message: bytes) -> None:
        """Take note of an acknowledgement, and tell of one complaint a connection."""
        try:
            answer = decode_answer(message)
        except DecodeError as error:
            answer = Answer(None, (f"it sent {error}",))
        if answer.accepted is not None:
            if not self.acknowledged.done():
                self.acknowledged.set_result(answer)
        elif answer.reasons and not self._complained:
            self._complained = True
            log.warning("%s: the middleware complains%s", self._name, _said(answer))


def _said(answer: Answer) -> str:
    """Reasons of an answer in a line, as far as a line goes."""
    text = " ".join("; ".join(answer.reasons).split())
    text = "".join(c if c.isprintable() else "?" for c in text)
    return f": {text[:MAX_SAID]}" if text else ""

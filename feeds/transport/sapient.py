"""A node's own connection to a SAPIENT middleware: registered first, kept up, its answers heard.

Messages are framed by their lengths. What a middleware says beyond what may be taken in is not
read, so that TCP lets it wait, and no deadline does.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Callable
from typing import Any, cast

from plotfeed.feeds.console.printed import printable
from plotfeed.feeds.formats import Announcer
from plotfeed.feeds.formats.sapient.sapient_announcer import is_answer, is_registration
from plotfeed.feeds.formats.sapient.sapient_node import CONTENT_TYPE
from plotfeed.feeds.link.counters import SapientCounters
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.transports import ImmediateTransport
from plotfeed.feeds.scene.fields import split_address
from plotfeed.feeds.scene.output_keys import SapientKeys
from plotfeed.feeds.timing.clock import Clock
from plotfeed.feeds.transport.ways_out import TransportError, backoff_s, wait_while
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.sapient.decode_sapient import Heard, decode_heard

log = logging.getLogger(__name__)

GATHER_S = 1.0  # Who has the same to tell within this time is one of a number


class SapientNews:
    """Tells of the first sensor to which something happens at once, and then how many more."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._more: dict[str, int] = {}  # By what was told a moment ago

    def tell(self, name: str, what: str, level: int = logging.WARNING) -> None:
        """Say of that connection what happened to it, unless others have just said the same."""
        if what in self._more:
            self._more[what] += 1
            return
        log.log(level, "%s: %s", name, what)
        self._more[what] = 0
        self._loop.call_later(GATHER_S, self._tell_more, what, level)

    def _tell_more(self, what: str, level: int) -> None:
        more = self._more.pop(what)
        if more:
            log.log(level, "sapient: %s, and so %d more sensors", what, more)


SERVE_EVERY_S = 0.02  # While anything waits, some of it is taken in so often
AT_ONCE_S = 0.05  # After a silence, what may be said in this time is taken in at once


class SapientIntake:
    """Lets connections speak in turn, a message each, as often as messages and octets may come."""

    def __init__(self, max_messages_per_s: float, max_octets_per_s: float) -> None:
        self._loop = asyncio.get_running_loop()
        self._max_messages_per_s, self._max_octets_per_s = max_messages_per_s, max_octets_per_s
        # That may be taken in now; octets are owed after a long message.
        self._messages, self._octets = 0.0, 0.0
        self._filled_s = self._loop.time() - AT_ONCE_S
        self._speaking = asyncio.Lock()  # Who has waited longest has it next

    async def turn(self, octets: int) -> None:
        """Return when a message of so many octets may be taken in."""
        async with self._speaking:
            await asyncio.sleep(0)  # others may ask meanwhile, and are next
            self._fill()
            while self._messages < 1 or self._octets <= 0:
                await asyncio.sleep(SERVE_EVERY_S)
                self._fill()
            self._messages -= 1
            self._octets -= octets

    def _fill(self) -> None:
        now_s = self._loop.time()
        for_s, self._filled_s = now_s - self._filled_s, now_s
        least = 1.0  # of however few a second, one at a time must be possible
        self._messages = min(
            self._messages + for_s * self._max_messages_per_s,
            max(AT_ONCE_S * self._max_messages_per_s, least),
        )
        self._octets = min(
            self._octets + for_s * self._max_octets_per_s, AT_ONCE_S * self._max_octets_per_s
        )


LENGTH_OCTETS = 4
# Of what is taken from a peer; the answers to a sensor are some hundred octets.
MAX_MESSAGE_OCTETS = 1 << 16
MAX_UNSENT_OCTETS = 8 << 20
# While the socket has taken nothing for so long, nothing more is taken; it would come too late.
MAX_STALL_S = 0.5
# That the system takes before it lets us wait: the less, the sooner it shows that nobody reads.
SOCKET_OCTETS = 128 << 10


def framed(payload: bytes) -> bytes:
    """A message as it goes over TCP."""
    return len(payload).to_bytes(LENGTH_OCTETS, "little") + payload


async def next_message(octets: asyncio.StreamReader) -> bytes:
    """The next message of a stream; raises `EOFError`, `OSError`, `DecodeError` at no length."""
    length = int.from_bytes(await octets.readexactly(LENGTH_OCTETS), "little")
    if length > MAX_MESSAGE_OCTETS:
        raise DecodeError(f"a length of {length}; at most {MAX_MESSAGE_OCTETS} is taken")
    return await octets.readexactly(length)


class SapientWire(asyncio.StreamReaderProtocol):
    """One connection. While what came waits for its turn, hardly more is read."""

    def __init__(
        self, intake: SapientIntake, on_message: Callable[[bytes], object], give_up_after_s: float
    ) -> None:
        """A peer that has read nothing for `give_up_after_s` is left."""
        self._loop = asyncio.get_running_loop()
        self.lost: asyncio.Future[None] = self._loop.create_future()
        self.reason = ""  # Why it is lost, if that is known
        self.was_stalled = False  # Whether it was given up because the other end did not read
        self._intake, self._on_message = intake, on_message
        self._give_up_after_s = give_up_after_s
        self._said = asyncio.StreamReader(MAX_MESSAGE_OCTETS)
        super().__init__(self._said)
        self._transport: asyncio.Transport | None = None
        self._stalled_since_s: float | None = None
        self._giving_up: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The connection stands."""
        super().connection_made(transport)
        self._transport = cast("asyncio.Transport", transport)
        self._transport.set_write_buffer_limits(high=0)  # to be told as soon as anything waits
        own = transport.get_extra_info("socket")
        own.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_OCTETS)
        if hasattr(socket, "TCP_USER_TIMEOUT"):  # sees also a host that is gone without a word
            own.setsockopt(
                socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(self._give_up_after_s * 1000)
            )
        self._hearing = asyncio.create_task(self._hear())

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection is gone, and with it what waited."""
        super().connection_lost(exc)
        self._transport = None
        self._hearing.cancel()
        if self._giving_up is not None:
            self._giving_up.cancel()
        if isinstance(exc, TimeoutError) and not self.reason:
            self._note_stall()
        elif exc is not None and not self.reason:
            self.reason = (exc.strerror if isinstance(exc, OSError) else None) or str(exc)
        if not self.lost.done():
            self.lost.set_result(None)

    def pause_writing(self) -> None:
        """The socket takes no more for now."""
        super().pause_writing()
        self._stalled_since_s = self._loop.time()
        self._giving_up = self._loop.call_later(self._give_up_after_s, self._give_up)

    def resume_writing(self) -> None:
        """The socket takes more again."""
        super().resume_writing()
        self._stalled_since_s = None
        if self._giving_up is not None:
            self._giving_up.cancel()

    async def _hear(self) -> None:
        """Take in messages, each in its turn, until the other end says no more."""
        try:
            while True:
                message = await next_message(self._said)
                await self._intake.turn(LENGTH_OCTETS + len(message))
                self._on_message(message)
        except DecodeError as error:  # from here on there is no telling where a message begins
            self.reason = f"it sent {error}"
        except (OSError, EOFError):
            pass  # it is lost
        finally:
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

    def _give_up(self) -> None:
        self._note_stall()
        self.abort()

    def _note_stall(self) -> None:
        self.was_stalled = True
        self.reason = f"it has read nothing for {self._give_up_after_s:g} s"


CONNECT_TIMEOUT_S = 2.0
ACK_TIMEOUT_S = 2.0
REGISTER_AGAIN_S = 10.0  # Who was refused asks so often whether that has changed
# A connection that lasted less counts as a failure: whoever hangs up at once is not hurried.
STEADY_S = 5.0
MAX_SAID = 200


class SapientTcpTransport(ImmediateTransport):
    """One sensor's connection: kept up while `run` runs, publishing unless it is refused."""

    to = "SAPIENT"

    def __init__(
        self,
        sensor: str,
        settings: SapientKeys,
        announcer: Announcer,
        *,
        clock: Clock,
        intake: SapientIntake,
        news: SapientNews,
        counters: SapientCounters,
        on_task: Callable[[bytes, str | None], object] | None = None,
    ) -> None:
        """`settings` name the middleware; `on_task` is given what holds a task, and its type."""
        if settings.middleware is None:
            raise ValueError("expected a middleware")
        self.address = settings.middleware
        self.name = f"sapient-{sensor}"
        self.counters = counters
        self.last_error = ""
        self._give_up_after_s = settings.give_up_after_s
        self._announcer = announcer
        self._loop = clock
        self._intake = intake
        self._news = news
        self._on_task = on_task
        self._wire: SapientWire | None = None
        # Set while a connection stands over which something was said to the registration.
        self._up = asyncio.Event()
        self._answered = asyncio.Event()
        self._is_refused = False
        self._loss_told = False
        self._has_opened = False

    async def wait_until_up(self, timeout_s: float | None = None) -> None:
        """Return once it has registered; raises `TransportError` if it has not in that time."""
        try:
            async with asyncio.timeout(timeout_s):
                await self._up.wait()
        except TimeoutError:
            why = f" ({self.last_error})" if self.last_error else ""
            raise TransportError(f"no SAPIENT middleware answers at {self.address}{why}") from None

    async def run(self) -> None:
        """Connect, and connect again whenever the connection is lost, until cancelled."""
        loop = asyncio.get_running_loop()
        attempt = 0
        try:
            while True:
                began_s = loop.time()
                try:
                    await self._stay_connected()
                except TransportError as error:
                    self.last_error = str(error)
                    if attempt == 0 and self.counters.connections:  # else whoever waits is told
                        self._tell(f"lost {self.address} ({error})")
                        self._loss_told = True
                attempt = 0 if loop.time() - began_s > STEADY_S else attempt
                await asyncio.sleep(backoff_s(attempt))
                attempt += 1
        finally:
            self._ended()
            await self._hang_up()

    def carries(self, message: Message) -> bool:
        """Whether it is SAPIENT."""
        return message.content_type == CONTENT_TYPE

    async def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until the socket has taken what was published, or the time is up."""
        await wait_while(
            lambda: self._wire is not None and self._up.is_set() and self._wire.unsent_octets,
            timeout_s,
        )

    def give(self, message: Message) -> bool:
        """Send it; whether the connection, if any, took it."""
        registers = is_registration(message)
        if registers and not self._has_opened:
            self._has_opened = True  # what a session begins with, the connection has begun with
            return True
        wire = self._wire if self._up.is_set() else None
        if wire is None:
            return False
        if self._is_refused and not registers and not is_answer(message):
            return False
        return wire.send(message.payload)

    async def _stay_connected(self) -> None:
        """One connection from beginning to end; raises `TransportError` if there is none."""
        self._wire = wire = await self._connected()
        try:
            await self._register(wire)
            self.counters.count("connections")
            self._up.set()
            if self._loss_told:
                self._tell(f"connected to {self.address} again", logging.INFO)
                self._loss_told = False
            while not wire.lost.done():
                await asyncio.wait({wire.lost}, timeout=REGISTER_AGAIN_S)
                if self._is_refused:
                    self._say_registration(wire)
            self.counters.count("stalls", wire.was_stalled)
            raise TransportError(wire.reason or "the connection was closed")
        except TransportError:
            wire.abort()
            raise
        finally:
            self._ended()

    def _ended(self) -> None:
        self._up.clear()
        self._is_refused = self.counters.reporting = False

    async def _connected(self) -> SapientWire:
        host, port = split_address(self.address)
        loop = asyncio.get_running_loop()
        self._answered.clear()
        try:
            async with asyncio.timeout(CONNECT_TIMEOUT_S):
                _, wire = await loop.create_connection(
                    lambda: SapientWire(self._intake, self._hear, self._give_up_after_s), host, port
                )
        except TimeoutError:
            raise TransportError("no answer") from None
        except (OSError, UnicodeError) as error:
            why = (error.strerror if isinstance(error, OSError) else None) or str(error)
            raise TransportError(why) from None
        return wire

    async def _register(self, wire: SapientWire) -> None:
        """Register, and wait a while for the answer; without any, report all the same."""
        self._say_registration(wire)
        answered = asyncio.ensure_future(self._answered.wait())
        either: set[asyncio.Future[Any]] = {answered, wire.lost}
        await asyncio.wait(either, timeout=ACK_TIMEOUT_S, return_when=asyncio.FIRST_COMPLETED)
        answered.cancel()
        if wire.lost.done():
            raise TransportError(wire.reason or "the connection was closed at the registration")
        if not self._answered.is_set():
            self._tell(f"{self.address} did not acknowledge the registration")
            self._report()

    def _say_registration(self, wire: SapientWire) -> None:
        registration, _ = self._announcer.opening(self._loop.now_ns())
        wire.send(registration.payload)

    def _report(self) -> None:
        """Begin to report, with how the sensor is."""
        self._is_refused, self.counters.reporting = False, True
        if self._wire is not None:
            _, status = self._announcer.opening(self._loop.now_ns())
            self._wire.send(status.payload)

    def _hear(self, payload: bytes) -> None:
        """Take note of what the middleware says."""
        try:
            heard = decode_heard(payload)
        except DecodeError as error:
            heard = Heard("error", (f"it sent {error}",))
        if heard.what == "accepted":
            if not self.counters.reporting:
                self._report()
            self._answered.set()
        elif heard.what == "refused":
            self._refused(heard)
            self._answered.set()
        elif heard.what == "error":
            self._complained(heard)
        elif heard.what == "task" and self._on_task is not None:
            self._on_task(payload, CONTENT_TYPE)

    def _refused(self, heard: Heard) -> None:
        self.counters.count("refusals")
        self._is_refused, self.counters.reporting = True, False
        if _is_told(self.counters.refusals):
            so_far = _so_far(self.counters.refusals)
            self._tell(f"{self.address} refused the registration{so_far}{_said(heard)}")

    def _complained(self, heard: Heard) -> None:
        """Count it, and tell of some, by their number in the session."""
        self.counters.count("errors")
        number = self.counters.totals.sapient_errors
        if _is_told(number):
            so_far = _so_far(number)
            self._tell(f"the middleware complains{so_far}{_said(heard)}")

    def _tell(self, what: str, level: int = logging.WARNING) -> None:
        self._news.tell(self.name, what, level)

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


def _is_told(number: int) -> bool:
    """Whether the so-manieth of a kind is worth a line: the first, the tenth, the hundredth."""
    return str(number).rstrip("0") == "1"


def _so_far(number: int) -> str:
    return f" ({number} times so far)" if number > 1 else ""


def _said(heard: Heard) -> str:
    """Reasons of an answer in a line, as far as a line goes."""
    text = " ".join("; ".join(reason[:MAX_SAID] for reason in heard.reasons).split())
    return f": {printable(text)[:MAX_SAID]}" if text else ""

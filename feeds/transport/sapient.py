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

from plotfeed.feeds.console.printed import printable
from plotfeed.feeds.formats.sapient.sapient_announcer import (
    SapientAnnouncer,
    is_answer,
    is_registration,
)
from plotfeed.feeds.formats.sapient.sapient_node import CONTENT_TYPE
from plotfeed.feeds.link.counters import SapientCounters
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.transports import ImmediateTransport
from plotfeed.feeds.scene.fields import split_address
from plotfeed.feeds.scene.output_keys import SapientKeys
from plotfeed.feeds.timing.clock import Clock
from plotfeed.feeds.transport.ways_out import MAX_SAID, TransportError, backoff_s, wait_while
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


class SapientWire:
    """One connection. While what came waits for its turn, hardly more is read."""

    def __init__(
        self, said: asyncio.StreamReader, writer: asyncio.StreamWriter, give_up_after_s: float
    ) -> None:
        """A peer that has read nothing for `give_up_after_s` is left."""
        self._loop = asyncio.get_running_loop()
        self._said, self._writer, self._give_up_after_s = said, writer, give_up_after_s
        self._waits = asyncio.Event()  # The socket has not taken everything
        self._since_s = 0.0  # When it began to wait
        writer.transport.set_write_buffer_limits(high=0)  # to be told when all is taken
        own = writer.get_extra_info("socket")
        own.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_OCTETS)
        if hasattr(socket, "TCP_USER_TIMEOUT"):  # sees also a host that is gone without a word
            own.setsockopt(
                socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(give_up_after_s * 1000)
            )

    async def hear(self, intake: SapientIntake, on_message: Callable[[bytes], object]) -> None:
        """Take in messages, each in its turn, until the connection is lost: raises for which."""
        while True:
            message = await next_message(self._said)
            await intake.turn(LENGTH_OCTETS + len(message))
            on_message(message)

    async def watch(self) -> None:
        """Wait for a peer that has stalled; raises `TimeoutError` when that has taken too long."""
        while True:
            await self._waits.wait()
            async with asyncio.timeout(self._give_up_after_s):
                await self._writer.drain()
            self._waits.clear()

    @property
    def unsent_octets(self) -> int:
        """What the socket has not taken yet."""
        return self._writer.transport.get_write_buffer_size()

    def send(self, payload: bytes) -> bool:
        """Hand a message to the socket; False if it is gone or has stalled."""
        if self._writer.is_closing():
            return False
        if self._waits.is_set():
            stall_s = self._loop.time() - self._since_s
            if stall_s > MAX_STALL_S or self.unsent_octets + len(payload) > MAX_UNSENT_OCTETS:
                return False
        self._writer.write(framed(payload))
        if self.unsent_octets and not self._waits.is_set():
            self._since_s = self._loop.time()
            self._waits.set()
        return True

    async def close(self) -> None:
        """Close when all is sent, or that has taken long enough."""
        self._writer.close()
        with contextlib.suppress(OSError, TimeoutError):
            async with asyncio.timeout(CLOSE_S):
                await self._writer.wait_closed()
        self.abort()

    def abort(self) -> None:
        """Close at once."""
        self._writer.transport.abort()


CONNECT_TIMEOUT_S, CLOSE_S = 2.0, 1.0
ACK_TIMEOUT_S = 2.0
REGISTER_AGAIN_S = 10.0  # Who was refused asks so often whether that has changed
# A connection that lasted less counts as a failure: whoever hangs up at once is not hurried.
STEADY_S = 5.0


class SapientTcpTransport(ImmediateTransport):
    """One sensor's connection: kept up while `run` runs, publishing unless it is refused."""

    to = "SAPIENT"

    def __init__(
        self,
        sensor: str,
        address: str,
        settings: SapientKeys,
        announcer: SapientAnnouncer,
        *,
        clock: Clock,
        intake: SapientIntake,
        news: SapientNews,
        counters: SapientCounters,
        on_task: Callable[[bytes, str | None], object] | None = None,
    ) -> None:
        """`address` is the middleware's; `on_task` is given what holds a task, and its type."""
        self.address = address
        self.name = f"sapient-{sensor}"
        self.counters = counters
        self.last_error = ""
        self._give_up_after_s = settings.give_up_after_s
        self._announcer = announcer
        self._clock = clock
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
            if self._wire is not None:
                await self._wire.close()

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
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(wire.hear(self._intake, self._hear), name=self.name)
                tasks.create_task(wire.watch())
                await self._register(wire)
        except ExceptionGroup as lost:
            wire.abort()
            raise self._why(lost.exceptions[0]) from None
        finally:
            self._ended()

    def _why(self, lost: Exception) -> Exception:
        """What ended a connection, in words."""
        if isinstance(lost, DecodeError):  # there is no telling where another message begins
            return TransportError(f"it sent {lost}")
        if isinstance(lost, TimeoutError):
            self.counters.count("stalls")
            return TransportError(f"it has read nothing for {self._give_up_after_s:g} s")
        if isinstance(lost, EOFError):  # it says no more
            amid = "" if self._up.is_set() else " at the registration"
            return TransportError(f"the connection was closed{amid}")
        return TransportError(lost.strerror or str(lost)) if isinstance(lost, OSError) else lost

    def _ended(self) -> None:
        self._up.clear()
        self._is_refused = self.counters.reporting = False

    async def _connected(self) -> SapientWire:
        host, port = split_address(self.address)
        self._answered.clear()
        try:
            async with asyncio.timeout(CONNECT_TIMEOUT_S):
                streams = await asyncio.open_connection(host, port, limit=MAX_MESSAGE_OCTETS)
        except TimeoutError:
            raise TransportError("no answer") from None
        except (OSError, UnicodeError) as error:
            why = (error.strerror if isinstance(error, OSError) else None) or str(error)
            raise TransportError(why) from None
        return SapientWire(*streams, self._give_up_after_s)

    async def _register(self, wire: SapientWire) -> None:
        """Register, and wait a while for the answer; without any, report all the same."""
        self._say_registration(wire)
        try:
            async with asyncio.timeout(ACK_TIMEOUT_S):
                await self._answered.wait()
        except TimeoutError:
            self._tell(f"{self.address} did not acknowledge the registration")
            self._report()
        self.counters.count("connections")
        self._up.set()
        if self._loss_told:
            self._tell(f"connected to {self.address} again", logging.INFO)
            self._loss_told = False
        while True:
            await asyncio.sleep(REGISTER_AGAIN_S)
            if self._is_refused:
                self._say_registration(wire)

    def _say_registration(self, wire: SapientWire) -> None:
        registration, _ = self._announcer.opening(self._clock.now_ns())
        wire.send(registration.payload)

    def _report(self) -> None:
        """Begin to report, with how the sensor is."""
        self._is_refused, self.counters.reporting = False, True
        if self._wire is not None:
            _, status = self._announcer.opening(self._clock.now_ns())
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
            self.counters.count("refusals")
            self._is_refused, self.counters.reporting = True, False
            what = f"{self.address} refused the registration"
            self._tell_some(what, self.counters.refusals, heard)
            self._answered.set()
        elif heard.what == "error":
            self.counters.count("errors")
            number = self.counters.totals.sapient_errors  # of all sensors in the session
            self._tell_some("the middleware complains", number, heard)
        elif heard.what == "task" and self._on_task is not None:
            self._on_task(payload, CONTENT_TYPE)

    def _tell_some(self, what: str, number: int, heard: Heard) -> None:
        """Tell of the first, the tenth, the hundredth of a kind, and why as far as a line goes."""
        if str(number).rstrip("0") != "1":
            return
        so_far = f" ({number} times so far)" if number > 1 else ""
        text = " ".join("; ".join(reason[:MAX_SAID] for reason in heard.reasons).split())
        self._tell(f"{what}{so_far}" + (f": {printable(text)[:MAX_SAID]}" if text else ""))

    def _tell(self, what: str, level: int = logging.WARNING) -> None:
        self._news.tell(self.name, what, level)

"""A node's own connection to a SAPIENT middleware: registered first, kept up, its answers heard."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Sequence
from typing import Any

from plotfeed.feeds.console.printed import printable
from plotfeed.feeds.formats import Announcer
from plotfeed.feeds.formats.sapient.sapient_announcer import is_answer, is_registration
from plotfeed.feeds.formats.sapient.sapient_node import CONTENT_TYPE
from plotfeed.feeds.link.counters import SapientCounters
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.outgoing import ImmediateTransport, Outgoing
from plotfeed.feeds.scene.fields import split_address
from plotfeed.feeds.scene.output_keys import SapientKeys
from plotfeed.feeds.timing.clock import Clock
from plotfeed.feeds.transport.patience import backoff_s, wait_while
from plotfeed.feeds.transport.sapient_intake import SapientIntake
from plotfeed.feeds.transport.sapient_news import SapientNews
from plotfeed.feeds.transport.sapient_wire import SapientWire
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.proto.sapient.decode_sapient import Heard, decode_heard

CONNECT_TIMEOUT_S = 2.0
ACK_TIMEOUT_S = 2.0
REGISTER_AGAIN_S = 10.0  # Who was refused asks so often whether that has changed
# A connection that lasted less counts as a failure: whoever hangs up at once is not hurried.
STEADY_S = 5.0
MAX_SAID = 200


class SapientError(PlotfeedError):
    """A middleware that cannot be reached."""

    exit_code = 1


class SapientTcpTransport(ImmediateTransport):
    """One sensor's connection: kept up while `run` runs, publishing unless it is refused."""

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
        """Return once it has registered; raises `SapientError` if it has not in that time."""
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

    def publish(self, outgoing: Sequence[Outgoing]) -> bool:
        """Send what is SAPIENT, and settle at once whether the connection, if any, took it."""
        for one in outgoing:
            delivered = None
            if self.carries(one.message):
                delivered = self._sent(one)
            one.settle(delivered=delivered, to="SAPIENT")
        return False

    async def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until the socket has taken what was published, or the time is up."""
        await wait_while(
            lambda: self._wire is not None and self._up.is_set() and self._wire.unsent_octets,
            timeout_s,
        )

    def _sent(self, one: Outgoing) -> bool:
        registers = is_registration(one.message)
        if registers and not self._has_opened:
            self._has_opened = True  # what a session begins with, the connection has begun with
            return True
        wire = self._wire if self._up.is_set() else None
        if wire is None:
            return False
        if self._is_refused and not registers and not is_answer(one.message):
            return False
        if not wire.send(one.message.payload):
            return False
        one.leave()
        return True

    async def _stay_connected(self) -> None:
        """One connection, from its beginning to its end; raises `SapientError` if there is none."""
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
            raise SapientError(wire.reason or "the connection was closed")
        except SapientError:
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
            raise SapientError("no answer") from None
        except (OSError, UnicodeError) as error:
            why = (error.strerror if isinstance(error, OSError) else None) or str(error)
            raise SapientError(why) from None
        return wire

    async def _register(self, wire: SapientWire) -> None:
        """Register, and wait a while for the answer; without any, report all the same."""
        self._say_registration(wire)
        answered = asyncio.ensure_future(self._answered.wait())
        either: set[asyncio.Future[Any]] = {answered, wire.lost}
        await asyncio.wait(either, timeout=ACK_TIMEOUT_S, return_when=asyncio.FIRST_COMPLETED)
        answered.cancel()
        if wire.lost.done():
            raise SapientError(wire.reason or "the connection was closed at the registration")
        if not self._answered.is_set():
            self._tell(f"{self.address} did not acknowledge the registration")
            self._report()

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

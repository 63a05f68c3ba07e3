"""Ways out to servers that may be away or slow: what waits for them, and when to try again."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import ssl
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence

from plotfeed.feeds.console.printed import printable
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.transports import Client
from plotfeed.feeds.scene.output_keys import QueuedDestination
from plotfeed.proto.errors import PlotfeedError

BACKOFF_S = (0.25, 0.5, 1.0, 2.0, 4.0)  # After the first failure, and the next ones in a row
LOOK_EVERY_S = 0.001


def backoff_s(failures: int) -> float:
    """How long to wait after a failure that so many others in a row came before."""
    return BACKOFF_S[min(failures, len(BACKOFF_S) - 1)]


async def wait_while(waits: Callable[[], object], timeout_s: float) -> None:
    """Return once nothing waits, or the time is up."""
    loop = asyncio.get_running_loop()
    deadline_s = loop.time() + timeout_s
    while waits() and loop.time() <= deadline_s:  # noqa: ASYNC110 - of any condition
        await asyncio.sleep(LOOK_EVERY_S)


MAX_SAID = 200

log = logging.getLogger(__name__)


class TransportError(PlotfeedError):
    """A server, a port or a place to which there is no way."""

    exit_code = 1


class SendError(TransportError):
    """A message that did not get through; `is_final` says that another try would not help."""

    def __init__(self, why: str, *, is_final: bool = False) -> None:
        super().__init__(printable(why)[:MAX_SAID])
        self.is_final = is_final


@contextlib.asynccontextmanager
async def within(timeout_s: float, late: str) -> AsyncIterator[None]:
    """What a server is to do in that time: what keeps it from that is a `SendError`.

    `late` is said before the seconds where the time is over.
    """
    try:
        async with asyncio.timeout(timeout_s):
            yield
    except TimeoutError:
        raise SendError(f"{late} {timeout_s:g} s") from None
    except ssl.SSLCertVerificationError as error:
        raise SendError(f"its certificate: {error.verify_message}") from None
    except OSError as error:
        raise SendError(error.strerror or str(error)) from None


class QueuedTransport:
    """Sends one message after the other to a server, while `run` runs; what waits has a limit.

    A server that fails is told of in one line, and in another when it works again.
    """

    def __init__(self, settings: QueuedDestination, name: str, *, retries: int | None) -> None:
        """`retries` of a message, None for as long as it is not too old to wait."""
        self.name, self.settings = name, settings
        self._carried = settings.content_type
        self._retries = retries
        self._queue: deque[Message] = deque()
        self._filled = asyncio.Event()
        self._fails = False

    async def send(self, message: Message) -> None:
        """Hand a message to the server; raises `SendError`. A call may be cancelled."""
        raise NotImplementedError

    def hang_up(self) -> None:
        """Close what is open."""
        raise NotImplementedError

    def is_steady(self) -> bool:
        """Whether what was sent last shows that the server works again."""
        return True

    def carries(self, message: Message) -> bool:
        """Whether it is of the format that goes there."""
        return message.content_type == self._carried

    def publish(self, messages: Sequence[Message]) -> bool:
        """Let what goes there wait its turn; the oldest gives way where there is no room."""
        for one in messages:
            if not self.carries(one):
                one.settle(delivered=None)
                continue
            if len(self._queue) >= self.settings.queue_messages:
                self._queue.popleft().settle(delivered=False, to=self.name)
            self._queue.append(one)
            self._filled.set()
        return False

    def waiting_of(self, client: Client) -> int:
        """How many messages of that client wait."""
        return sum(one.client is client for one in self._queue)

    def prepare(self, messages: Sequence[Message]) -> None:
        """Nothing can be done ahead of time."""

    async def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until nothing waits, or the time is up; a server that fails is not waited for."""
        await wait_while(lambda: self._queue and not self._fails, timeout_s)

    async def wait_until_up(self, timeout_s: float | None = None) -> None:
        """Nothing is waited for: who is away is told of when there is something to send."""

    async def run(self) -> None:
        """Send until cancelled; then settle what is left as not delivered."""
        tries = failures = 0
        try:
            while True:
                await self._filled.wait()
                one = self._queue[0]
                try:
                    await self.send(one)
                except SendError as error:
                    tries, failures = tries + 1, failures + 1
                    if not self._fails:
                        self._fails = True
                        log.warning("%s fails: %s; others get what is theirs", self.name, error)
                    gives_up = self._retries is not None and tries > self._retries
                    if error.is_final or gives_up:
                        self._settle(one, delivered=False)
                        tries = 0
                    if not error.is_final:
                        await asyncio.sleep(backoff_s(failures - 1))
                    continue
                tries = failures = 0
                if self._fails and self.is_steady():
                    self._fails = False
                    log.warning("%s takes what is sent again", self.name)
                one.leave()
                self._settle(one, delivered=True)
        finally:
            self.hang_up()
            for one in self._queue:
                one.settle(delivered=False, to=self.name)
            self._queue.clear()

    def _settle(self, one: Message, *, delivered: bool) -> None:
        """Say what became of a message, unless it has given way meanwhile."""
        if self._queue and self._queue[0] is one:
            self._queue.popleft()
            one.settle(delivered=delivered, to=self.name)
        if not self._queue:
            self._filled.clear()

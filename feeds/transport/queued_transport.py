"""Ways out to servers that may be away or slow: a bounded queue, tries anew, one line of news."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Sequence

from plotfeed.feeds.console.printed import printable
from plotfeed.feeds.delivery.counters import ClientCounters
from plotfeed.feeds.delivery.delivery import Delivery, MakeDeliveries
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.track_output_keys import QueuedDestination
from plotfeed.feeds.transport.patience import backoff_s, wait_while
from plotfeed.proto.errors import PlotfeedError

MAX_SAID = 200

log = logging.getLogger(__name__)


class SendError(PlotfeedError):
    """A message that did not get through; `is_final` says that another try would not help."""

    exit_code = 1

    def __init__(self, why: str, *, is_final: bool = False) -> None:
        super().__init__(printable(why)[:MAX_SAID])
        self.is_final = is_final


class QueuedTransport:
    """Sends one message after the other to a server, while `run` runs; what waits has a limit.

    A server that fails is told of in one line, and in another when it works again.
    """

    def __init__(self, settings: QueuedDestination, name: str, *, retries: int | None) -> None:
        """`retries` of a message, None for as long as it is not too old to wait."""
        self.name = name
        self._carried = settings.content_type
        self._limit = settings.queue_messages
        self._retries = retries
        self._queue: deque[Delivery] = deque()
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

    def publish(self, *deliveries: Delivery) -> None:
        """Let what goes there wait its turn; the oldest gives way where there is no room."""
        for delivery in deliveries:
            if not self.carries(delivery.message):
                delivery.settle(delivered=None)
                continue
            if len(self._queue) >= self._limit:
                self._queue.popleft().settle(delivered=False, to=self.name)
            self._queue.append(delivery)
            self._filled.set()

    def publish_together(self, messages: Sequence[Message], made: MakeDeliveries) -> bool:
        """Let what goes there wait its turn; whether nothing of it does."""
        if not any(map(self.carries, messages)):
            return True
        self.publish(*made())
        return False

    def waiting_of(self, client: ClientCounters) -> int:
        """How many messages of that client wait."""
        return sum(delivery.client is client for delivery in self._queue)

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
                delivery = self._queue[0]
                try:
                    await self.send(delivery.message)
                except SendError as error:
                    tries, failures = tries + 1, failures + 1
                    self._tell_of(error)
                    gives_up = self._retries is not None and tries > self._retries
                    if error.is_final or gives_up:
                        self._settle(delivery, delivered=False)
                        tries = 0
                    if not error.is_final:
                        await asyncio.sleep(backoff_s(failures - 1))
                    continue
                tries = failures = 0
                if self._fails and self.is_steady():
                    self._fails = False
                    log.warning("%s takes what is sent again", self.name)
                delivery.leave()
                self._settle(delivery, delivered=True)
        finally:
            self.hang_up()
            for delivery in self._queue:
                delivery.settle(delivered=False, to=self.name)
            self._queue.clear()

    def _settle(self, delivery: Delivery, *, delivered: bool) -> None:
        """Say what became of a message, unless it has given way meanwhile."""
        if self._queue and self._queue[0] is delivery:
            self._queue.popleft()
            delivery.settle(delivered=delivered, to=self.name)
        if not self._queue:
            self._filled.clear()

    def _tell_of(self, error: SendError) -> None:
        if not self._fails:
            self._fails = True
            log.warning("%s fails: %s; others get what is theirs", self.name, error)

"""A message on its way over all the links of a client, until it is known what became of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.timing.clock import Clock


class Delivery:
    """What links are given to carry. Each says once, by `settle`, whether it has delivered it."""

    __slots__ = ("_clock", "_on_settled", "_unsettled", "delivered", "message", "sent_utc_ns")

    def __init__(
        self,
        message: Message,
        clock: Clock,
        links: int,
        on_settled: Callable[[Delivery], None] | None = None,
    ) -> None:
        self.message = message
        self.delivered = True
        """Whether every link that has settled so far has delivered it."""
        self.sent_utc_ns: int | None = None
        """When the last link began to send it; None before any has."""
        self._clock = clock
        self._unsettled = links
        self._on_settled = on_settled

    def leave(self) -> None:
        """A link hands it to its socket now."""
        self.sent_utc_ns = self._clock.now_ns()

    def settle(self, *, delivered: bool) -> None:
        """A link is done with it: delivered as far as it can know, or given up."""
        self.delivered &= delivered
        self._unsettled -= 1
        if not self._unsettled and self._on_settled is not None:
            self._on_settled(self)

    @property
    def is_settled(self) -> bool:
        """Whether every link is done with it."""
        return self._unsettled <= 0


class Transport(Protocol):
    """Something that carries messages away."""

    def publish(self, parcel: Delivery) -> None:
        """Take it; `leave` and `settle` it now or later, and never raise."""

    def publish_together(self, parcels: Sequence[Delivery]) -> None:
        """Take several that are due at once, in their order."""

    def prepare(self, messages: Sequence[Message]) -> None:
        """Do ahead of time what can be done for messages that will be published soon."""

    async def drain(self, timeout_s: float = ...) -> None:
        """Wait until everything has left, or the time is up."""


class ConnectedTransport(Transport, Protocol):
    """A link that has to be made, and made again, while the session runs."""

    name: str

    async def run(self) -> None:
        """Keep it up until cancelled; then settle what is left as not delivered."""

    async def wait_until_up(self, timeout_s: float | None = ...) -> None:
        """Return once it is up; raises `PlotfeedError` if it is not in that time."""

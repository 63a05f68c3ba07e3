"""What carries messages away, and for whom."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

from plotfeed.feeds.messages.message import Message


class Client(Protocol):
    """Whose messages go out: who tells the time, and counts what becomes of them."""

    def now_ns(self) -> int:
        """The time by which it sends, UTC."""

    def settled(self, message: Message) -> None:
        """The fate of one of its messages is known."""


class Transport(Protocol):
    """Something that carries messages away."""

    def carries(self, message: Message) -> bool:
        """Whether such a message is for its destination."""

    def waiting_of(self, client: Client) -> int:
        """Messages of that client that wait for a connection, or for room on it."""

    def publish(self, messages: Sequence[Message]) -> bool:
        """Take some that are due at once; never raise.

        True if all of it is delivered already, and nobody has told it; else the transport tells
        each by `settle`, now or later.
        """

    def prepare(self, messages: Sequence[Message]) -> None:
        """Do ahead of time what can be done for messages that will be published soon."""

    async def drain(self, timeout_s: float = ...) -> None:
        """Wait until everything has left, or the time is up."""


def given(of_transport: Iterable[tuple[Transport, Sequence[Message]]]) -> dict[Transport, int]:
    """Give each transport what is for it: those that took all of it at once, and when, UTC."""
    taken = {}
    for transport, some in of_transport:
        if some:
            sent_utc_ns = some[0].client.now_ns()
            if transport.publish(some):
                taken[transport] = sent_utc_ns
    return taken


def publish(
    transports: Sequence[Transport], messages: Sequence[Message], client: Client | None = None
) -> None:
    """Give each transport all of it, and only then tell what was delivered at once.

    Where the messages have no client yet, it is that one.
    """
    if client is not None:
        for one in messages:
            one.client, one.unsettled = client, len(transports)
    taken = given((transport, messages) for transport in transports)
    for sent_utc_ns in taken.values():
        for one in messages:
            one.taken(sent_utc_ns)


class ImmediateTransport:
    """A transport that keeps nothing back: it takes each message at once, or does not."""

    to: str  # What the ledger calls the place that does not get what is not taken

    def carries(self, message: Message) -> bool:
        """Whether such a message is for its destination."""
        raise NotImplementedError

    def give(self, message: Message) -> bool | None:
        """Hand a message on; whether it was taken, None where that is for others."""
        raise NotImplementedError

    def publish(self, messages: Sequence[Message]) -> bool:
        """Hand on what it carries, and settle at once what was taken."""
        for one in messages:
            delivered = self.give(one) if self.carries(one) else None
            if delivered:
                one.leave()
            one.settle(delivered=delivered, to=self.to)
        return False

    def waiting_of(self, _client: Client) -> int:
        """Nothing waits."""
        return 0

    def prepare(self, _messages: Sequence[Message]) -> None:
        """Nothing can be done ahead of time."""

    async def drain(self, timeout_s: float = 1.0) -> None:
        """Nothing is kept that could take any time."""


class KeptUp(Protocol):
    """What has to be connected, and connected again, while the session runs."""

    name: str

    async def run(self) -> None:
        """Keep it up until cancelled; then settle what is left as not delivered."""

    async def wait_until_up(self, timeout_s: float | None = ...) -> None:
        """Return once it is up; raises `PlotfeedError` if it is not in that time."""

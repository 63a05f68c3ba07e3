"""Copies of messages on their way over transports, and what becomes of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from plotfeed.feeds.delivery.counters import ClientCounters, SessionCounters
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.timing.clock import Clock
from plotfeed.proto import plotfeed_pb2 as pb


class DeliveryOwner(Protocol):
    """Whoever counts what becomes of deliveries, such as a ledger entry."""

    def settled(self, delivery: Delivery) -> None:
        """The fate of one of its deliveries is known."""


class Delivery:
    """One copy of a message. Each transport says once, by `settle`, whether it has delivered it."""

    __slots__ = (
        "_clock",
        "_unsettled",
        "client",
        "copy",
        "delivered",
        "due_utc_ns",
        "fate",
        "flipped_bit",
        "link_due_utc_ns",
        "message",
        "not_to",
        "number",
        "owner",
        "sent_utc_ns",
        "since_s",
    )

    def __init__(
        self,
        message: Message,
        clock: Clock,
        transports: int,
        owner: DeliveryOwner | None = None,
        *,
        number: int = 0,
        copy: int = 0,
        client: ClientCounters | None = None,
    ) -> None:
        self.message = message
        self.owner = owner
        self.client = client
        """Counts of whom it is of, who has room of his own where it must wait."""
        self.number = number
        """Of the message, in the order in which a client hands them to its link."""
        self.copy = copy
        """0 for the message itself, 1 for the duplicate that its link made."""
        self.due_utc_ns = self.link_due_utc_ns = message.due_utc_ns
        """When it enters the link, and when it leaves that."""
        self.flipped_bit: int | None = None
        """Of the payload, where the link has corrupted it."""
        self.fate: pb.Fate = pb.FATE_UNSPECIFIED
        self.delivered = False
        """Whether a transport has delivered it."""
        self.not_to: tuple[str, ...] = ()
        """Destinations that did not get it."""
        self.sent_utc_ns: int | None = None
        """When the last transport began to send it; None before any has."""
        self.since_s = 0.0
        """Monotonic time at which it first had to wait for a transport, or was first sent."""
        self._clock = clock
        self._unsettled = transports

    def leave(self) -> None:
        """A transport hands it to its socket now."""
        self.sent_utc_ns = self._clock.now_ns()

    def taken(self, sent_utc_ns: int) -> None:
        """A transport handed it to its socket then, which took all of it."""
        self.sent_utc_ns = max(self.sent_utc_ns or sent_utc_ns, sent_utc_ns)
        self.settle(delivered=True)

    def settle(self, *, delivered: bool | None, to: str = "") -> None:
        """A transport is done with it: delivered as far as it can know, or given up.

        `to` is what the transport calls its destination; None where that is for others.
        It is sent if a destination got it, or if none was to.
        """
        if delivered:
            self.delivered = True
        elif delivered is not None:
            self.not_to += (to,)
        self._unsettled -= 1
        if not self._unsettled:
            self.end(pb.SENT if self.delivered or not self.not_to else pb.UNDELIVERED)

    def end(self, fate: pb.Fate) -> None:
        """Note its fate, which is known now."""
        if fate == pb.SENT and self.sent_utc_ns is None:
            self.leave()
        self.fate = fate
        if self.owner is not None:
            self.owner.settled(self)

    @property
    def lateness_ns(self) -> int:
        """Sent after it was due at the end of its link."""
        return (self.sent_utc_ns or 0) - self.link_due_utc_ns

    def record(self) -> pb.Sent:
        """What the ledger says of it."""
        return pb.Sent(
            topic=self.message.topic,
            due_utc_ns=self.due_utc_ns,
            sent_utc_ns=self.sent_utc_ns or 0,
            octets=len(self.message.payload),
            delivered=self.fate == pb.SENT,
            fate=self.fate,
            link_due_utc_ns=self.link_due_utc_ns,
            number=self.number,
            copy=self.copy,
            flipped_bit=self.flipped_bit,
            not_to=self.not_to,
        )


MakeDeliveries = Callable[[], Sequence[Delivery]]
"""Makes the deliveries of messages that were given without, in their order; always the same."""


class Transport(Protocol):
    """Something that carries messages away."""

    def carries(self, message: Message) -> bool:
        """Whether such a message is for its destination."""

    def waiting_of(self, client: ClientCounters) -> int:
        """Messages of that client that wait for a connection, or for room on it."""

    def publish(self, *deliveries: Delivery) -> None:
        """Take some that are due at once; `leave` and `settle` each, now or later; never raise."""

    def publish_together(self, messages: Sequence[Message], made: MakeDeliveries) -> bool:
        """Take some that are due at once, in one go; whether all of it is delivered already.

        If not, `made` makes their deliveries, each of which is told of as by `publish`.
        """

    def prepare(self, messages: Sequence[Message]) -> None:
        """Do ahead of time what can be done for messages that will be published soon."""

    async def drain(self, timeout_s: float = ...) -> None:
        """Wait until everything has left, or the time is up."""


class ImmediateTransport:
    """A transport with which nothing waits, for those to inherit that keep nothing back."""

    def publish(self, *deliveries: Delivery) -> None:
        """Take some that are due at once, and `settle` each now; never raise."""
        raise NotImplementedError

    def publish_together(self, _messages: Sequence[Message], made: MakeDeliveries) -> bool:
        """Take them one by one."""
        self.publish(*made())
        return False

    def waiting_of(self, _client: ClientCounters) -> int:
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


class SentTogether:
    """Messages of one client that all left when they were due, over a link that does nothing."""

    __slots__ = ("messages", "number", "sent_utc_ns")

    def __init__(self, messages: Sequence[Message], number: int, sent_utc_ns: int) -> None:
        """`number` is that of the first; the others count on."""
        self.messages, self.number, self.sent_utc_ns = messages, number, sent_utc_ns

    def records(self) -> list[pb.Sent]:
        """What the ledger says of them."""
        sent_utc_ns, fate, found = self.sent_utc_ns, pb.SENT, []
        for number, message in enumerate(self.messages, self.number):
            due_utc_ns = message.due_utc_ns
            found.append(
                pb.Sent(
                    topic=message.topic,
                    due_utc_ns=due_utc_ns,
                    sent_utc_ns=sent_utc_ns,
                    octets=len(message.payload),
                    delivered=True,
                    fate=fate,
                    link_due_utc_ns=due_utc_ns,
                    number=number,
                )
            )
        return found


Settled = list[Delivery] | SentTogether
"""What has become of messages: all deliveries of an entry, or that all left at once."""
OnComplete = Callable[[Settled], object]
"""Given what has become of all messages of an entry, as soon as that is known."""


class LedgerEntry:
    """Owns and counts the deliveries that tell of one thing, such as a sector."""

    __slots__ = ("_closed", "_counters", "_deliveries", "_on_complete", "_totals", "_unsettled")

    def __init__(
        self, counters: ClientCounters, totals: SessionCounters, on_complete: OnComplete | None
    ) -> None:
        self._counters = counters
        self._totals = totals
        self._on_complete = on_complete
        self._deliveries: list[Delivery] = []
        self._unsettled = 0
        self._closed = False

    def deliver(
        self, message: Message, clock: Clock, transports: int, number: int, copy: int = 0
    ) -> Delivery:
        """Another message, or another copy of one, that is on its way from now on."""
        delivery = Delivery(
            message, clock, transports, self, number=number, copy=copy, client=self._counters
        )
        self._deliveries.append(delivery)
        self._counters.open_due_ns[delivery.due_utc_ns] += 1
        self._unsettled += 1
        return delivery

    def settled(self, delivery: Delivery) -> None:
        """The fate of one of its deliveries is known."""
        fate, copy, late_ns = delivery.fate, delivery.copy, delivery.lateness_ns
        self._counters.settle(fate, copy, late_ns)
        self._counters.close(delivery.due_utc_ns)
        self._totals.settle(fate, copy, late_ns, len(delivery.message.payload))
        if delivery.not_to:
            self._counters.leave_out(delivery.due_utc_ns, delivery.due_utc_ns)
        for to in delivery.not_to:
            self._counters.undelivered_to[to] += 1
            self._totals.undelivered_to[to] += 1
        self._unsettled -= 1
        if self._closed and not self._unsettled:
            self._complete()

    def close(self) -> None:
        """No more will come."""
        self._closed = True
        if not self._unsettled:
            self._complete()

    def _complete(self) -> None:
        deliveries, self._deliveries = self._deliveries, []
        if self._on_complete is not None:
            self._on_complete(deliveries)


def records(settled: Settled) -> list[pb.Sent]:
    """What the ledger says of them, in the order in which they were handed to the link."""
    if isinstance(settled, SentTogether):
        return settled.records()
    return [one.record() for one in sorted(settled, key=lambda one: (one.number, one.copy))]

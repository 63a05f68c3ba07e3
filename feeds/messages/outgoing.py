"""`Outgoing`: a message on its way, from the link that it passes to what became of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Protocol

from plotfeed.feeds.messages.message import Message
from plotfeed.proto import plotfeed_pb2 as pb

HELD_NS = 2**63 - 1  # Due when its link is up again: nobody knows yet when that is
# Number of a message that passes no link, such as a status: nobody asks what becomes of it.
NOT_COUNTED = -1


class Client(Protocol):
    """Whose messages go out: who tells the time, and counts what becomes of them."""

    def now_ns(self) -> int:
        """The time by which it sends, UTC."""

    def settled(self, outgoing: Outgoing) -> None:
        """The fate of one of its messages is known."""


class Countdown:
    """Calls a function once as many have settled as it was made for."""

    __slots__ = ("_call", "left")

    def __init__(self, left: int, call: Callable[[], object]) -> None:
        self.left, self._call = left, call

    def one_less(self) -> None:
        """Another has settled."""
        self.left -= 1
        if not self.left:
            self._call()


class Outgoing:
    """One copy of a message: when it is due, and what became of it.

    Its link says when it leaves, or that it does not. Each transport says once, by `settle` or
    `taken`, whether it has delivered it.
    """

    __slots__ = (
        "client",
        "copy",
        "countdown",
        "delivered",
        "due_utc_ns",
        "fate",
        "flipped_bit",
        "handed",
        "message",
        "not_to",
        "number",
        "over_link",
        "sent_utc_ns",
        "since_s",
        "unsettled",
    )

    def __init__(
        self,
        message: Message,
        number: int = NOT_COUNTED,
        copy: int = 0,
        *,
        client: Client | None = None,
        transports: int = 0,
    ) -> None:
        """`client` is whose it is and `transports` are how many will say what became of it."""
        self.handed = message  # As it was handed to the link
        self.message = message  # As it leaves the link, which may have corrupted it
        # Of the message, in the order in which a client hands them to its link.
        self.number = number
        self.copy = copy  # 0 for the message itself, 1 for the duplicate that its link made
        # When it leaves the link; `HELD_NS` while that holds it.
        self.due_utc_ns = message.due_utc_ns
        self.flipped_bit: int | None = None  # Of the payload, where the link has corrupted it
        self.over_link = False  # Whether there is a link that may do anything to it
        self.fate: pb.Fate = pb.FATE_UNSPECIFIED
        self.delivered = False  # Whether a transport has delivered it
        self.not_to: tuple[str, ...] = ()  # Destinations that did not get it
        self.sent_utc_ns = 0  # When the last transport began to send it; 0 before any has
        # Monotonic time at which it first had to wait for a transport, or was first sent.
        self.since_s = 0.0
        self.client: Any = client  # `Client | None`, which every use would have to ask
        self.countdown: Countdown | None = None
        # Transports of which it is not known yet whether they deliver it.
        self.unsettled = transports

    def duplicate(self) -> Outgoing:
        """Another copy of it, on its way as far as this one is."""
        other = Outgoing(self.handed, self.number, self.copy + 1)
        other.client, other.unsettled = self.client, self.unsettled
        other.over_link, other.countdown = self.over_link, self.countdown
        if self.countdown is not None:
            self.countdown.left += 1
        return other

    def leave(self) -> None:
        """A transport hands it to its socket now."""
        self.sent_utc_ns = self.client.now_ns()

    def taken(self, sent_utc_ns: int) -> None:
        """A transport handed it to its socket then, which took all of it."""
        self.sent_utc_ns = max(self.sent_utc_ns, sent_utc_ns)
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
        self.unsettled -= 1
        if not self.unsettled:
            self.end(pb.SENT if self.delivered or not self.not_to else pb.UNDELIVERED)

    def end(self, fate: pb.Fate) -> None:
        """Note its fate, which is known now."""
        if fate == pb.SENT and not self.sent_utc_ns:
            self.leave()
        self.fate = fate
        self.client.settled(self)
        countdown, self.countdown = self.countdown, None  # what it calls may hold this one
        if countdown is not None:
            countdown.one_less()

    def record(self) -> pb.Sent:
        """What the ledger says of it."""
        handed_utc_ns = self.handed.due_utc_ns
        return pb.Sent(
            topic=self.message.topic,
            due_utc_ns=handed_utc_ns,
            sent_utc_ns=self.sent_utc_ns,
            octets=len(self.message.payload),
            delivered=self.fate == pb.SENT,
            fate=self.fate,
            link_due_utc_ns=handed_utc_ns if self.due_utc_ns == HELD_NS else self.due_utc_ns,
            number=self.number,
            copy=self.copy,
            flipped_bit=self.flipped_bit,
            not_to=self.not_to,
        )


def records(outgoing: Sequence[Outgoing]) -> list[pb.Sent]:
    """What the ledger says of them, in the order in which they were handed to the link."""
    return [one.record() for one in sorted(outgoing, key=lambda one: (one.number, one.copy))]


class Transport(Protocol):
    """Something that carries messages away."""

    def carries(self, message: Message) -> bool:
        """Whether such a message is for its destination."""

    def waiting_of(self, client: Client) -> int:
        """Messages of that client that wait for a connection, or for room on it."""

    def publish(self, outgoing: Sequence[Outgoing]) -> bool:
        """Take some that are due at once; never raise.

        True if all of it is delivered already, and nobody has told it; else the transport tells
        each by `settle`, now or later.
        """

    def prepare(self, messages: Sequence[Message]) -> None:
        """Do ahead of time what can be done for messages that will be published soon."""

    async def drain(self, timeout_s: float = ...) -> None:
        """Wait until everything has left, or the time is up."""


def given(of_transport: Iterable[tuple[Transport, Sequence[Outgoing]]]) -> dict[Transport, int]:
    """Give each transport what is for it: those that took all of it at once, and when, UTC."""
    taken = {}
    for transport, some in of_transport:
        if some:
            sent_utc_ns = some[0].client.now_ns()
            if transport.publish(some):
                taken[transport] = sent_utc_ns
    return taken


def publish(transports: Iterable[Transport], outgoing: Sequence[Outgoing]) -> None:
    """Give each transport all of it, and only then tell what was delivered at once."""
    taken = given((transport, outgoing) for transport in transports)
    for sent_utc_ns in taken.values():
        for one in outgoing:
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

    def publish(self, outgoing: Sequence[Outgoing]) -> bool:
        """Hand on what it carries, and settle at once what was taken."""
        for one in outgoing:
            delivered = self.give(one.message) if self.carries(one.message) else None
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

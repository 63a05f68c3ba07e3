"""Where a sensor's messages leave: late and lossy as its link is, over all its connections."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

from plotfeed.feeds.delivery.counters import ClientCounters, SessionCounters
from plotfeed.feeds.delivery.delivery import (
    Delivery,
    LedgerEntry,
    OnComplete,
    SentTogether,
    Transport,
)
from plotfeed.feeds.impairment.link import Fate, Impairment, flip
from plotfeed.feeds.messages.bounded_queue import BoundedQueue
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.timing.clock import Clock
from plotfeed.feeds.timing.schedule import ActionKind, Schedule
from plotfeed.proto import plotfeed_pb2 as pb

InTime = Callable[[Message, int], Message | None]
"""The message as it may still leave at that time, or None if it is too late for it."""

_FATES = {
    Fate.LOST: pb.LOST,
    Fate.QUEUE_FULL: pb.QUEUE_FULL,
    Fate.OUTAGE: pb.OUTAGE,
}


class Outbox:
    """One client's way out: through its link's impairment, over all its transports."""

    def __init__(
        self,
        clock: Clock,
        transports: Sequence[Transport],
        *,
        schedule: Schedule | None = None,
        totals: SessionCounters | None = None,
        before_link: Sequence[Callable[[Message], object]] = (),
        after_link: Sequence[Callable[[Message, int], object]] = (),
        in_time: InTime | None = None,
        link: LinkSettings | None = None,
        impair: Callable[[LinkSettings], Impairment] | None = None,
    ) -> None:
        """`impair` makes the link's impairment, which delays by way of `schedule`.

        Without `link`, messages leave at once. `before_link` is told of every message as it is
        handed to the link, `after_link` of every copy as it leaves, and when.
        """
        self.counters = ClientCounters()
        self.transports = transports
        self.retained: dict[str, Message] = {}
        """What was last sent to stay, by topic, such as a status."""
        self._clock = clock
        self._schedule = Schedule() if schedule is None else schedule  # an empty one is false
        self.totals = totals or SessionCounters()
        self._before_link, self._after_link = before_link, after_link
        self._in_time = in_time
        self._impair = impair
        self._impairment = impair(link) if impair and link is not None else None
        self._number = 0
        self._on_the_way: set[Delivery] = set()
        self._held: BoundedQueue[tuple[Delivery, LedgerEntry]] = BoundedQueue(0)
        """What waits for the link to be up again."""

    @property
    def on_the_way(self) -> int:
        """Copies that the link holds."""
        return len(self._on_the_way) + len(self._held)

    @property
    def waiting(self) -> int:
        """Messages of this client that wait for a broker."""
        return sum(transport.waiting_of(self.counters) for transport in self.transports)

    @property
    def oldest_due_ns(self) -> int | None:
        """When the first was due that the link holds, or that waits to leave; None for nothing."""
        return min(self.counters.open_due_ns, default=None)

    def now_ns(self) -> int:
        """The time by which it sends, UTC."""
        return self._clock.now_ns()

    def prepare(self, messages: Sequence[Message]) -> None:
        """Do ahead of time what can be done for messages that will be sent soon."""
        for transport in self.transports:
            transport.prepare(messages)

    @property
    def is_perfect(self) -> bool:
        """Whether nothing lies between it and its transports: what is sent leaves at once."""
        return self._impairment is None

    def send(self, *messages: Message, on_complete: OnComplete | None = None) -> None:
        """Hand messages that are due at once to the link now.

        `on_complete` is told what became of them as soon as the fate of all of them is known.
        """
        if self._impairment is None:
            send_all([(self, messages, on_complete)])
            return
        entry = LedgerEntry(self.counters, self.totals, on_complete)
        for message in messages:
            for tell in self._before_link:
                tell(message)
            self._number += 1
            delivery = self._deliver(entry, message, self._number - 1)
            self._pass_link(delivery, entry, self._impairment, message.due_utc_ns)
        entry.close()

    def send_past_link(self, *messages: Message) -> None:
        """Send what is not the sensor's own traffic, such as its status."""
        deliveries: list[Delivery] = []

        def made() -> list[Delivery]:
            if not deliveries:
                settles, clock, client = len(self.transports), self._clock, self.counters
                deliveries.extend(Delivery(m, clock, settles, client=client) for m in messages)
            return deliveries

        for transport in self.transports:
            transport.publish_together(messages, made)  # nobody asks what becomes of them
        for message in messages:
            if message.retain:
                self.retained[message.topic] = message
        for tell in self._after_link:
            for message in messages:
                tell(message, self._clock.now_ns())

    def change(self, link: LinkSettings, at_utc_ns: int | None = None) -> None:
        """Have that link from then on, or now; what was held leaves if it is up again."""
        if self._impairment is not None:
            self._impairment.change(link)
        elif self._impair is not None:
            self._impairment = self._impair(link)
        else:
            raise ValueError("this client has no link")
        at_utc_ns = self._clock.now_ns() if at_utc_ns is None else at_utc_ns
        held = [self._held.take() for _ in range(len(self._held))]
        for delivery, entry in held:
            self._pass_link(delivery, entry, self._impairment, at_utc_ns)

    def end(self) -> None:
        """The session is over: what the link still holds does not arrive."""
        held = [delivery for delivery, _ in self._held.drop_all()]
        on_the_way, self._on_the_way = self._on_the_way, set()
        for delivery in [*held, *on_the_way]:
            delivery.end(pb.ENDED)

    async def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until the sockets have taken everything, or the time is up."""
        for transport in self.transports:
            await transport.drain(timeout_s)

    def _deliver(
        self, entry: LedgerEntry, message: Message, number: int, copy: int = 0
    ) -> Delivery:
        return entry.deliver(message, self._clock, len(self.transports), number, copy)

    def _pass_link(
        self, delivery: Delivery, entry: LedgerEntry, impairment: Impairment, due_utc_ns: int
    ) -> None:
        """Ask the link what becomes of a message, and see to that."""
        message = delivery.message
        outcome = impairment.pass_on(due_utc_ns, len(message.payload))
        if outcome.fate is Fate.HELD:
            self._held.limit = impairment.link.queue_messages
            if not self._held.put((delivery, entry)):
                delivery.end(pb.QUEUE_FULL)
            return
        if outcome.fate is not Fate.SENT:
            delivery.end(_FATES[outcome.fate])
            return
        for copy, (copy_due_utc_ns, flipped_bit) in enumerate(outcome.copies):
            if copy:
                delivery = self._deliver(entry, message, delivery.number, copy)
            delivery.link_due_utc_ns, delivery.flipped_bit = copy_due_utc_ns, flipped_bit
            if flipped_bit is not None:
                flipped = flip(message.payload, flipped_bit)
                delivery.message = replace(message, payload=flipped)
            self._plan(delivery)

    def _plan(self, delivery: Delivery) -> None:
        """Let a copy leave when it is due at the end of its link."""
        due_utc_ns = delivery.link_due_utc_ns
        if self._in_time is not None:
            message = self._in_time(delivery.message, due_utc_ns)
            if message is None:
                delivery.end(pb.STALE)
                return
            delivery.message = message
        if due_utc_ns <= delivery.due_utc_ns:
            self._depart((delivery,))
            return
        self._on_the_way.add(delivery)
        self._schedule.put(due_utc_ns, partial(self._arrive, delivery), ActionKind.DELIVERY)

    def _arrive(self, delivery: Delivery) -> None:
        if delivery in self._on_the_way:
            self._on_the_way.remove(delivery)
            self._depart((delivery,))

    def _depart(self, deliveries: Sequence[Delivery]) -> None:
        for transport in self.transports:
            transport.publish(*deliveries)
        for tell in self._after_link:
            for delivery in deliveries:
                tell(delivery.message, delivery.sent_utc_ns or self._clock.now_ns())
        if not self.transports:
            for delivery in deliveries:
                delivery.end(pb.SENT)


Departure = tuple[Outbox, Sequence[Message], OnComplete | None]
"""Messages of one client that are due at once, and who is told what became of them."""


def prepare_all(departures: Iterable[Departure]) -> None:
    """Do ahead of time what can be done for messages of many clients; asks each transport once."""
    of_transport: dict[Transport, list[Message]] = {}
    for outbox, messages, _ in departures:
        for transport in outbox.transports:
            of_transport.setdefault(transport, []).extend(messages)
    for transport, some in of_transport.items():
        transport.prepare(some)


def send_all(departures: Iterable[Departure]) -> None:
    """Hand messages of many clients, all due at once, to their links now, as `Outbox.send` does.

    Those whose link does nothing leave first: what goes over one transport is given to it in one
    go, in the order of the departures, and only then anybody is told.
    """
    leaving, impaired = [], []
    for departure in departures:
        if departure[0].is_perfect:
            leaving.append(_Leaving(*departure))
        else:
            impaired.append(departure)
    _leave(leaving)
    late_ns: dict[int, tuple[SessionCounters, list[int]]] = {}
    for one in leaving:
        totals = one.outbox.totals
        late_ns.setdefault(id(totals), (totals, []))[1].extend(one.tell())
    for totals, late in late_ns.values():
        totals.sent(late)
    for outbox, messages, on_complete in impaired:
        outbox.send(*messages, on_complete=on_complete)


def _leave(leaving: Sequence[_Leaving]) -> None:
    """Hand all to their transports, each of which is asked once."""
    of_transport: dict[Transport, list[_Leaving]] = {}
    for one in leaving:
        for transport in one.outbox.transports:
            of_transport.setdefault(transport, []).append(one)
    taken = []
    for transport, some in of_transport.items():
        messages = [message for one in some for message in one.messages]
        made = partial(_deliveries, some)
        sent_utc_ns = some[0].outbox.now_ns()
        if transport.publish_together(messages, made):
            taken.append((some, sent_utc_ns, transport))
    for some, sent_utc_ns, transport in taken:
        for one in some:
            one.taken(sent_utc_ns, transport)


def _deliveries(leaving: Sequence[_Leaving]) -> list[Delivery]:
    return [delivery for one in leaving for delivery in one.deliveries()]


class _Leaving:
    """A departure through a link that does nothing; deliveries are made of it where one must be."""

    __slots__ = ("_deliveries", "_number", "_on_complete", "messages", "outbox", "sent_utc_ns")

    def __init__(
        self, outbox: Outbox, messages: Sequence[Message], on_complete: OnComplete | None
    ) -> None:
        self.outbox, self.messages = outbox, messages
        self.sent_utc_ns = 0
        """When the last transport that took all at once did so; 0 before any."""
        self._on_complete = on_complete
        self._number = outbox._number
        self._deliveries: list[Delivery] | None = None
        outbox._number += len(messages)

    def deliveries(self) -> list[Delivery]:
        """One for each message; what transports have taken before is still to be told."""
        if self._deliveries is None:
            outbox = self.outbox
            entry = LedgerEntry(outbox.counters, outbox.totals, self._on_complete)
            self._deliveries = [
                outbox._deliver(entry, message, number)
                for number, message in enumerate(self.messages, self._number)
            ]
            entry.close()
        return self._deliveries

    def taken(self, sent_utc_ns: int, transport: Transport) -> None:
        """A transport has delivered all of it that it carries, handed over then."""
        self.sent_utc_ns = max(self.sent_utc_ns, sent_utc_ns)
        for delivery in self._deliveries or ():
            if transport.carries(delivery.message):
                delivery.taken(sent_utc_ns)
            else:
                delivery.settle(delivered=None)

    def tell(self) -> list[int]:
        """Tell and count what became of it, as far as that is known.

        How late its messages left in nanoseconds, which is still to be counted in the totals; of
        those that have deliveries these tell.
        """
        outbox, deliveries = self.outbox, self._deliveries
        for tell in outbox._before_link:
            for message in self.messages:
                tell(message)
        if deliveries is None:
            sent_utc_ns = self.sent_utc_ns or outbox.now_ns()
            late_ns = [sent_utc_ns - message.due_utc_ns for message in self.messages]
            for late in late_ns:
                outbox.counters.lateness_ns.append(late)
            if self._on_complete is not None:
                self._on_complete(SentTogether(self.messages, self._number, sent_utc_ns))
            for tell_time in outbox._after_link:
                for message in self.messages:
                    tell_time(message, sent_utc_ns)
            return late_ns
        for tell_time in outbox._after_link:
            for delivery in deliveries:
                tell_time(delivery.message, delivery.sent_utc_ns or outbox.now_ns())
        return []

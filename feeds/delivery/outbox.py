"""Where a sensor's messages leave: late and lossy as its link is, over all its connections."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from plotfeed.feeds.delivery.counters import ClientCounters, SessionCounters
from plotfeed.feeds.delivery.delivery import Delivery, LedgerEntry, OnComplete, Transport
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
        self._clock = clock
        self._schedule = Schedule() if schedule is None else schedule  # an empty one is false
        self._totals = totals or SessionCounters()
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
        """Messages that wait for a broker."""
        return sum(transport.waiting for transport in self.transports)

    def prepare(self, messages: Sequence[Message]) -> None:
        """Do ahead of time what can be done for messages that will be sent soon."""
        for transport in self.transports:
            transport.prepare(messages)

    def send(self, *messages: Message, on_complete: OnComplete | None = None) -> None:
        """Hand messages that are due at once to the link now.

        `on_complete` is given their deliveries as soon as the fate of all of them is known.
        """
        entry = LedgerEntry(self.counters, self._totals, on_complete)
        if self._impairment is None:
            for tell in self._before_link:
                for message in messages:
                    tell(message)
            self._depart([self._delivery(message, entry) for message in messages])
        else:
            for message in messages:
                for tell in self._before_link:
                    tell(message)
                delivery = self._delivery(message, entry)
                self._pass_link(delivery, entry, self._impairment, message.due_utc_ns)
        entry.close()

    def send_past_link(self, *messages: Message) -> None:
        """Send what is not the sensor's own traffic, such as its status."""
        deliveries = [Delivery(message, self._clock, len(self.transports)) for message in messages]
        for transport in self.transports:
            transport.publish(*deliveries)
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

    def _delivery(self, message: Message, entry: LedgerEntry) -> Delivery:
        self._number += 1
        return entry.deliver(message, self._clock, len(self.transports), self._number - 1)

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
                delivery = entry.deliver(
                    message, self._clock, len(self.transports), delivery.number, copy
                )
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

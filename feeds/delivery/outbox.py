"""Where a sensor's messages leave: late and lossy as its link is, over all its connections."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import cast

from plotfeed.feeds.delivery.counters import LATENESS_KEPT, LOSSES, SessionCounters
from plotfeed.feeds.delivery.delivery import Delivery, Transport
from plotfeed.feeds.delivery.ledger import LedgerEntry
from plotfeed.feeds.impairment.link import Copy, Fate, Impairment, flip
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


class Trip(Delivery):
    """One copy of a message on its way through a sensor's link and out."""

    __slots__ = (
        "account",
        "copy",
        "due_utc_ns",
        "fate",
        "flipped_bit",
        "link_due_utc_ns",
        "number",
    )

    def __init__(
        self,
        message: Message,
        clock: Clock,
        links: int,
        on_settled: Callable[[Delivery], None],
        *,
        number: int,
        account: LedgerEntry | None,
        copy: int = 0,
        link_due_utc_ns: int | None = None,
        flipped_bit: int | None = None,
    ) -> None:
        super().__init__(message, clock, links, on_settled)
        self.number = number
        self.account = account
        self.copy = copy
        self.due_utc_ns = message.due_utc_ns
        self.link_due_utc_ns = message.due_utc_ns if link_due_utc_ns is None else link_due_utc_ns
        self.flipped_bit = flipped_bit
        self.fate: pb.Fate = pb.FATE_UNSPECIFIED

    def told(self) -> pb.Sent:
        """For the ledger."""
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
        )


@dataclass(slots=True)
class _Counts:
    lost: int = 0
    duplicated: int = 0
    undelivered: int = 0
    lateness_ns: deque[int] = field(default_factory=lambda: deque(maxlen=LATENESS_KEPT))


class Outbox:
    """One client's way out: through its link's impairment, over all its connections."""

    def __init__(
        self,
        clock: Clock,
        links: Sequence[Transport],
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
        self.counts = _Counts()
        self.links = links
        self._clock = clock
        self._schedule = Schedule() if schedule is None else schedule  # an empty one is false
        self._totals = totals or SessionCounters()
        self._before_link, self._after_link = before_link, after_link
        self._in_time = in_time
        self._impair = impair
        self._impairment = impair(link) if impair and link is not None else None
        self._number = 0
        self._on_the_way: set[Trip] = set()
        self._held: deque[Trip] = deque()

    @property
    def on_the_way(self) -> int:
        """Copies that the link holds."""
        return len(self._on_the_way) + len(self._held)

    @property
    def waiting(self) -> int:
        """Messages that wait for a broker."""
        return sum(getattr(link, "waiting", 0) for link in self.links)

    def send(self, message: Message, account: LedgerEntry | None = None) -> None:
        """Hand a message to the link now; what becomes of each copy is told to `account`."""
        for tell in self._before_link:
            tell(message)
        trip = self._trip(message, account)
        if self._impairment is None:
            self._depart((trip,))
        else:
            self._hand_over(trip, self._impairment, message.due_utc_ns)

    def send_together(
        self, messages: Sequence[Message], account: LedgerEntry | None = None
    ) -> None:
        """The same with several that are due at once."""
        if self._impairment is not None:
            for message in messages:
                self.send(message, account)
            return
        for tell in self._before_link:
            for message in messages:
                tell(message)
        self._depart([self._trip(message, account) for message in messages])

    def prepare(self, messages: Sequence[Message]) -> None:
        """Do ahead of time what can be done for messages that will be sent soon."""
        for link in self.links:
            link.prepare(messages)

    def send_past_link(self, *messages: Message) -> None:
        """Send what is not the sensor's own traffic, such as its status."""
        parcels = [Delivery(message, self._clock, len(self.links)) for message in messages]
        for link in self.links:
            link.publish_together(parcels)
        for tell in self._after_link:
            for message in messages:
                tell(message, self._clock.now_ns())

    def change(self, link: LinkSettings, at_utc_ns: int | None = None) -> None:
        """From then on, or now, the link is that one; what it held leaves if it is up again."""
        if self._impairment is not None:
            self._impairment.change(link)
        elif self._impair is not None:
            self._impairment = self._impair(link)
        else:
            raise ValueError("this client has no link")
        held, self._held = self._held, deque()
        at_utc_ns = self._clock.now_ns() if at_utc_ns is None else at_utc_ns
        for trip in held:
            self._hand_over(trip, self._impairment, at_utc_ns)

    def end(self) -> None:
        """The session is over: what the link still holds does not arrive."""
        for trip in [*self._held, *self._on_the_way]:
            self._close(trip, pb.ENDED)
        self._held.clear()
        self._on_the_way.clear()

    async def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until the sockets have taken everything, or the time is up."""
        for link in self.links:
            await link.drain(timeout_s)

    def _trip(self, message: Message, account: LedgerEntry | None) -> Trip:
        number = self._number
        self._number += 1
        if account is not None:
            account.expect()
        return Trip(
            message, self._clock, len(self.links), self._settled, number=number, account=account
        )

    def _hand_over(self, trip: Trip, impairment: Impairment, due_utc_ns: int) -> None:
        """Ask the link what becomes of it, and see to that."""
        outcome = impairment.pass_on(due_utc_ns, len(trip.message.payload))
        if outcome.fate is Fate.HELD:
            if len(self._held) < impairment.link.queue_messages:
                self._held.append(trip)
            else:
                self._close(trip, pb.QUEUE_FULL)
            return
        if outcome.fate is not Fate.SENT:
            self._close(trip, _FATES[outcome.fate])
            return
        for number, copy in enumerate(outcome.copies):
            self._plan(self._copied(trip, number, copy), copy.due_utc_ns)

    def _copied(self, trip: Trip, number: int, copy: Copy) -> Trip:
        """The trip itself for the first copy, a new one for a duplicate."""
        message = trip.message
        if copy.flipped_bit is not None:
            message = replace(message, payload=flip(message.payload, copy.flipped_bit))
        if number and trip.account is not None:
            trip.account.expect()
        return Trip(
            message,
            self._clock,
            len(self.links),
            self._settled,
            number=trip.number,
            account=trip.account,
            copy=number,
            link_due_utc_ns=copy.due_utc_ns,
            flipped_bit=copy.flipped_bit,
        )

    def _plan(self, trip: Trip, due_utc_ns: int) -> None:
        if self._in_time is not None:
            message = self._in_time(trip.message, due_utc_ns)
            if message is None:
                self._close(trip, pb.STALE)
                return
            trip.message = message
        if due_utc_ns <= trip.due_utc_ns:
            self._depart((trip,))
            return
        self._on_the_way.add(trip)
        self._schedule.put(due_utc_ns, partial(self._arrive, trip), ActionKind.DELIVERY)

    def _arrive(self, trip: Trip) -> None:
        if trip in self._on_the_way:
            self._on_the_way.remove(trip)
            self._depart((trip,))

    def _depart(self, trips: Sequence[Trip]) -> None:
        """Out over every connection."""
        for link in self.links:
            link.publish_together(trips)
        for tell in self._after_link:
            for trip in trips:
                tell(trip.message, trip.sent_utc_ns or self._clock.now_ns())
        if not self.links:
            for trip in trips:
                self._settled(trip)

    def _settled(self, parcel: Delivery) -> None:
        trip = cast("Trip", parcel)  # it is told of its own trips alone
        if trip.delivered and trip.sent_utc_ns is None:
            trip.leave()
        self._close(trip, pb.SENT if trip.delivered else pb.UNDELIVERED)

    def _close(self, trip: Trip, fate: pb.Fate) -> None:
        """Count it, and tell the ledger."""
        lateness_ns = (trip.sent_utc_ns or 0) - trip.link_due_utc_ns
        counts = self.counts
        counts.lost += fate in LOSSES
        counts.undelivered += fate == pb.UNDELIVERED
        if fate == pb.SENT:
            counts.lateness_ns.append(lateness_ns)
            counts.duplicated += trip.copy > 0
        self._totals.settle(fate, trip.copy, lateness_ns)
        trip.fate = fate
        if trip.account is not None:
            trip.account.settle(trip)

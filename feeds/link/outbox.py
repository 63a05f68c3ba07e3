"""Where a client's messages leave, when their links let them, over all its connections."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

from plotfeed.feeds.link.counters import ClientCounters, SessionCounters
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.outgoing import (
    HELD_NS,
    NOT_COUNTED,
    Countdown,
    Outgoing,
    Transport,
    given,
    publish,
)
from plotfeed.feeds.timing.clock import Clock
from plotfeed.feeds.timing.schedule import ActionKind, Schedule
from plotfeed.proto import plotfeed_pb2 as pb

OnComplete = Callable[[], object]
# What a client hands to its link at once, and what to call when the fate of all is known.
Departure = tuple["Outbox", Sequence[Outgoing], OnComplete | None]


class Outbox:
    """One client's way out: what passes its link leaves over all its transports, and is counted."""

    def __init__(
        self,
        clock: Clock,
        transports: Sequence[Transport],
        *,
        schedule: Schedule | None = None,
        totals: SessionCounters | None = None,
        before_link: Sequence[Callable[[Message], object]] = (),
        after_link: Sequence[Callable[[Message, int], object]] = (),
    ) -> None:
        """What leaves later does so by `schedule`.

        `before_link` is told of every message as it is handed to the link, `after_link` of every
        copy as it leaves, and when.
        """
        self.counters = ClientCounters()
        self.transports = transports
        # What was last sent to stay, by topic, such as a status.
        self.retained: dict[str, Message] = {}
        self.totals = totals or SessionCounters()
        self._clock = clock
        self._schedule = Schedule() if schedule is None else schedule  # an empty one is false
        self._before_link, self._after_link = before_link, after_link
        self._on_the_way: dict[Outgoing, None] = {}
        self._open: dict[Outgoing, None] = {}  # Of which it is not known yet what becomes of them
        # What its link lets go at a time that is yet to come.
        self._to_let_go: set[Outgoing] = set()

    @property
    def on_the_way(self) -> int:
        """Copies that the link holds."""
        return len(self._on_the_way)

    @property
    def waiting(self) -> int:
        """Messages of this client that wait for a broker."""
        return sum(transport.waiting_of(self) for transport in self.transports)

    @property
    def oldest_due_ns(self) -> int | None:
        """When the first was due that the link holds, or that waits to leave; None for nothing."""
        return min((one.handed.due_utc_ns for one in self._open), default=None)

    def now_ns(self) -> int:
        """The time by which it sends, UTC."""
        return self._clock.now_ns()

    def send(self, outgoing: Sequence[Outgoing], on_complete: OnComplete | None = None) -> None:
        """Send what its link lets leave now, and the rest when that does.

        `on_complete` is called as soon as the fate of all of it is known.
        """
        send_all([(self, outgoing, on_complete)])

    def let_go(self, one: Outgoing, at_utc_ns: int) -> None:
        """Send what its link has held and lets go then, or do not, where its fate is known."""
        self._to_let_go.add(one)
        self._schedule.put(at_utc_ns, partial(self._let_go, one))

    def _let_go(self, one: Outgoing) -> None:
        self._to_let_go.remove(one)
        if one.client is None:  # it is still to be handed to the link, and leaves as others do
            return
        if one.copy:
            self._open[one] = None
        self._on_the_way.pop(one, None)
        if self._begin(one):
            self._leave([one])

    def send_past_link(self, *messages: Message) -> None:
        """Send what is not the sensor's own traffic, such as its status."""
        outgoing = [Outgoing(each, client=self) for each in messages]
        for transport in self.transports:
            transport.publish(outgoing)  # nobody asks what becomes of it
        for message in messages:
            if message.retain:
                self.retained[message.topic] = message
        for tell in self._after_link:
            for message in messages:
                tell(message, self._clock.now_ns())

    def end(self) -> None:
        """The session is over: what the link still holds does not arrive."""
        on_the_way, self._on_the_way = self._on_the_way, {}
        for one in on_the_way:
            one.end(pb.ENDED)

    async def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until the sockets have taken everything, or the time is up."""
        for transport in self.transports:
            await transport.drain(timeout_s)

    def settled(self, outgoing: Outgoing) -> None:
        """Count what became of one."""
        if outgoing.number == NOT_COUNTED:
            return
        fate, copy = outgoing.fate, outgoing.copy
        late_ns = outgoing.sent_utc_ns - outgoing.due_utc_ns
        self.counters.settle(fate, copy, late_ns)
        self.totals.settle(fate, copy, late_ns, len(outgoing.message.payload))
        if self._open:
            self._open.pop(outgoing, None)
        for to in outgoing.not_to:
            due_utc_ns = outgoing.handed.due_utc_ns
            self.counters.leave_out(due_utc_ns, due_utc_ns)
            self.counters.undelivered_to[to] += 1
            self.totals.undelivered_to[to] += 1

    def _begin(self, one: Outgoing) -> bool:
        """See to what its link says of one: whether it leaves now."""
        is_held = one.due_utc_ns == HELD_NS or one in self._to_let_go
        if one.fate and not is_held:
            one.end(one.fate)
        elif is_held or one.due_utc_ns > one.handed.due_utc_ns:
            self._on_the_way[one] = None
            if not is_held:
                arrive = partial(self._arrive, one)
                self._schedule.put(one.due_utc_ns, arrive, ActionKind.DELIVERY)
        else:
            return True
        return False

    def _note_taken(self, now: Sequence[Outgoing], taken: Mapping[Transport, int]) -> list[int]:
        """Count what transports have taken at once, by when they did.

        How late its messages left, nanoseconds, where that is still to be counted in the totals.
        """
        sent = [taken[transport] for transport in self.transports if transport in taken]
        if len(sent) < len(self.transports) or (now and now[0].over_link):
            for sent_utc_ns in sent:
                for one in now:
                    one.taken(sent_utc_ns)
            return []
        at_utc_ns, late_ns = max(sent, default=0) or self.now_ns(), []
        for one in now:
            one.sent_utc_ns, one.delivered, one.fate = at_utc_ns, True, pb.SENT
            late_ns.append(at_utc_ns - one.due_utc_ns)
        self.counters.lateness_ns.extend(late_ns)
        return late_ns

    def _arrive(self, one: Outgoing) -> None:
        if one in self._on_the_way:
            del self._on_the_way[one]
            self._leave([one])

    def _leave(self, outgoing: Sequence[Outgoing]) -> None:
        publish(self.transports, outgoing)
        self._left(outgoing)

    def _tell(self, outgoing: Sequence[Outgoing], now: Sequence[Outgoing]) -> None:
        """Tell of what was handed to the link, and of what has left now."""
        if not self._before_link and not self._after_link:
            self._left(now)
            return
        # A link takes one message after the other.
        together = [outgoing] if now is outgoing else [[one] for one in outgoing]
        for some in together:
            for tell in self._before_link:
                for one in some:
                    if not one.copy:
                        tell(one.handed)
            self._left(now if now is outgoing else [one for one in some if one in now])

    def _left(self, outgoing: Sequence[Outgoing]) -> None:
        if not self.transports:
            for one in outgoing:
                if not one.fate:
                    one.end(pb.SENT)
        for tell in self._after_link:
            for one in outgoing:
                tell(one.message, one.sent_utc_ns or self.now_ns())


def prepare_all(departures: Iterable[tuple[Outbox, Sequence[Outgoing]]]) -> None:
    """Do ahead of time what can be done for messages of many clients; asks each transport once."""
    of_transport: dict[Transport, list[Message]] = {}
    for outbox, outgoing in departures:
        messages = [one.message for one in outgoing if not one.fate]
        for transport in outbox.transports:
            of_transport.setdefault(transport, []).extend(messages)
    for transport, some in of_transport.items():
        transport.prepare(some)


def send_all(departures: Sequence[Departure]) -> None:
    """Send what clients hand to their links now, all of it due at once, as these let it leave.

    What goes over one transport is given to it in one go, and only then anybody is told. What
    passes no link goes first, else the order is that of the departures.
    """
    of_transport: dict[Transport, list[Outgoing]] = {}
    over_link = [each for each in departures if each[1] and each[1][0].over_link]
    past_link = [each for each in departures if not (each[1] and each[1][0].over_link)]
    leaving: list[tuple[Outbox, Sequence[Outgoing], Sequence[Outgoing], OnComplete | None]] = []
    for outbox, outgoing, on_complete in [*past_link, *over_link]:
        settles = len(outbox.transports)
        for one in outgoing:
            one.client, one.unsettled = outbox, settles
        now = outgoing
        if len(leaving) >= len(past_link):
            now = [one for one in outgoing if outbox._begin(one)]
        leaving.append((outbox, outgoing, now, on_complete))
        for transport in outbox.transports:
            of_transport.setdefault(transport, []).extend(now)
    taken = given(of_transport.items())
    late_ns: dict[int, tuple[SessionCounters, list[int]]] = {}
    for outbox, outgoing, now, on_complete in leaving:
        late = outbox._note_taken(now, taken)
        late_ns.setdefault(id(outbox.totals), (outbox.totals, []))[1].extend(late)
        outbox._tell(outgoing, now)
        if len(late) < len(outgoing) and (waiting := [one for one in outgoing if not one.fate]):
            outbox._open.update(dict.fromkeys(waiting))
            if on_complete is not None:
                countdown = Countdown(len(waiting), on_complete)
                for one in waiting:
                    one.countdown = countdown
        elif on_complete is not None:
            on_complete()
    for totals, lates in late_ns.values():
        totals.sent(lates)

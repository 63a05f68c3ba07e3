"""Where a client's messages leave, when their links let them, over all its connections."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, TypeVar

from plotfeed.feeds.link.counters import ClientCounters, SessionCounters
from plotfeed.feeds.messages.message import HELD_NS, NOT_COUNTED, Countdown, Message
from plotfeed.feeds.messages.transports import Transport, given, publish
from plotfeed.feeds.timing.clock import ActionKind, Clock, Schedule
from plotfeed.proto import plotfeed_pb2 as pb

T = TypeVar("T")
# What a client hands to its link at once, and what it is called once the fate of all is known.
Departure = tuple["Outbox", Sequence[Message], T]


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
        self._on_the_way: dict[Message, None] = {}
        self._open: dict[Message, None] = {}  # Of which it is not known yet what becomes of them
        # What its link lets go at a time that is yet to come.
        self._to_let_go: set[Message] = set()

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
        return min((one.due_utc_ns for one in self._open), default=None)

    def now_ns(self) -> int:
        """The time by which it sends, UTC."""
        return self._clock.now_ns()

    def send(
        self, messages: Sequence[Message], on_complete: Callable[[], object] | None = None
    ) -> None:
        """Send what its link lets leave now, and the rest when that does.

        `on_complete` is called as soon as the fate of all of it is known.
        """
        send_all([(self, messages, None)], lambda _: on_complete and on_complete())

    def let_go(self, one: Message, at_utc_ns: int) -> None:
        """Send what its link has held and lets go then, or do not, where its fate is known."""
        self._to_let_go.add(one)
        self._schedule.put(at_utc_ns, partial(self._let_go, one))

    def _let_go(self, one: Message) -> None:
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
        for message in messages:
            message.client = self
            if message.retain:
                self.retained[message.topic] = message
        for transport in self.transports:
            transport.publish(messages)  # nobody asks what becomes of it
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

    def settled(self, message: Message) -> None:
        """Count what became of one."""
        if message.number == NOT_COUNTED:
            return
        fate, copy = message.fate, message.copy
        late_ns = message.sent_utc_ns - message.leaves_utc_ns
        self.counters.settle(fate, copy, late_ns)
        self.totals.settle(fate, copy, late_ns, len(message.payload))
        if self._open:
            self._open.pop(message, None)
        for to in message.not_to:
            self.counters.leave_out(message.due_utc_ns, message.due_utc_ns)
            self.counters.undelivered_to[to] += 1
            self.totals.undelivered_to[to] += 1

    def _begin(self, one: Message) -> bool:
        """See to what its link says of one: whether it leaves now."""
        is_held = one.leaves_utc_ns == HELD_NS or one in self._to_let_go
        if one.fate and not is_held:
            one.end(one.fate)
        elif is_held or one.leaves_utc_ns > one.due_utc_ns:
            self._on_the_way[one] = None
            if not is_held:
                arrive = partial(self._arrive, one)
                self._schedule.put(one.leaves_utc_ns, arrive, ActionKind.DELIVERY)
        else:
            return True
        return False

    def _note_taken(
        self, now: Sequence[Message], sent_utc_ns: Sequence[int], at_utc_ns: int
    ) -> int:
        """Note when some transports, or by then all, have taken what leaves now.

        How many of it are sent, and still to be counted in the totals: past a link, they are late
        by as much as each other.
        """
        if not now:
            return 0
        if len(sent_utc_ns) < len(self.transports) or now[0].over_link:
            for taken_utc_ns in sent_utc_ns:
                for one in now:
                    one.taken(taken_utc_ns)
            return 0
        for one in now:
            one.sent_utc_ns, one.delivered, one.fate = at_utc_ns, True, pb.SENT
        self.counters.lateness_ns.append(at_utc_ns - now[0].leaves_utc_ns, len(now))
        return len(now)

    def _arrive(self, one: Message) -> None:
        if one in self._on_the_way:
            del self._on_the_way[one]
            self._leave([one])

    def _leave(self, messages: Sequence[Message]) -> None:
        publish(self.transports, messages)
        self._left(messages)

    def _tell(self, messages: Sequence[Message], now: Sequence[Message]) -> None:
        """Tell of what was handed to the link, and of what has left now."""
        if self.transports and not self._before_link and not self._after_link:
            return
        # A link takes one message after the other.
        together = [messages] if now is messages else [[one] for one in messages]
        leaves = {*now}
        for some in together:
            for tell in self._before_link:
                for one in some:
                    if not one.copy:
                        tell(one.handed)
            self._left(now if now is messages else [one for one in some if one in leaves])

    def _left(self, messages: Sequence[Message]) -> None:
        if not self.transports:
            for one in messages:
                if not one.fate:
                    one.end(pb.SENT)
        for tell in self._after_link:
            for one in messages:
                tell(one, one.sent_utc_ns or self.now_ns())


def prepare_all(departures: Iterable[Departure[Any]]) -> None:
    """Do ahead of time what can be done for messages of many clients; asks each transport once."""
    of_transport: dict[Transport, list[Message]] = {}
    for outbox, messages, _ in departures:
        for transport in outbox.transports:
            of_transport.setdefault(transport, []).extend(messages)
    for transport, some in of_transport.items():
        transport.prepare([one for one in some if not one.fate])


def send_all(departures: Sequence[Departure[T]], complete: Callable[[Sequence[T]], object]) -> None:
    """Send what clients hand to their links now, all of it due at once, as these let it leave.

    What goes over one transport is given to it in one go, and only then anybody is told. What
    passes no link goes first, else the order is that of the departures. `complete` is told of
    departures of whose messages it is known what became of all.
    """
    in_order = sorted(departures, key=lambda each: bool(each[1]) and each[1][0].over_link)
    of_transport: dict[Transport, list[Message]] = {}
    leaving: list[Sequence[Message]] = []
    for outbox, messages, _ in in_order:
        settles = len(outbox.transports)
        for one in messages:
            one.client, one.unsettled = outbox, settles
        now = messages
        if messages and messages[0].over_link:
            now = [one for one in messages if outbox._begin(one)]
        leaving.append(now)
        for transport in outbox.transports:
            of_transport.setdefault(transport, []).extend(now)
    taken = given(of_transport.items())
    done: list[T] = []
    sent: dict[tuple[SessionCounters, int], int] = {}
    transports: Sequence[Transport] | None = None
    now_ns = departures[0][0].now_ns() if departures else 0
    for (outbox, messages, what), now in zip(in_order, leaving, strict=True):
        if transports is not outbox.transports and transports != outbox.transports:
            transports = outbox.transports  # which clients of a session often have alike
            sent_ns = [taken[transport] for transport in transports if transport in taken]
            at_utc_ns = max(sent_ns, default=now_ns)
        if count := outbox._note_taken(now, sent_ns, at_utc_ns):
            alike = outbox.totals, at_utc_ns - now[0].leaves_utc_ns
            sent[alike] = sent.get(alike, 0) + count
        outbox._tell(messages, now)
        if count < len(messages) and (waiting := [one for one in messages if not one.fate]):
            outbox._open.update(dict.fromkeys(waiting))
            countdown = Countdown(len(waiting), partial(complete, [what]))
            for one in waiting:
                one.countdown = countdown
        else:
            done.append(what)
    for (totals, late_ns), number in sent.items():
        totals.sent(number, late_ns)
    if done:
        complete(done)

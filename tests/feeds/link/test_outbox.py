"""What clients send over their links and transports: when it leaves, and what becomes of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.link.counters import LastLateness, SessionCounters, lateness_us
from plotfeed.feeds.link.outbox import Departure, Outbox, send_all
from plotfeed.feeds.link.uplink import InTime, Uplink
from plotfeed.feeds.messages.message import SENT, UNDELIVERED, UNSPECIFIED, Message, records
from plotfeed.feeds.messages.transports import Client
from plotfeed.feeds.recording.recorder import RawFile
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.timing.clock import InstantClock, Schedule
from plotfeed.proto import plotfeed_pb2 as pb

MS = 1_000_000
ASTERIX = "application/x-asterix; cat=48"


def message(payload: bytes = b"abc", due_ns: int = 0, on: str = "t") -> Message:
    return Message(on, payload, ASTERIX, due_ns)


class Socket:
    """A transport that takes all at once and together, or each by itself: now, later or not."""

    def __init__(self, how: str = "at once", together: bool = False) -> None:
        self.how, self.together = how, together
        self.carried: list[bytes] = []
        self.kept: list[Message] = []
        self.writes = self.drained = 0

    def publish(self, outgoing: Sequence[Message]) -> bool:
        self.writes += 1
        if self.together and self.how == "at once":
            self.carried += [one.payload for one in outgoing]
            return True
        for one in outgoing:
            if self.how == "later":
                self.kept.append(one)
            else:
                self.settle(one, self.how == "at once" or self._takes(one))
        return False

    def settle(self, one: Message, delivered: bool) -> None:
        if delivered:
            one.leave()
            self.carried.append(one.payload)
        one.settle(delivered=delivered, to="here")

    def settle_kept(self) -> None:
        kept, self.kept = self.kept, []
        for one in kept:
            self.settle(one, self._takes(one))

    def _takes(self, one: Message) -> bool:
        return self.how != "nothing" and one.payload[0] % 3 > 0

    def carries(self, _message: Message) -> bool:
        return True

    def waiting_of(self, _client: Client) -> int:
        return len(self.kept)

    def prepare(self, _messages: Sequence[Message]) -> None:
        pass

    async def drain(self, _timeout_s: float = 1.0) -> None:
        self.drained += 1


def link_of(settings: Any) -> LinkSettings | None:
    return None if settings is None else LinkSettings.model_validate(settings)


class Case:
    """A client with everything around it, in simulated time."""

    def __init__(
        self, *sockets: Socket, link: Any = None, in_time: InTime | None = None, **more: Any
    ) -> None:
        self.now, self.schedule, self.totals = InstantClock(0), Schedule(), SessionCounters()
        self.entries: list[Sequence[pb.Sent]] = []
        self.outbox = Outbox(self.now, sockets, schedule=self.schedule, totals=self.totals, **more)
        self.uplink = Uplink(link_of(link), 1, "radar", in_time)

    def send(self, *messages: Message) -> None:
        outgoing = self.uplink.passed(messages)
        self.outbox.send(outgoing, lambda: self.entries.append(records(outgoing)))

    def change(self, **settings: Any) -> None:
        now_ns = self.now.now_ns()
        for one in self.uplink.change(LinkSettings.model_validate(settings), now_ns):
            self.outbox.let_go(one, now_ns)

    def until(self, t_utc_ns: int) -> None:
        while (due_ns := self.schedule.next_due_ns()) is not None and due_ns <= t_utc_ns:
            self.now.jump(due_ns)
            for _, action in self.schedule.due_by(due_ns):
                action()
        self.now.jump(t_utc_ns)


@pytest.mark.parametrize(
    ("takes", "delivered"),
    [("", True), ("y", True), ("n", False), ("yn", True), ("nn", False), ("yy", True)],
)
def test_a_message_is_delivered_if_a_transport_took_it(takes: str, delivered: bool) -> None:
    case = Case(*(Socket("at once" if each == "y" else "nothing") for each in takes))
    case.now.jump(100)
    case.send(message(due_ns=60))
    ((sent,),) = case.entries
    assert sent.delivered == delivered
    assert sent.fate == (pb.SENT if delivered else pb.UNDELIVERED)
    assert [*sent.not_to] == ["here"] * takes.count("n")
    assert case.totals.undelivered_to["here"] == takes.count("n")
    assert (sent.topic, sent.octets, sent.due_utc_ns, sent.link_due_utc_ns) == ("t", 3, 60, 60)
    assert (case.totals.messages, case.totals.undelivered) == ((1, 0) if delivered else (0, 1))
    assert case.outbox.counters.undelivered == case.totals.undelivered
    if delivered:
        assert sent.sent_utc_ns == 100
        assert list(case.totals.lateness_ns) == list(case.outbox.counters.lateness_ns) == [40]


def test_an_entry_is_complete_when_the_last_transport_has_settled() -> None:
    slow = Socket("later")
    case = Case(Socket(), slow)
    case.send()
    case.send(message(b"1"), message(b"2"))
    one, other = slow.kept
    slow.settle(other, delivered=False)
    assert case.entries == [[]]
    slow.settle(one, delivered=True)
    first, second = case.entries[1]
    assert [s.fate for s in (first, second)] == [pb.SENT, pb.SENT]
    assert [[*s.not_to] for s in (first, second)] == [[], ["here"]]
    assert [s.number for s in (first, second)] == [0, 1]


def test_a_link_delays_by_its_latency_and_the_lateness_is_counted_from_there() -> None:
    """Who listens sees what is handed over, and what leaves even when nobody takes it."""
    before, after = list[bytes](), list[tuple[bytes, int]]()
    case = Case(
        Socket("nothing"),
        link={"latency_ms": 120.0},
        before_link=[lambda m: before.append(m.payload)],
        after_link=[lambda m, t: after.append((m.payload, t))],
    )
    case.send(message(b"1"), message(b"2", due_ns=MS))
    case.until(119 * MS)
    assert (before, after, case.outbox.on_the_way, case.entries) == ([b"1", b"2"], [], 2, [])
    case.until(130 * MS)
    assert after == [(b"1", 120 * MS), (b"2", 121 * MS)]
    ((first, _),) = case.entries
    assert (first.due_utc_ns, first.link_due_utc_ns, first.fate) == (0, 120 * MS, pb.UNDELIVERED)
    assert case.outbox.on_the_way == 0


LOSE_ALL = {"loss": {"kind": "random", "probability": 1.0}}


@pytest.mark.parametrize(
    ("settings", "fate", "counted_as"),
    [
        (LOSE_ALL, pb.LOST, "lost"),
        ({"down": True}, pb.OUTAGE, "lost"),
        ({"latency_ms": 5.0}, pb.STALE, "stale"),
    ],
)
def test_what_a_link_loses_or_brings_too_late_is_in_the_ledger_and_not_published(
    settings: Any, fate: int, counted_as: str
) -> None:
    socket = Socket()
    in_time = lambda m, t: None if t - m.due_utc_ns > 4 * MS else m.payload  # noqa: E731
    case = Case(socket, link=settings, in_time=in_time)
    case.send(message())
    case.outbox.send_past_link(message(b"status"))
    ((sent,),) = case.entries
    assert (sent.fate, sent.delivered, sent.sent_utc_ns) == (fate, False, 0)
    assert socket.carried == [b"status"]
    assert getattr(case.totals, counted_as) == 1
    assert (case.totals.messages, case.outbox.counters.lost) == (0, counted_as == "lost")


def test_a_link_that_stalls_holds_what_comes_until_it_is_up_again() -> None:
    socket = Socket()
    case = Case(socket, link={"down": True, "on_loss": "stall", "latency_ms": 10.0})
    case.send(message(b"1"), message(b"2", due_ns=MS))
    case.until(50 * MS)
    assert (socket.carried, case.outbox.on_the_way) == ([], 2)
    case.change(latency_ms=10.0, on_loss="stall")
    case.until(100 * MS)
    assert socket.carried == [b"1", b"2"]
    ((first, second),) = case.entries
    assert (first.due_utc_ns, second.due_utc_ns) == (0, MS)
    assert first.sent_utc_ns == second.sent_utc_ns == 60 * MS


def test_a_link_changes_for_what_comes_and_what_it_holds_at_the_end_has_ended() -> None:
    socket = Socket()
    case = Case(socket)
    case.send(message(b"1"))
    case.change(latency_ms=7.0)
    case.send(message(b"2"))
    case.until(10 * MS)
    case.change(latency_ms=1000.0)
    case.send(message(b"3", due_ns=10 * MS))
    case.outbox.end()
    case.until(2000 * MS)
    assert socket.carried == [b"1", b"2"]
    sent = [(one.fate, one.sent_utc_ns, one.number) for (one,) in case.entries]
    assert sent == [(pb.SENT, 0, 0), (pb.SENT, 7 * MS, 1), (pb.ENDED, 0, 2)]
    assert (case.totals.ended, case.outbox.on_the_way) == (1, 0)


@pytest.mark.asyncio
async def test_every_transport_is_drained() -> None:
    sockets = [Socket(), Socket()]
    await Outbox(InstantClock(0), sockets).drain()
    assert [socket.drained for socket in sockets] == [1, 1]


@pytest.mark.parametrize("octets", [10, 100_000])
def test_a_full_disk_is_told_once_and_stops_nothing(octets: int) -> None:
    with RawFile(Path("/dev/full")) as raw:
        for _ in range(5):
            raw.after_link(message(b"x" * octets), 0)
    assert raw.failure == "/dev/full: No space left on device; what came after is not in the file"


def test_fates_of_messages_are_numbered_as_in_the_ledger() -> None:
    assert (UNSPECIFIED, SENT, UNDELIVERED) == (pb.FATE_UNSPECIFIED, pb.SENT, pb.UNDELIVERED)


# Clients that leave together, against the same ones that send one by one.

DUE_NS = 7_000
HOW = st.tuples(st.sampled_from(["at once", "later", "all but some"]), st.booleans())
SOME = {"loss": {"kind": "random", "probability": 0.5}}, {"duplicate": 0.5, "corrupt": 0.5}
LINKS = st.sampled_from([None, {}, *SOME])
CLIENTS = st.lists(st.tuples(st.integers(0, 4), LINKS, st.sets(st.integers(0, 2))), max_size=6)


class Clients:
    """Clients that share sockets, and all that is told of what they send."""

    def __init__(self, how: Sequence[tuple[str, bool]], clients: Sequence[Any]) -> None:
        self.sockets = [Socket(*each) for each in how]
        self.totals, clock = SessionCounters(), InstantClock(DUE_NS + 1000)
        self.told: list[tuple[str, bytes, int]] = []
        self.entries: dict[int, list[pb.Sent]] = {}
        self.departures = []
        for i, (number, link, left_out) in enumerate(clients):
            outbox = Outbox(
                clock,
                [each for k, each in enumerate(self.sockets) if k not in left_out],
                schedule=Schedule(),
                totals=self.totals,
                before_link=[lambda m: self.told.append(("before", m.payload, 0))],
                after_link=[lambda m, t: self.told.append(("after", m.payload, t))],
            )
            some = [message(bytes((k, i)), DUE_NS, f"s{i}") for k in range(number)]
            self.departures.append((outbox, Uplink(link_of(link), 1, f"s{i}"), some))

    def handed(self) -> list[Departure[Any]]:
        """What each hands over now, each time anew."""
        return [
            (outbox, outgoing, (i, outgoing))
            for i, (outbox, uplink, some) in enumerate(self.departures)
            for outgoing in [uplink.passed([one.again() for one in some])]
        ]

    def keep(self, complete: Sequence[tuple[int, Sequence[Message]]]) -> None:
        for i, outgoing in complete:
            assert i not in self.entries
            self.entries[i] = records(outgoing)

    def counts(self) -> list[Any]:
        each = [self.totals, *(outbox.counters for outbox, _, _ in self.departures)]
        return [
            {name: getattr(one, name) for name in one.__slots__ if name != "lateness_ns"}
            | {"lateness_ns": list(one.lateness_ns)}
            for one in each
        ]


@given(st.lists(HOW, max_size=3), CLIENTS)
def test_together_as_one_by_one(how: list[tuple[str, bool]], clients: list[Any]) -> None:
    """Twice, so that numbers go on."""
    together, apart = Clients(how, clients), Clients(how, clients)
    for _ in range(2):
        together.entries.clear()
        apart.entries.clear()
        send_all(together.handed(), together.keep)
        for outbox, outgoing, what in apart.handed():
            outbox.send(outgoing, partial(apart.keep, [what]))
        for socket in (*together.sockets, *apart.sockets):
            socket.settle_kept()
        assert together.entries == apart.entries
        assert together.entries.keys() == set(range(len(clients)))
    assert together.counts() == apart.counts()
    assert sorted(together.told) == sorted(apart.told)
    for one, other in zip(together.sockets, apart.sockets, strict=True):
        for i in range(len(clients)):  # whatever the others do
            of_client = [p for p in one.carried if p[1] == i]
            assert of_client == [p for p in other.carried if p[1] == i]


def test_each_socket_is_asked_once_and_before_anybody_is_told() -> None:
    number = 50
    case = Clients([("at once", True)] * 2, [(2, None, ())] * number)
    carried: list[int] = []

    def keep(done: Sequence[Any]) -> None:
        carried.extend(len(socket.carried) for socket in case.sockets for _ in done)

    send_all(case.handed(), keep)
    assert [socket.writes for socket in case.sockets] == [1, 1]
    payloads = [one.payload for _, _, some in case.departures for one in some]
    assert [socket.carried for socket in case.sockets] == [payloads, payloads]
    assert carried == [2 * number] * (2 * number)
    assert case.totals.messages == 2 * number


# How late what was sent last has left.

PARTS = st.tuples(st.integers(-(2**62), 2**62), st.integers(0, 300))


@given(st.integers(1, 100), st.lists(st.one_of(PARTS, st.none()), max_size=20))
def test_the_last_are_kept_in_order(most: int, parts: list[tuple[int, int] | None]) -> None:
    kept, expected = LastLateness(most), deque[int](maxlen=most)
    for part in parts:
        if part is None:
            kept.clear()
            expected.clear()
        else:
            value, times = part
            kept.append(value, times)
            expected.extend([value] * times)
            assert len(kept._values) < 2 * most  # and so the memory that they take
        assert len(kept) == len(expected)
        assert list(kept) == list(kept.values()) == list(expected)


@given(
    st.lists(st.integers(-(10**12), 10**12), min_size=1, max_size=50),
    st.lists(st.floats(0, 100), min_size=1, max_size=4),
)
def test_percentiles_are_those_of_numpy(values: list[int], percentiles: list[float]) -> None:
    kept = LastLateness(len(values))
    assert lateness_us(kept, *percentiles) == [0.0] * len(percentiles)
    for value in (10**12, *values):  # which gives way
        kept.append(value)
    expected = np.percentile(values, percentiles) / 1e3
    for given_as in (values, kept):
        found = lateness_us(given_as, *percentiles)
        assert found == pytest.approx(expected.tolist(), rel=1e-9, abs=1e-5)

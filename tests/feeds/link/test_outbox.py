from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from plotfeed.feeds.link.counters import SessionCounters, lateness_us
from plotfeed.feeds.link.outbox import Outbox
from plotfeed.feeds.link.uplink import Uplink
from plotfeed.feeds.messages.message import SENT, UNDELIVERED, UNSPECIFIED, Message, records
from plotfeed.feeds.messages.transports import Client
from plotfeed.feeds.recording.recorder import RawFile
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.timing.clock import InstantClock, Schedule
from plotfeed.proto import plotfeed_pb2 as pb

ASTERIX = "application/x-asterix; cat=48"
MS = 1_000_000


def message(payload: bytes = b"abc", content_type: str = ASTERIX, due_utc_ns: int = 0) -> Message:
    return Message(topic="t", payload=payload, content_type=content_type, due_utc_ns=due_utc_ns)


class Link:
    """Settles at once, or when it is told to."""

    def __init__(self, *, takes: bool | None = True) -> None:
        self.takes = takes
        self.drained = 0
        self.carried: list[bytes] = []
        self.kept: list[Message] = []

    def publish(self, outgoing: Sequence[Message]) -> None:
        for delivery in outgoing:
            if self.takes is None:
                self.kept.append(delivery)
            else:
                self.settle(delivery, delivered=self.takes)

    def carries(self, _message: Message) -> bool:
        return True

    def waiting_of(self, _client: Client) -> int:
        return len(self.kept)

    def settle(self, delivery: Message, *, delivered: bool) -> None:
        if delivered:
            delivery.leave()
            self.carried.append(delivery.payload)
        delivery.settle(delivered=delivered, to="here")

    async def drain(self, _timeout_s: float = 1.0) -> None:
        self.drained += 1


class Case:
    """An outbox with everything around it, in simulated time."""

    def __init__(
        self, links: Sequence[Link] = (), settings: Any = None, in_time: Any = None, **more: Any
    ) -> None:
        self.now = InstantClock(0)
        self.schedule, self.totals = Schedule(), SessionCounters()
        self.entries: list[Sequence[pb.Sent]] = []
        self.outbox = Outbox(self.now, links, schedule=self.schedule, totals=self.totals, **more)
        link = None if settings is None else LinkSettings.model_validate(settings)
        self.uplink = Uplink(link, 1, "radar", in_time)

    def send(self, *messages: Message) -> None:
        outgoing = self.uplink.passed(messages)
        self.outbox.send(outgoing, lambda: self.entries.append(records(outgoing)))

    def change(self, **settings: Any) -> None:
        now_ns = self.now.now_ns()
        for one in self.uplink.change(LinkSettings.model_validate(settings), now_ns):
            self.outbox.let_go(one, now_ns)

    async def until(self, t_utc_ns: int) -> None:
        while (due_ns := self.schedule.next_due_ns()) is not None and due_ns <= t_utc_ns:
            await self.now.sleep_until(due_ns)
            for _, action in self.schedule.due_by(due_ns):
                action()
        await self.now.sleep_until(t_utc_ns)


@pytest.mark.parametrize(
    ("takes", "delivered"),
    [
        ([], True),
        ([True], True),
        ([False], False),
        ([True, False], True),
        ([False, False], False),
        ([True, True], True),
    ],
)
@pytest.mark.asyncio
async def test_a_message_is_delivered_if_a_link_took_it(takes: list[bool], delivered: bool) -> None:
    case = Case([Link(takes=t) for t in takes])
    await case.now.sleep_until(100)
    case.send(message(due_utc_ns=60))
    ((sent,),) = case.entries
    assert sent.delivered == delivered
    assert sent.fate == (pb.SENT if delivered else pb.UNDELIVERED)
    assert [*sent.not_to] == ["here"] * takes.count(False)
    assert case.totals.undelivered_to["here"] == takes.count(False)
    assert (sent.topic, sent.octets, sent.due_utc_ns, sent.link_due_utc_ns) == ("t", 3, 60, 60)
    assert (case.totals.messages, case.totals.undelivered) == ((1, 0) if delivered else (0, 1))
    if delivered:
        assert sent.sent_utc_ns == 100
        assert list(case.totals.lateness_ns) == list(case.outbox.counters.lateness_ns) == [40]


def test_an_entry_is_complete_when_the_last_link_has_settled() -> None:
    slow = Link(takes=None)
    case = Case([Link(), slow])
    case.send(message(b"1"), message(b"2"))
    assert case.entries == []
    slow.settle(slow.kept[1], delivered=False)
    assert case.entries == []
    slow.settle(slow.kept[0], delivered=True)
    ((first, second),) = case.entries
    assert [s.fate for s in (first, second)] == [pb.SENT, pb.SENT]
    assert [[*s.not_to] for s in (first, second)] == [[], ["here"]]
    assert [s.number for s in (first, second)] == [0, 1]


def test_an_entry_without_messages_is_complete_at_once() -> None:
    case = Case()
    case.send()
    assert case.entries == [[]]


@pytest.mark.asyncio
async def test_taps_see_what_is_handed_over_and_what_leaves_even_when_nobody_takes_it() -> None:
    before: list[bytes] = []
    after: list[tuple[bytes, int]] = []
    case = Case(
        [Link(takes=False)],
        {"latency_ms": 5.0},
        before_link=[lambda m: before.append(m.payload)],
        after_link=[lambda m, t: after.append((m.payload, t))],
    )
    case.send(message(b"1"), message(b"2", due_utc_ns=MS))
    assert (before, after) == ([b"1", b"2"], [])
    await case.until(10 * MS)
    assert after == [(b"1", 5 * MS), (b"2", 6 * MS)]


@pytest.mark.asyncio
async def test_a_link_delays_by_its_latency_and_the_lateness_is_counted_from_there() -> None:
    link = Link()
    case = Case([link], {"latency_ms": 120.0})
    case.send(message())
    await case.until(119 * MS)
    assert (link.carried, case.outbox.on_the_way, case.entries) == ([], 1, [])
    await case.until(120 * MS)
    ((sent,),) = case.entries
    assert (sent.due_utc_ns, sent.link_due_utc_ns, sent.sent_utc_ns) == (0, 120 * MS, 120 * MS)
    assert list(case.totals.lateness_ns) == [0]
    assert case.outbox.on_the_way == 0


@pytest.mark.parametrize(
    ("settings", "fate"),
    [({"loss": {"kind": "random", "probability": 1.0}}, pb.LOST), ({"down": True}, pb.OUTAGE)],
)
def test_what_a_link_loses_is_in_the_ledger_and_not_published(settings: Any, fate: int) -> None:
    link = Link()
    case = Case([link], settings)
    case.send(message())
    ((sent,),) = case.entries
    assert (sent.fate, sent.delivered, sent.sent_utc_ns, link.carried) == (fate, False, 0, [])
    assert case.totals.lost == case.outbox.counters.lost == 1


@pytest.mark.asyncio
async def test_a_full_queue_of_a_slow_link_loses_what_comes_last() -> None:
    link = Link()
    case = Case([link], {"rate_kbit_s": 1.0, "queue_messages": 2})
    case.send(*(message(bytes([i]) * 125) for i in range(4)))  # a second each
    await case.until(10_000 * MS)
    ((*entry,),) = case.entries
    assert [s.fate for s in entry] == [pb.SENT, pb.SENT, pb.QUEUE_FULL, pb.QUEUE_FULL]
    assert [s.sent_utc_ns for s in entry[:2]] == [1000 * MS, 2000 * MS]


@pytest.mark.asyncio
async def test_duplicates_and_flipped_bits_are_told_apart() -> None:
    link = Link()
    case = Case([link], {"duplicate": 1.0, "corrupt": 1.0, "latency_ms": 1.0})
    case.send(message(b"\0\0"))
    await case.until(2 * MS)
    ((first, second),) = case.entries
    assert [(s.number, s.copy) for s in (first, second)] == [(0, 0), (0, 1)]
    assert (case.totals.messages, case.totals.duplicated) == (2, 1)
    for sent, payload in zip((first, second), link.carried, strict=True):
        flipped = int.from_bytes(payload, "big")
        assert flipped == 1 << (15 - sent.flipped_bit)


@pytest.mark.asyncio
async def test_a_link_that_stalls_holds_what_comes_until_it_is_up_again() -> None:
    link = Link()
    case = Case([link], {"down": True, "on_loss": "stall", "latency_ms": 10.0})
    case.send(message(b"1"), message(b"2", due_utc_ns=MS))
    await case.until(50 * MS)
    assert (link.carried, case.outbox.on_the_way) == ([], 2)
    case.change(latency_ms=10.0, on_loss="stall")
    await case.until(100 * MS)
    assert link.carried == [b"1", b"2"]
    ((first, second),) = case.entries
    assert (first.due_utc_ns, second.due_utc_ns) == (0, MS)
    assert first.sent_utc_ns == second.sent_utc_ns == 60 * MS


@pytest.mark.asyncio
async def test_a_client_without_a_link_gets_one_while_it_runs() -> None:
    link = Link()
    case = Case([link])
    case.send(message(b"1"))
    case.change(latency_ms=7.0)
    case.send(message(b"2"))
    assert link.carried == [b"1"]
    await case.until(7 * MS)
    assert link.carried == [b"1", b"2"]


@pytest.mark.asyncio
async def test_what_is_on_the_way_when_all_is_over_is_in_the_ledger() -> None:
    link = Link()
    case = Case([link], {"latency_ms": 1000.0})
    case.send(message())
    case.outbox.end()
    ((sent,),) = case.entries
    assert (sent.fate, case.totals.ended, case.outbox.on_the_way) == (pb.ENDED, 1, 0)
    await case.until(2000 * MS)
    assert (link.carried, len(case.entries)) == ([], 1)


def test_what_is_too_late_for_whom_it_is_for_is_stale() -> None:
    link = Link()
    case = Case(
        [link], {"latency_ms": 5.0}, in_time=lambda m, t: None if t - m.due_utc_ns > 4 * MS else m
    )
    case.send(message())
    ((sent,),) = case.entries
    assert (sent.fate, case.totals.stale, link.carried) == (pb.STALE, 1, [])


def test_a_status_goes_past_the_link() -> None:
    link = Link()
    case = Case([link], {"down": True})
    case.outbox.send_past_link(message(b"status"))
    assert link.carried == [b"status"]
    assert case.totals.messages == 0


@pytest.mark.asyncio
async def test_every_link_is_drained() -> None:
    links = [Link(), Link()]
    await Outbox(InstantClock(0), links).drain()
    assert [link.drained for link in links] == [1, 1]


def test_lateness_is_in_microseconds_and_nothing_is_not_late() -> None:
    assert lateness_us([], 50, 99) == [0.0, 0.0]
    assert lateness_us([1000, 2000, 3000], 0, 50, 100) == [1.0, 2.0, 3.0]


def test_a_raw_file_holds_the_asterix_and_nothing_else(tmp_path: Path) -> None:
    with RawFile(tmp_path / "raw") as raw:
        raw.after_link(message(b"one"), 0)
        raw.after_link(message(b"no", "application/json"), 0)
        raw.after_link(message(b"two", "application/x-asterix; cat=34"), 0)
    assert (tmp_path / "raw").read_bytes() == b"onetwo"
    assert raw.failure == ""


@pytest.mark.parametrize("octets", [10, 100_000])
def test_a_full_disk_is_told_once_and_stops_nothing(octets: int) -> None:
    with RawFile(Path("/dev/full")) as raw:
        for _ in range(5):
            raw.after_link(message(b"x" * octets), 0)
    assert raw.failure == ("/dev/full: No space left on device; what came after is not in the file")


def test_fates_of_messages_are_numbered_as_in_the_ledger() -> None:
    assert (UNSPECIFIED, SENT, UNDELIVERED) == (pb.FATE_UNSPECIFIED, pb.SENT, pb.UNDELIVERED)

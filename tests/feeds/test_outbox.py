from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from plotfeed.feeds.clock import InstantClock
from plotfeed.feeds.message import Message
from plotfeed.feeds.outbox import Outbox, lateness_us
from plotfeed.feeds.rawfile import RawFile

ASTERIX = "application/x-asterix; cat=48"


def message(payload: bytes = b"abc", content_type: str = ASTERIX, due_utc_ns: int = 0) -> Message:
    return Message(topic="t", payload=payload, content_type=content_type, due_utc_ns=due_utc_ns)


class Link:
    def __init__(self, *, takes: bool) -> None:
        self.takes = takes
        self.drained = 0

    def publish(self, _message: Message) -> bool:
        return self.takes

    async def drain(self, _timeout_s: float = 1.0) -> None:
        self.drained += 1


@pytest.mark.parametrize(
    ("takes", "delivered"),
    [([], True), ([True], True), ([False], False), ([True, False], False), ([True, True], True)],
)
def test_a_message_is_delivered_if_every_link_took_it(takes: list[bool], delivered: bool) -> None:
    outbox = Outbox(InstantClock(100), [Link(takes=t) for t in takes])
    sent = outbox.send(message(due_utc_ns=60))
    assert sent.delivered == delivered
    assert (outbox.sent, outbox.undelivered) == (1, 0 if delivered else 1)
    assert (sent.topic, sent.octets) == ("t", 3)
    assert (sent.due_utc_ns, sent.sent_utc_ns) == (60, 100)
    assert list(outbox.lateness_ns) == [40]


def test_the_tap_sees_every_message_even_when_nobody_takes_it() -> None:
    seen: list[tuple[bytes, int]] = []
    links = [Link(takes=False)]
    outbox = Outbox(InstantClock(7), links, lambda m, t: seen.append((m.payload, t)))
    for payload in (b"1", b"2"):
        outbox.send(message(payload))
    assert seen == [(b"1", 7), (b"2", 7)]


def test_every_link_is_drained() -> None:
    links = [Link(takes=True), Link(takes=True)]
    asyncio.run(Outbox(InstantClock(0), links).drain())
    assert [link.drained for link in links] == [1, 1]


def test_lateness_is_in_microseconds_and_nothing_is_not_late() -> None:
    assert lateness_us([], 50, 99) == [0.0, 0.0]
    assert lateness_us([1000, 2000, 3000], 0, 50, 100) == [1.0, 2.0, 3.0]


def test_a_raw_file_holds_the_asterix_and_nothing_else(tmp_path: Path) -> None:
    with RawFile(tmp_path / "raw") as raw:
        raw.tap(message(b"one"), 0)
        raw.tap(message(b"no", "application/json"), 0)
        raw.tap(message(b"two", "application/x-asterix; cat=34"), 0)
    assert (tmp_path / "raw").read_bytes() == b"onetwo"
    assert raw.failure == ""


@pytest.mark.parametrize("octets", [10, 100_000])
def test_a_full_disk_is_told_once_and_stops_nothing(octets: int) -> None:
    with RawFile(Path("/dev/full")) as raw:
        for _ in range(5):
            raw.tap(message(b"x" * octets), 0)
    assert raw.failure == ("/dev/full: No space left on device; what came after is not in the file")

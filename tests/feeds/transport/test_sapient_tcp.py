from __future__ import annotations

import asyncio
import socket
import tracemalloc
from contextlib import suppress
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sapient_msg.bsi_flex_335_v2_0.status_report_pb2 import StatusReport
from support.brokers import free_port
from support.deliveries import taken
from support.sapient_middleware import Middleware, Peer, linked, listening, polite, status_report
from support.sapient_rules import checked_together
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.fields import split_address
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.feeds.transport import sapient, ways_out
from plotfeed.feeds.transport.sapient import (
    MAX_MESSAGE_OCTETS,
    MAX_UNSENT_OCTETS,
    framed,
    next_message,
)
from plotfeed.feeds.transport.ways_out import TransportError
from plotfeed.proto.errors import DecodeError
from plotfeed.testing import held, radar, rotating, scene, staring


@pytest.fixture(autouse=True)
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ways_out, "BACKOFF_S", (0.01, 0.05))


@pytest.mark.asyncio
async def test_a_node_registers_first_and_then_reports() -> None:
    async with listening() as middleware, linked(middleware.address) as link:
        assert taken(link, status_report())
        (peer,) = middleware.peers
        await until(lambda: len(peer.heard) == 3)
        assert peer.kinds() == ["registration", "status_report", "status_report"]


@pytest.mark.asyncio
async def test_what_is_not_for_a_middleware_does_not_go_there() -> None:
    async with listening() as middleware, linked(middleware.address) as link:
        other = Message(topic="t", payload=b"x", content_type="text/plain", due_utc_ns=0)
        assert taken(link, other)
        assert taken(link, status_report())
        (peer,) = middleware.peers
        await until(lambda: len(peer.heard) == 3)
        assert peer.kinds().count("registration") == 1


@pytest.mark.asyncio
async def test_a_middleware_that_is_not_there_is_one_clear_error() -> None:
    async with linked(f"127.0.0.1:{free_port()}", wait=False) as link:
        assert not taken(link, status_report())
        with pytest.raises(TransportError, match="no SAPIENT middleware answers at 127"):
            await link.wait_until_up(0.3)


async def cut_off(peer: Peer) -> None:
    """Amid a message of its own."""
    await peer.next()
    peer.acknowledge()
    await peer.next()
    peer.writer.write(b"\x40\0\0\0half")


async def reset(peer: Peer) -> None:
    await peer.next()
    peer.acknowledge()
    peer.writer.transport.abort()


async def hang_up(peer: Peer) -> None:
    """Without a word."""


async def boast(peer: Peer) -> None:
    await peer.next()
    peer.writer.write(b"\xff\xff\xff\xff" + b"x" * 100_000)
    await peer.hear_all()


@pytest.mark.parametrize("behave", [cut_off, reset, hang_up, boast])
@pytest.mark.asyncio
async def test_a_lost_connection_is_made_anew_and_registered_anew(behave: Any) -> None:
    async with (
        listening(behave, behave, polite) as middleware,
        linked(middleware.address, wait=False) as link,
    ):
        await until(lambda: len(middleware.peers) == 3)
        await link.wait_until_up(PATIENCE_S)
        last = middleware.peers[2]
        await until(lambda: taken(link, status_report()))
        await until(lambda: len(last.heard) >= 3)
        assert last.kinds()[:3] == ["registration", "status_report", "status_report"]
        assert last.heard[1].status_report.info == StatusReport.INFO_NEW


@pytest.mark.asyncio
async def test_whoever_hangs_up_at_once_is_not_hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ways_out, "BACKOFF_S", (0.05, 0.2))

    began_s = asyncio.get_running_loop().time()
    async with listening(reset) as middleware, linked(middleware.address, wait=False):
        await until(lambda: len(middleware.peers) == 5)
        assert asyncio.get_running_loop().time() - began_s > 0.05 + 3 * 0.2 - 0.01


@pytest.mark.asyncio
async def test_a_middleware_that_reads_nothing_costs_no_memory_and_is_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sapient, "MAX_STALL_S", 0.1)

    async def deaf(peer: Peer) -> None:
        await peer.next()
        peer.acknowledge()
        peer.writer.transport.pause_reading()  # type: ignore[attr-defined]
        await asyncio.sleep(PATIENCE_S)

    async with listening(deaf, polite) as middleware, linked(middleware.address) as link:
        message = status_report(100_000)
        refused = 0
        for _ in range(400):
            refused += not taken(link, message)
            await asyncio.sleep(0.001)
            wire = link._wire
            assert wire is None or wire.unsent_octets <= MAX_UNSENT_OCTETS
        assert refused
        await until(lambda: taken(link, status_report()) and len(middleware.peers) == 2)


@pytest.mark.asyncio
async def test_a_slow_middleware_hears_all_in_order() -> None:
    async def slow(peer: Peer) -> None:
        await peer.next()
        peer.acknowledge()
        while True:
            await peer.next()
            await asyncio.sleep(0.002)

    async with listening(slow) as middleware, linked(middleware.address) as link:
        sent = [status_report() for _ in range(100)]
        assert all(taken(link, message) for message in sent)
        await link.drain()
        (peer,) = middleware.peers
        await until(lambda: len(peer.heard) == 102)
        assert [m.SerializeToString() for m in peer.heard[2:]] == [m.payload for m in sent]


@given(st.lists(st.binary(max_size=50), max_size=10), st.integers(1, 40))
def test_messages_are_put_together_however_they_come(messages: list[bytes], size: int) -> None:
    async def test() -> list[bytes]:
        stream, octets = b"".join(map(framed, messages)), asyncio.StreamReader()
        hearing = asyncio.gather(*(next_message(octets) for _ in messages[:1]))
        await asyncio.sleep(0)
        for start in range(0, len(stream), size):
            octets.feed_data(stream[start : start + size])
        octets.feed_eof()
        return [*await hearing, *[await next_message(octets) for _ in messages[1:]]]

    assert asyncio.run(test()) == messages


@given(st.integers(MAX_MESSAGE_OCTETS + 1, 2**32 - 1))
def test_a_hostile_length_allocates_nothing(length: int) -> None:
    async def test() -> int:
        octets = asyncio.StreamReader()
        octets.feed_data(length.to_bytes(4, "little"))
        tracemalloc.start()
        try:
            with pytest.raises(DecodeError):
                await next_message(octets)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    assert asyncio.run(test()) < 100_000


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("127.0.0.1:5000", ("127.0.0.1", 5000)),
        ("middleware.example:1", ("middleware.example", 1)),
        ("[::1]:65535", ("::1", 65535)),
    ],
)
def test_addresses(text: str, expected: tuple[str, int]) -> None:
    assert split_address(text) == expected


@pytest.mark.parametrize(
    "text", ["", ":1", "host", "host:", "host:0", "host:65536", "a b:1", "::1:5", "u@h:1", "h:1/x"]
)
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected HOST:PORT"):
        split_address(text)


@pytest.mark.asyncio
async def test_a_session_connects_every_sensor_and_says_goodbye() -> None:
    """In real time: stamps as a strict middleware has them, detections in order, 80 ms apart."""
    sensors = [
        radar(id="turning", report=["sapient"], scan=rotating(0.5, 16), pfa=1e-5),
        radar(id="staring", report=["sapient"], scan=staring(0.1)),
        radar(id="other", report=["plots"]),
    ]
    ages_s: list[float] = []

    async def timed(peer: Peer) -> None:
        await peer.next()
        peer.acknowledge()
        with suppress(asyncio.IncompleteReadError):
            while True:
                message = await peer.next()
                age_ns = WallClock().now_ns() - message.timestamp.ToNanoseconds()
                ages_s.append(age_ns / 1e9)

    async def test() -> Middleware:
        async with listening(timed) as middleware:
            flown = scene(
                sensors,
                [held("d", 45.0, 20.0, 1000.0, rcs_m2=1.0)],
                seed=3,
                sapient={"middleware": middleware.address, "status_interval_s": 0.5},
            )
            totals = await run(flown, broker="none", duration_s=3.0)
            assert totals.undelivered == 0
            await until(lambda: all(p.reader.at_eof() for p in middleware.peers))
            return middleware

    middleware = await test()
    assert len(middleware.peers) == 2
    names = {peer.heard[0].registration.name for peer in middleware.peers}
    assert names == {"turning", "staring"}
    assert len({peer.heard[0].node_id for peer in middleware.peers}) == 2
    for peer in middleware.peers:
        assert peer.kinds()[:2] == ["registration", "status_report"]
        assert peer.heard[-1].status_report.system == StatusReport.SYSTEM_GOODBYE
        checked_together(peer.heard)
        stamps = [m.timestamp.ToNanoseconds() for m in peer.heard if m.HasField("detection_report")]
        assert len(stamps) > 3
        assert all(b == a or b - a >= 80_000_000 for a, b in pairwise(stamps))
    assert all(-0.1 < age_s < PATIENCE_S for age_s in ages_s)


@pytest.mark.asyncio
async def test_a_session_does_not_begin_without_its_middleware() -> None:
    flown = scene(
        [radar(report=["sapient"])], seed=3, sapient={"middleware": f"127.0.0.1:{free_port()}"}
    )
    with pytest.raises(TransportError, match="no SAPIENT middleware"):
        await run(flown, broker="none", duration_s=1.0)


@pytest.mark.asyncio
async def test_a_socket_that_never_answers_is_given_up() -> None:
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))  # and does not listen

        async def test() -> None:
            async with linked(f"127.0.0.1:{nobody.getsockname()[1]}", wait=False) as link:
                with pytest.raises(TransportError):
                    await link.wait_until_up(0.2)

        await test()

"""Replays over UDP, heard by an ordinary socket."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Sequence
from fractions import Fraction

import pytest
from support.brokers import has_ipv6
from support.recordings import plots
from support.replays import MS, Memory, message
from support.udp_receiver import LOOPBACK_INTERFACE, heard, place, receiver
from support.waiting import PATIENCE_S

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.transports import Transport
from plotfeed.feeds.replaying.replay_settings import ReplaySettings, TopicRule
from plotfeed.feeds.replaying.replayer import Replayer
from plotfeed.feeds.replaying.routes import RecordedUdp, ReplayCounters, ReplayUdp
from plotfeed.feeds.scene.output_keys import UdpDestination
from plotfeed.feeds.transport.ways_out import TransportError
from plotfeed.replay.recorded import Recorded

# Stands for any address, where only the other keys count.
ANYWHERE = UdpDestination(destination="239.0.0.0:1")


async def sent_over(
    outs: Sequence[Transport], recorded: Sequence[Recorded], settings: ReplaySettings | None = None
) -> ReplayCounters:
    running = Replayer(settings or ReplaySettings(speed=100)).run(Memory(recorded), outs)  # type: ignore[arg-type]
    return await asyncio.wait_for(running, PATIENCE_S)


def opened(to: str, **keys: object) -> ReplayUdp:
    link = ReplayUdp(UdpDestination.model_validate({"destination": to, **keys}))
    link.open()
    return link


@pytest.mark.parametrize("fastest", [False, True])
@pytest.mark.asyncio
async def test_the_same_octets_come_in_the_same_order(fastest: bool) -> None:
    """But of what is no datagram, which is counted."""
    recorded = plots(300, step_ns=MS)
    with receiver() as ears:
        link = opened(place(ears))
        others = [message(0, "p/radar/plots"), message(MS, "p/radar/status")]
        settings = ReplaySettings(fastest=fastest)
        totals = await sent_over([link], [others[0], *recorded, others[1]], settings)
        link.close()
        assert not link.send(b"x")
        assert heard(ears) == [r.payload for r in recorded]
    assert totals.messages == 300
    assert totals.octets == sum(len(r.payload) for r in recorded)
    assert (totals.undelivered, totals.skipped.total()) == (0, 2)


@pytest.mark.asyncio
async def test_datagrams_go_where_they_once_went_or_where_a_rule_says() -> None:
    host = "::1" if has_ipv6() else "127.0.0.1"  # without brackets in topics
    with receiver() as first, receiver(host) as second:
        topics = [
            f"udp/{at}/{ears.getsockname()[1]}"
            for at, ears in (("127.0.0.1", first), (host, second))
        ]
        recorded = [message(i * MS, topics[i % 2], bytes([i])) for i in range(10)]
        recorded.append(message(11 * MS, "udp/239.1.2.3/8600", b"x"))
        rule = TopicRule.parse(f"udp/239.1.2.3/8600={topics[0]}")
        out = RecordedUdp(ANYWHERE)
        totals = await sent_over(
            [out],
            [*recorded, message(0, "p/radar/asterix/048")],
            ReplaySettings(speed=Fraction(100), topics=(rule,)),
        )
        out.close()
        assert heard(first) == [*(bytes([i]) for i in range(0, 10, 2)), b"x"]
        assert heard(second) == [bytes([i]) for i in range(1, 10, 2)]
    assert (totals.messages, totals.skipped.total()) == (11, 1)


@pytest.mark.asyncio
async def test_a_destination_that_is_none_is_skipped_and_many_do_not_take_all_sockets() -> None:
    none = ("", "127.0.0.1", "127.0.0.1/0", "host/1", "0.0.0.0/1", "a/b/c")
    for topics, skipped in (
        ([f"udp/{wrong}" for wrong in none] * 2, 12),
        ([f"udp/127.0.0.1/{1024 + i}" for i in range(400)], 400 - 256),
    ):
        out = RecordedUdp(ANYWHERE)
        totals = await sent_over([out], [message(i, topic, b"x") for i, topic in enumerate(topics)])
        out.close()
        assert totals.skipped.total() == skipped
        assert totals.messages == len(topics) - skipped


@pytest.mark.asyncio
async def test_nobody_who_listens_is_counted_and_whoever_comes_then_misses_nothing() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as once:
        once.bind(("127.0.0.1", 0))
        port = once.getsockname()[1]
    link = opened(f"127.0.0.1:{port}")
    totals = await sent_over([link], plots(20))
    assert link.refused > 0
    assert (totals.messages, totals.undelivered) == (20, 0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ears:
        ears.bind(("127.0.0.1", port))
        assert link.send(b"somebody")
        ears.settimeout(PATIENCE_S)
        assert ears.recv(100) == b"somebody"
    link.close()


@pytest.mark.asyncio
async def test_multicast_goes_to_its_group() -> None:
    with receiver(group="239.255.77.78") as ears:
        link = opened(place(ears), interface=LOOPBACK_INTERFACE, ttl=0)
        await sent_over([link], plots(3))
        link.close()
        assert heard(ears) == [r.payload for r in plots(3)]


@pytest.mark.asyncio
async def test_a_datagram_that_is_too_large_is_undelivered_and_a_place_that_is_none_named() -> None:
    with receiver() as ears:
        link = opened(place(ears))
        totals = await sent_over([link], [message(0, "udp/10.0.0.1/1", bytes(70_000)), *plots(1)])
        link.close()
        assert len(heard(ears)) == 1
    assert (totals.messages, totals.undelivered) == (1, 1)
    with pytest.raises(TransportError, match=r"--udp.*no-such-interface"):
        opened("239.1.2.3:8600", interface="no-such-interface")


@pytest.mark.parametrize(
    ("topic", "content_type", "is_one"),
    [
        ("a/radar/asterix/048", "", True),
        ("a", "application/x-asterix; cat=48", True),
        ("udp/10.0.0.1/1", "", True),
        ("a/radar/plots", "application/x-protobuf", False),
        ("asterix/errors", "application/json", False),
    ],
)
def test_datagrams_are_known_by_type_or_topic(topic: str, content_type: str, is_one: bool) -> None:
    given = Message(topic=topic, payload=b"", content_type=content_type, due_utc_ns=0)
    link = ReplayUdp(UdpDestination(destination="127.0.0.1:1"))
    assert link.carries(given) == is_one

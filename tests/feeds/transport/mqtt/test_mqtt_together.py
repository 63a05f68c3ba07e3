"""Messages of many clients over one link: what becomes of each, whatever the socket takes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.deliveries import Deliveries
from support.scripted_broker import BUSY, ScriptedBroker, end_connection, linked
from support.waiting import until

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.link.outbox import Outbox, send_all
from plotfeed.feeds.link.uplink import Uplink
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.mqtt.send_queue import MAX_UNSENT_OCTETS, SocketBuffer
from plotfeed.proto import plotfeed_pb2 as pb

CLIENTS, EACH = 20, 2


def passed(messages: Sequence[Message]) -> Sequence[Message]:
    """The same messages again, after a link that does nothing."""
    link = Uplink(None, 1, "radar")
    return link.passed([message.again() for message in messages])


class Clients:
    """Who sends over one link, and the fates that they were told of."""

    def __init__(self, link: MqttTransport) -> None:
        self.totals = SessionCounters()
        clock = WallClock()
        self.outboxes = [Outbox(clock, [link], totals=self.totals) for _ in range(CLIENTS)]
        self.fates: list[list[pb.Fate]] = [[] for _ in range(CLIENTS)]
        self.sent: list[bytes] = []

    def send(self, octets: int, qos: int = 0) -> None:
        """What is due at one time: two messages of each, numbered through all."""
        departures = []
        for i, outbox in enumerate(self.outboxes):
            messages = []
            for _ in range(EACH):
                payload = len(self.sent).to_bytes(4, "big").ljust(octets, b"\0")
                messages.append(
                    Message(topic=f"t{i}", payload=payload, content_type="x", due_utc_ns=0, qos=qos)
                )
                self.sent.append(payload)
            outgoing = passed(messages)
            departures.append((outbox, outgoing, (i, outgoing)))
        send_all(departures, self._keep)

    def _keep(self, complete: Sequence[tuple[int, Sequence[Message]]]) -> None:
        for i, outgoing in complete:
            self.fates[i] += [one.fate for one in outgoing]

    @property
    def told(self) -> int:
        return sum(map(len, self.fates))


@pytest.mark.parametrize("octets", [50, 60_000])
@pytest.mark.asyncio
async def test_all_arrives_in_order_whether_it_fits_into_the_socket_or_not(octets: int) -> None:
    broker = ScriptedBroker()
    async with linked(broker) as link:
        clients = Clients(link)
        for _ in range(3):
            clients.send(octets)
        await until(lambda: clients.told == len(clients.sent))
        await until(lambda: broker.received == len(clients.sent))
    assert broker.heard == [clients.sent]
    assert all(fates == [pb.SENT] * 3 * EACH for fates in clients.fates)
    assert clients.totals.messages == len(clients.sent)


@pytest.mark.asyncio
async def test_what_a_stalled_broker_leaves_in_the_socket_is_undelivered_when_it_is_gone() -> None:
    """What had left before is sent; whoever was told of the one is not told of the other."""
    broker = ScriptedBroker(reads=False)
    octets = 100_000
    async with linked(broker) as link:
        clients = Clients(link)
        while clients.totals.undelivered == 0:  # the socket is full, and then its buffer
            clients.send(octets)
        assert 0 < clients.told < len(clients.sent)
        assert len(clients.sent) * octets > MAX_UNSENT_OCTETS
        before = clients.totals.messages
        await end_connection(broker, link, code=BUSY)
        await until(lambda: clients.told == len(clients.sent))
        assert link.waiting == 0
    totals = clients.totals
    assert totals.messages >= before > 0
    assert totals.messages + totals.undelivered == len(clients.sent)
    fates = [fate for row in clients.fates for fate in row]
    assert (fates.count(pb.SENT), fates.count(pb.UNDELIVERED)) == (
        totals.messages,
        totals.undelivered,
    )


@pytest.mark.asyncio
async def test_each_client_is_told_what_waits_of_its_own() -> None:
    broker = ScriptedBroker()
    async with linked(broker, policy="drop-oldest", messages=5) as link:
        clients = Clients(link)
        await end_connection(broker, link, code=BUSY)
        loud, quiet, *others = clients.outboxes
        some = [
            Message(topic="t", payload=b"1234", content_type="x", due_utc_ns=0) for _ in range(9)
        ]
        loud.send(passed(some))
        quiet.send(passed(some[:2]))
        assert [loud.waiting, quiet.waiting] == [5, 2]
        assert [loud.counters.undelivered, quiet.counters.undelivered] == [4, 0]
        assert not any(other.waiting for other in others)
        broker.code = 0
        await until(lambda: not link.waiting)
        await until(lambda: clients.totals.messages == 7)
        assert [loud.waiting, quiet.waiting] == [0, 0]


@pytest.mark.asyncio
async def test_with_qos_1_each_is_told_when_it_is_acknowledged() -> None:
    broker = ScriptedBroker()
    async with linked(broker) as link:
        clients = Clients(link)
        clients.send(50, qos=1)
        await until(lambda: broker.received == len(clients.sent))
        assert clients.told == 0
        broker.acknowledge(3 * EACH)
        await until(lambda: clients.told == 3 * EACH)
        assert [len(fates) for fates in clients.fates[:4]] == [EACH, EACH, EACH, 0]
        broker.acknowledge(len(clients.sent) - 3 * EACH)
        await until(lambda: clients.told == len(clients.sent))
    assert broker.heard == [clients.sent]


class Socket:
    """Takes so many octets of a write at once, and the rest when it is told to."""

    def __init__(self) -> None:
        self.unsent = 0
        self.hold: Callable[[], None]

    def get_write_buffer_size(self) -> int:
        return self.unsent

    def is_closing(self) -> bool:
        return False

    def write(self, _octets: bytes) -> None:
        if self.unsent > 1:
            self.hold()


@given(st.lists(st.integers(1, 500), min_size=1, max_size=20), st.data())
def test_of_one_write_what_has_left_is_told_and_nothing_else(
    sizes: list[int], data: st.DataObject
) -> None:
    socket, deliveries = Socket(), Deliveries()
    buffer = SocketBuffer(socket, lambda: None)  # type: ignore[arg-type]
    total = sum(sizes)
    socket.unsent = data.draw(st.integers(2, total + 1)) if total > 1 else 0
    socket.unsent = min(socket.unsent, total)
    socket.hold = buffer.hold
    taken = buffer.write(bytes(total))
    assert taken == (socket.unsent <= 1)
    behind = total
    for size in sizes:
        behind -= size
        delivery = deliveries.make(qos=0)
        if not taken:
            buffer.keep(delivery, behind)
    if taken:
        return
    while True:
        left = total - socket.unsent
        ends = [sum(sizes[: i + 1]) for i in range(len(sizes))]
        assert deliveries.delivered == [i for i, end in enumerate(ends) if end <= left]
        if socket.unsent <= 1:
            break
        socket.unsent -= data.draw(st.integers(1, socket.unsent - 1))
        buffer.is_stuck()
    assert buffer.give_up() == len(sizes) - len(deliveries.delivered)


@pytest.mark.asyncio
async def test_what_is_sent_over_a_link_that_is_not_there_is_undelivered() -> None:
    clients = Clients(MqttTransport(BrokerAddress("127.0.0.1"), "away"))
    clients.send(10)
    assert clients.told == clients.totals.undelivered == len(clients.sent)

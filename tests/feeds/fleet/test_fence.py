"""Who has lost sensors to another sends nothing more of them, and takes no connection back."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path

import pytest
from support.brokers import free_port
from support.deliveries import NOBODY
from support.mqtt_client import listening
from support.sessions import Start, every_broker
from support.waiting import until

from plotfeed.feeds.delivery.outbox import Outbox
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.outgoing import Outgoing
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.feeds.transport.leased import NO_LEASE, LeasedLink, LeasedTransport
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.proto import plotfeed_pb2 as pb

PATIENCE_S = 60.0


class Grant:
    """A lease that is granted by hand."""

    def __init__(self) -> None:
        self.holds = True
        self.wanted = 0
        self._granted = asyncio.Event()
        self._granted.set()

    async def renewed(self) -> None:
        self.wanted += 1
        await self._granted.wait()

    def withhold(self) -> None:
        self._granted.clear()

    def grant(self) -> None:
        self._granted.set()


def delivery(text: bytes) -> Outgoing:
    message = Message("plotfeed/r/plots", text, "text/plain", 0)
    return Outgoing(message, client=NOBODY, transports=1)


@every_broker
@pytest.mark.asyncio
async def test_the_next_holder_cuts_off_the_last_which_comes_back_by_a_new_lease_alone(
    tmp_path: Path, start: Start
) -> None:
    port = free_port()
    with start(tmp_path, port):
        address = BrokerAddress("127.0.0.1", port, (5,))
        first, second = Grant(), Grant()
        old, new = (LeasedLink(address, "part-0", grant) for grant in (first, second))
        async with old.connected(PATIENCE_S):
            first.withhold()
            with listening(port, 5, "plotfeed/#") as client:
                async with new.connected(PATIENCE_S):
                    await until(lambda: not old.is_up)
                    await until(lambda: first.wanted == 2)  # it would, and may not
                    late, in_time = delivery(b"late"), delivery(b"in time")
                    old.publish([late])
                    new.publish([in_time])
                    await asyncio.to_thread(client.wait_for, lambda m: m.payload == b"in time")
                    assert new.is_up
                    assert late.fate == pb.UNDELIVERED
                    second.withhold()
                    first.grant()
                    await until(lambda: old.is_up and not new.is_up)
                assert [m.payload for m in client.heard] == [b"in time"]


class Kept:
    """A way out that takes everything."""

    def __init__(self) -> None:
        self.taken: list[bytes] = []

    def publish(self, outgoing: Sequence[Outgoing]) -> None:
        for each in outgoing:
            self.taken.append(each.message.payload)
            each.settle(delivered=True)


class Waits(Kept):
    """One whose broker is away."""

    def publish(self, outgoing: Sequence[Outgoing]) -> None:
        self.waiting = outgoing


@pytest.mark.asyncio
async def test_no_way_out_takes_what_is_sent_without_a_lease() -> None:
    """UDP and others, where no broker cuts anybody off."""
    kept, grant = Kept(), Grant()
    leased = LeasedTransport(kept, grant)  # type: ignore[arg-type]
    sent, held_back = delivery(b"sent"), delivery(b"held back")
    leased.publish([sent])
    grant.holds = False
    leased.publish([held_back])
    assert kept.taken == [b"sent"]
    assert (sent.fate, held_back.fate) == (pb.SENT, pb.UNDELIVERED)
    assert held_back.not_to == (NO_LEASE,)


def passed(*due_utc_ns: int) -> list[Outgoing]:
    return [
        Outgoing(Message("plotfeed/r/plots", b"plots", "text/plain", t_ns), i)
        for i, t_ns in enumerate(due_utc_ns)
    ]


@pytest.mark.asyncio
async def test_what_did_not_leave_for_want_of_a_lease_is_told_once() -> None:
    """As of a worker that was frozen: it holds nothing when it wakes, until it has asked."""
    kept, grant = Kept(), Grant()
    outbox = Outbox(InstantClock(0), [LeasedTransport(kept, grant)])  # type: ignore[arg-type]
    outbox.send(passed(10))
    assert outbox.counters.take_not_sent() is None
    grant.holds = False
    outbox.send(passed(20))
    outbox.send(passed(30, 40))
    grant.holds = True
    outbox.send(passed(50))
    assert outbox.counters.take_not_sent() == (20, 40)
    assert outbox.counters.take_not_sent() is None
    assert len(kept.taken) == 2


def test_what_waits_for_a_broker_is_not_taken_for_sent() -> None:
    waits = Waits()
    outbox = Outbox(InstantClock(0), [waits])  # type: ignore[list-item]
    outbox.send(passed(10, 20))
    assert outbox.oldest_due_ns == 10
    first, second = waits.waiting
    first.settle(delivered=True)
    assert outbox.oldest_due_ns == 20
    second.settle(delivered=False, to="MQTT")
    assert outbox.oldest_due_ns is None
    assert outbox.counters.take_not_sent() == (20, 20)

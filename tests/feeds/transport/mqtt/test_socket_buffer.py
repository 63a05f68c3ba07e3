"""What a socket has not taken, against a transport that takes what a test says."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.deliveries import Deliveries

from plotfeed.feeds.transport.mqtt import send_queue
from plotfeed.feeds.transport.mqtt.send_queue import SocketBuffer


class Transport:
    """Tells of its buffer as asyncio's do."""

    def __init__(self) -> None:
        self.protocol = SimpleNamespace()
        self.written = self.taken = self.room = 0
        self.paused = self.closing = False

    def get_write_buffer_size(self) -> int:
        return self.written - self.taken

    def is_closing(self) -> bool:
        return self.closing

    def write(self, data: bytes) -> None:
        octets = len(data)
        if not self.get_write_buffer_size():  # else it does not try
            self.taken += min(octets, self.room)
            self.room -= min(octets, self.room)
        self.written += octets
        if self.get_write_buffer_size() > 1 and not self.paused:
            self.paused = True
            self.protocol.pause_writing()

    def take(self, octets: int) -> None:
        self.room += octets
        now = min(self.room, self.get_write_buffer_size())
        self.taken += now
        self.room -= now
        if self.paused and not self.get_write_buffer_size():
            self.paused = False
            self.protocol.resume_writing()


def watching(transport: Transport, *more: Any) -> SocketBuffer:
    """What its protocol tells."""
    buffer = SocketBuffer(transport, *more)  # type: ignore[arg-type]
    transport.protocol.pause_writing = buffer.hold
    transport.protocol.resume_writing = buffer.release
    return buffer


steps = st.lists(
    st.one_of(
        st.tuples(st.just("publish"), st.integers(8, 400)),
        st.tuples(st.just("ping"), st.integers(2, 9)),
        st.tuples(st.just("take"), st.integers(1, 500)),
    ),
    max_size=80,
)


@given(steps)
def test_delivered_is_only_what_has_left_and_in_the_end_all_of_it(
    steps: list[tuple[str, int]],
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(send_queue, "MAX_UNSENT_OCTETS", 1000)
        transport, deliveries = Transport(), Deliveries()
        watch = watching(transport, lambda: None)
        ends: list[int] = []
        refused = pings = 0
        for step, octets in steps:
            if step == "take":
                transport.take(octets)
            elif step == "ping":
                watch.write(bytes(octets))
                pings += octets
            elif watch.has_room:
                delivery = deliveries.make(qos=0, octets=octets)
                if watch.write(bytes(octets + 5)):
                    delivery.settle(delivered=True)
                else:
                    watch.keep(delivery)
                ends.append(transport.written)
            else:
                refused += 1
                assert transport.get_write_buffer_size() > 1000
            watch.is_stuck()
            for n in deliveries.delivered:
                assert ends[n] <= transport.taken + 1
            held = sum(len(p.payload) for p in deliveries.made if not p.said)
            assert held <= 1000 + 405 + 400 + pings
        transport.take(10**6)
        assert deliveries.delivered == [p.number for p in deliveries.made]
        assert not watch._unsent


def test_what_has_left_counts_although_more_waits_behind_it() -> None:
    transport, deliveries = Transport(), Deliveries()
    watch = watching(transport, lambda: None)
    for _ in range(5):
        delivery = deliveries.make(qos=0, octets=100)
        assert not watch.write(bytes(105))
        watch.keep(delivery)
    transport.take(104)
    watch.is_stuck()
    assert deliveries.delivered == []
    transport.take(110)
    watch.is_stuck()
    assert deliveries.delivered == [0, 1]
    assert watch.give_up() == 3
    assert deliveries.given_up == [2, 3, 4]


def test_it_is_stuck_when_nothing_moves_for_long_and_not_when_anything_does() -> None:
    now_s = 0.0
    transport = Transport()
    watch = watching(transport, lambda: None, lambda: now_s)
    now_s = 1000.0
    assert not watch.is_stuck()  # nothing is to be sent
    watch.write(bytes(1000))
    for _ in range(50):
        now_s += send_queue.GIVE_UP_S
        transport.take(1)
        assert watch.has_room
        watch.write(bytes(7))
        assert not watch.is_stuck()
    now_s += send_queue.GIVE_UP_S + 0.1
    assert watch.is_stuck()
    transport.take(10**6)
    assert not watch.is_stuck()
    transport.closing = True
    assert not watch.has_room
    now_s += send_queue.GIVE_UP_S + 0.1
    assert watch.is_stuck()

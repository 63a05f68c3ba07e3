"""What waits: in a queue, against the simplest that does the same, and in a socket's buffer."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.deliveries import Deliveries

from plotfeed.feeds.link.outbox import Outbox
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import MqttQueueKeys
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.feeds.transport.mqtt import send_queue
from plotfeed.feeds.transport.mqtt.send_queue import SendQueue, SocketBuffer

POLICIES = ["drop-oldest", "drop-newest", "wait"]


class Bench:
    """A queue, its deliveries, and a time that only the test moves."""

    def __init__(self, qos: int = 1, **settings: object) -> None:
        self.now_s = 0.0
        self.deliveries = Deliveries()
        queue = MqttQueueKeys.model_validate(settings)
        self.queue = SendQueue(queue, qos, "MQTT", lambda: self.now_s)

    def put(self, **how: object) -> None:
        self.queue.put(self.deliveries.make(**how))  # type: ignore[arg-type]

    def take(self) -> Message | None:
        return self.queue.take()

    def take_all(self) -> list[int]:
        found = []
        while (delivery := self.take()) is not None:
            found.append(delivery.number)
        return found


MOST_OCTETS, OVERRUN, AGE_S = 500, 4, 5.0


@given(
    st.sampled_from(POLICIES),
    st.integers(0, 6),
    st.lists(
        st.integers(4, 300) | st.floats(0.1, 3) | st.sampled_from(["take", "lose"]) | st.just(5000),
        max_size=60,
    ),
)
def test_it_does_what_the_simplest_queue_would_do(
    policy: str, limit: int, steps: list[int | float | str]
) -> None:
    """A whole number puts so many octets, a fraction is time; what is lost was sent before."""
    most, octets_at_most = limit, MOST_OCTETS
    if policy == "wait":  # whoever does not wait although it is full is not kept for ever
        most, octets_at_most = limit + OVERRUN, 2 * MOST_OCTETS
    numbers, waiting, sent = count(), list[tuple[int, int, float]](), list[Message]()
    dropped: list[int] = []

    def fits(octets: int) -> bool:
        held = sum(each for _, each, _ in waiting)
        return len(waiting) < most and (not waiting or held + octets <= octets_at_most)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(send_queue, "MAX_WAITING_OCTETS", MOST_OCTETS)
        patch.setattr(send_queue, "OVERRUN", OVERRUN)
        bench = Bench(policy=policy, messages=limit, max_age_s=AGE_S)
        taken = dict[int, tuple[int, int, float]]()
        for step in steps:
            bench.now_s += step if isinstance(step, float) else 0.0
            if step != "lose":
                while waiting and waiting[0][2] < bench.now_s - AGE_S:
                    dropped.append(waiting.pop(0)[0])
            if isinstance(step, float):
                bench.queue.expire()
            elif isinstance(step, int):
                while policy == "drop-oldest" and waiting and not fits(step):
                    dropped.append(waiting.pop(0)[0])
                if fits(step):
                    waiting.append((next(numbers), step, bench.now_s))
                else:
                    dropped.append(next(numbers))
                bench.put(octets=step)
            elif step == "take":
                entry = bench.take()
                assert (entry is not None) == bool(waiting)
                if entry is not None:
                    assert entry.number == waiting[0][0]
                    taken[entry.number] = waiting.pop(0)
                    sent.append(entry)
            else:
                bench.queue.put_back(sent)
                waiting[:0] = [taken[entry.number] for entry in sent]
                sent.clear()
            assert bench.deliveries.given_up == sorted(dropped)
            held = sum(octets for _, octets, _ in waiting)
            assert (len(bench.queue), bench.queue._octets.total()) == (len(waiting), held)
            is_full = waiting and (len(waiting) >= limit or held >= MOST_OCTETS)
            assert bench.queue.is_full == (policy == "wait" and bool(is_full))
        bench.queue.give_up()
        assert len(bench.deliveries.given_up) == len(bench.deliveries.made) - len(sent)


# Policy and room of a queue; what is put in turn, retained on a topic of a capital letter; what is
# given up of it.
RETAINED = [
    ("wait", 100, "ABACABa", [0, 1, 2]),  # the newest on each topic waits
    ("drop-newest", 2, "AxAx", [0, 3]),  # in the room of the older
    # What is retained takes the place of what passes.
    ("drop-oldest", 3, "SxxT", [0]),
    ("drop-newest", 3, "SxxT", [2]),
    ("wait", 3, "SxxT", [2]),
    ("drop-oldest", 2, "ABC", [0]),
    ("drop-newest", 2, "ABC", [2]),
    ("wait", 2, "ABC", [2]),
]


@pytest.mark.parametrize(("policy", "messages", "put", "given_up"), RETAINED)
def test_what_is_retained_gives_way_to_newer_of_its_topic_and_to_nothing_that_passes(
    policy: str, messages: int, put: str, given_up: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(send_queue, "OVERRUN", 0)
    bench = Bench(policy=policy, messages=messages)
    for topic in put:
        bench.put(topic=topic, retain=topic.isupper())
    assert bench.deliveries.given_up == given_up
    assert bench.take_all() == [n for n in range(len(put)) if n not in given_up]


def test_a_retained_message_that_comes_back_gives_way_to_a_newer_one() -> None:
    bench = Bench()
    bench.put(topic="a", retain=True)
    bench.put(topic="b", retain=True)
    sent = [bench.take(), bench.take()]
    bench.put(topic="a", retain=True)
    bench.queue.put_back([entry for entry in sent if entry is not None])
    assert bench.deliveries.given_up == [0]
    assert bench.take_all() == [1, 2]


@pytest.mark.parametrize("policy", POLICIES)
def test_no_client_takes_the_room_of_another(policy: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(send_queue, "OVERRUN", 0)
    bench = Bench(policy=policy, messages=3)
    loud, quiet = (Outbox(InstantClock(0), []) for _ in "lq")
    made: dict[int, Outbox] = {}
    for i in range(40):
        delivery = bench.deliveries.make(retain=i == 4, topic="status")
        delivery.client = made[i] = quiet if i in (4, 7, 21) else loud
        bench.queue.put(delivery)
    assert [bench.queue.waiting_of(client) for client in (loud, quiet)] == [3, 3]
    assert len(bench.queue) == 6
    assert {made[i] for i in bench.deliveries.given_up} == {loud}
    kept = bench.take_all()
    assert kept == sorted(kept)
    assert {4, 7, 21} <= {*kept}
    assert [bench.queue.waiting_of(client) for client in (loud, quiet)] == [0, 0]


def test_messages_of_all_clients_leave_in_their_order_also_when_they_come_back() -> None:
    bench = Bench()
    clients = [Outbox(InstantClock(0), []) for _ in range(3)]
    for i in range(12):
        delivery = bench.deliveries.make()
        delivery.client = clients[i * 7 % 3]
        bench.queue.put(delivery)
    sent = [found for found in (bench.take() for _ in range(5)) if found is not None]
    bench.queue.put_back(sent)
    assert bench.take_all() == list(range(12))


class Transport:
    """Tells what watches its buffer of it, as asyncio's do."""

    def __init__(self, now_s: Callable[[], float] = lambda: 0.0) -> None:
        self.written = self.taken = self.room = 0
        self.paused = self.closing = False
        self.watch = SocketBuffer(self, lambda: None, now_s)  # type: ignore[arg-type]

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
            self.watch.hold()

    def take(self, octets: int) -> None:
        self.room += octets
        now = min(self.room, self.get_write_buffer_size())
        self.taken += now
        self.room -= now
        if self.paused and not self.get_write_buffer_size():
            self.paused = False
            self.watch.release()


steps = st.lists(
    st.one_of(
        st.tuples(st.just("publish"), st.lists(st.integers(8, 100), min_size=1, max_size=4)),
        st.tuples(st.just("ping"), st.integers(2, 9).map(lambda octets: [octets])),
        st.tuples(st.just("take"), st.integers(1, 500).map(lambda octets: [octets])),
    ),
    max_size=60,
)


@given(steps)
def test_delivered_is_only_what_has_left_and_in_the_end_all_of_it(
    steps: list[tuple[str, list[int]]],
) -> None:
    """Of one write, too, that is of several messages."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(send_queue, "MAX_UNSENT_OCTETS", 1000)
        transport, deliveries = Transport(), Deliveries()
        watch, pings, ends = transport.watch, 0, list[int]()
        for step, sizes in steps:
            left = sum(sizes)
            if step == "take":
                transport.take(left)
            elif step == "ping":
                watch.write(bytes(left))
                pings += left
            elif watch.has_room:
                is_taken = watch.write(bytes(left))
                for octets in sizes:
                    delivery, left = deliveries.make(qos=0, octets=octets), left - octets
                    ends.append(transport.written - left)
                    if is_taken:
                        delivery.settle(delivered=True)
                    else:
                        watch.keep(delivery, left)
            else:
                assert transport.get_write_buffer_size() > 1000
            watch.is_stuck()
            for n in deliveries.delivered:
                assert ends[n] <= transport.taken + 1
            held = sum(len(p.payload) for p in deliveries.made if not p.said)
            assert held <= 1000 + 400 + 400 + pings
            told = deliveries.delivered
            assert {n for n, end in enumerate(ends) if end <= transport.taken} <= {*told}
        if steps and steps[-1][0] == "take":
            watch.give_up("MQTT")
            assert len(deliveries.given_up) == len(ends) - len(told)
        transport.take(10**6)
        assert not watch._unsent
        assert not deliveries.unsettled


def test_it_is_stuck_when_nothing_moves_for_long_and_not_when_anything_does() -> None:
    now_s = 0.0
    transport = Transport(lambda: now_s)
    watch = transport.watch
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

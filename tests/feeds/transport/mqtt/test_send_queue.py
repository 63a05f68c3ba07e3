"""The queue before an MQTT link, against a list that does the same in the simplest way."""

from __future__ import annotations

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
from plotfeed.feeds.transport.mqtt.send_queue import QueueCounts, SendQueue

POLICIES = ["drop-oldest", "drop-newest", "wait"]


def client() -> Outbox:
    return Outbox(InstantClock(0), [])


class Bench:
    """A queue, its deliveries, and a time that only the test moves."""

    def __init__(self, qos: int = 1, **settings: object) -> None:
        self.now_s = 0.0
        self.deliveries = Deliveries()
        self.counts = QueueCounts()
        queue = MqttQueueKeys.model_validate(settings)
        self.queue = SendQueue(queue, qos, self.counts, lambda: self.now_s)

    def put(self, n: int = 1, **how: object) -> None:
        for _ in range(n):
            self.queue.put(self.deliveries.make(**how))  # type: ignore[arg-type]

    def take(self) -> Message | None:
        found = self.queue.take()
        return None if found is None else found[0]

    def take_all(self) -> list[int]:
        found = []
        while (delivery := self.take()) is not None:
            found.append(delivery.number)
        return found


@pytest.mark.parametrize(
    ("policy", "kept", "dropped"),
    [
        ("drop-oldest", [7, 8, 9], [0, 1, 2, 3, 4, 5, 6]),
        ("drop-newest", [0, 1, 2], [3, 4, 5, 6, 7, 8, 9]),
        ("wait", list(range(10)), []),
    ],
)
def test_the_policy_says_which_are_kept(policy: str, kept: list[int], dropped: list[int]) -> None:
    bench = Bench(policy=policy, messages=3)
    bench.put(10)
    assert bench.deliveries.given_up == dropped
    assert bench.counts.dropped == len(dropped)
    assert bench.take_all() == kept
    assert bench.deliveries.delivered == []


def test_without_a_number_plots_of_qos_0_do_not_wait_and_10_000_of_qos_1_do() -> None:
    late, sure = Bench(qos=0), Bench(qos=1)
    late.put(5, qos=0)
    sure.put(10_005)
    assert late.deliveries.given_up == [0, 1, 2, 3, 4]
    assert len(sure.queue) == 10_000
    assert sure.deliveries.given_up == [0, 1, 2, 3, 4]


@given(
    st.sampled_from(POLICIES),
    st.integers(0, 6),
    st.lists(st.sampled_from(["put", "put", "take", "lose"]), max_size=60),
)
def test_it_does_what_the_simplest_queue_would_do(
    policy: str, limit: int, steps: list[str]
) -> None:
    bench = Bench(policy=policy, messages=limit)
    numbers = count()
    waiting: list[int] = []
    dropped: list[int] = []
    sent: list[Message] = []
    for step in steps:
        if step == "put":
            bench.put()
            if policy == "drop-oldest":
                while waiting and len(waiting) >= limit:
                    dropped.append(waiting.pop(0))
            if policy != "wait" and len(waiting) >= limit:
                dropped.append(next(numbers))
            else:
                waiting.append(next(numbers))
        elif step == "take":
            entry = bench.take()
            assert (entry is not None) == bool(waiting)
            if entry is not None:
                assert entry.number == waiting.pop(0)
                sent.append(entry)
        else:
            bench.queue.put_back(sent)
            waiting[:0] = [entry.number for entry in sent]
            sent.clear()
        assert len(bench.queue) == len(waiting)
        assert bench.deliveries.given_up == sorted(dropped)
        full = policy == "wait" and len(waiting) > 0 and len(waiting) >= limit
        assert bench.queue.is_full == full
    assert bench.take_all() == waiting
    assert bench.counts.dropped == len(dropped)


@given(st.sampled_from(POLICIES), st.lists(st.one_of(st.integers(1, 300), st.none()), max_size=40))
def test_what_waits_is_bounded_in_octets_too(policy: str, sizes: list[int | None]) -> None:
    """None takes one away."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(send_queue, "MAX_WAITING_OCTETS", 500)
        bench = Bench(policy=policy)
        most, sent = 1000 if policy == "wait" else 500, 0
        for size in sizes:
            if size is None:
                sent += bench.take() is not None
            else:
                bench.put(octets=size)
            assert bench.queue._octets.total() <= max(most, 300)
            assert bench.queue.is_full == (policy == "wait" and bench.queue._octets.total() >= 500)
        assert len(bench.deliveries.made) == sent + len(bench.queue) + bench.counts.dropped
        left = bench.take_all()
        assert left == sorted(left)
        assert bench.queue._octets.total() == 0


def test_one_message_may_wait_however_large_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(send_queue, "MAX_WAITING_OCTETS", 500)
    for policy in POLICIES:
        bench = Bench(policy=policy)
        bench.put(octets=5000)
        assert bench.take_all() == [0]


def test_whoever_does_not_wait_although_it_is_full_is_not_kept_for_ever(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(send_queue, "OVERRUN", 4)
    bench = Bench(policy="wait", messages=3)
    bench.put(20)
    assert bench.deliveries.given_up == list(range(7, 20))
    assert bench.take_all() == list(range(7))


@given(
    st.sampled_from(POLICIES),
    st.lists(st.one_of(st.sampled_from(["put", "take", "lose"]), st.floats(0, 3)), max_size=60),
)
def test_what_has_waited_too_long_is_dropped_and_nothing_else(
    policy: str, steps: list[str | float]
) -> None:
    """A number is time that passes. What was sent and comes back is as old as it was."""
    bench = Bench(policy=policy, max_age_s=5.0)
    since_s: list[float] = []
    sent: list[Message] = []
    for step in steps:
        if step == "put":
            since_s.append(bench.now_s)
            bench.put()
        elif step == "take":
            entry = bench.take()
            if entry is not None:
                assert bench.now_s - since_s[entry.number] <= 5.0
                sent.append(entry)
        elif step == "lose":
            bench.queue.put_back(sent)
            sent.clear()
        else:
            assert isinstance(step, float)
            bench.now_s += step
            bench.queue.expire()
        for old in bench.deliveries.given_up:
            assert bench.now_s - since_s[old] > 5.0
    bench.now_s += 5.1
    assert bench.take_all() == []
    assert len(bench.deliveries.given_up) == len(since_s) - len(sent)


def test_of_retained_messages_the_newest_on_each_topic_waits() -> None:
    bench = Bench(policy="wait", messages=100)
    for topic in "abacab":
        bench.put(topic=topic, retain=True)
    bench.put(topic="a")
    assert bench.deliveries.given_up == [0, 1, 2]
    assert (bench.counts.superseded, bench.counts.dropped) == (3, 0)
    assert bench.take_all() == [3, 4, 5, 6]


def test_a_retained_message_that_comes_back_gives_way_to_a_newer_one() -> None:
    bench = Bench()
    bench.put(topic="a", retain=True)
    bench.put(topic="b", retain=True)
    sent = [bench.take(), bench.take()]
    bench.put(topic="a", retain=True)
    bench.queue.put_back([entry for entry in sent if entry is not None])
    assert bench.deliveries.given_up == [0]
    assert bench.take_all() == [1, 2]


def test_a_newer_retained_message_takes_the_room_of_the_older() -> None:
    bench = Bench(policy="drop-newest", messages=2)
    bench.put(topic="a", retain=True)
    bench.put(topic="x")
    bench.put(topic="a", retain=True)
    bench.put(topic="x")
    assert bench.deliveries.given_up == [0, 3]
    assert bench.take_all() == [1, 2]


def test_all_that_waits_is_given_up_at_the_end() -> None:
    bench = Bench()
    bench.put(50, octets=20)
    bench.queue.give_up()
    assert bench.deliveries.given_up == list(range(50))
    assert (len(bench.queue), bench.queue._octets.total(), bench.counts.dropped) == (0, 0, 50)


@pytest.mark.parametrize("policy", POLICIES)
def test_no_client_takes_the_room_of_another(policy: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(send_queue, "OVERRUN", 0)
    bench = Bench(policy=policy, messages=3)
    loud, quiet = client(), client()
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
    clients = [client() for _ in range(3)]
    for i in range(12):
        delivery = bench.deliveries.make()
        delivery.client = clients[i * 7 % 3]
        bench.queue.put(delivery)
    sent = [found for found in (bench.take() for _ in range(5)) if found is not None]
    bench.queue.put_back(sent)
    assert bench.take_all() == list(range(12))

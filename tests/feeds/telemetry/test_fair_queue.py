from __future__ import annotations

import tracemalloc
from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.fair_queue import FairQueue, Turn


def payloads(turns: list[Turn]) -> dict[str, list[int]]:
    return {topic: [int(payload) for payload, _ in waiting] for topic, waiting in turns}


def put(queue: FairQueue, topic: str, *numbers: int) -> None:
    for number in numbers:
        queue.put(topic, str(number).encode(), None)


def test_a_topic_that_floods_drops_its_own_oldest_and_nothing_else() -> None:
    queue = FairQueue(limit_of_topic=10)
    put(queue, "quiet", 0)
    put(queue, "flood", *range(1000))
    put(queue, "later", 0)
    assert queue.dropped == {"flood": 990}
    taken = payloads(queue.take(1000))
    assert taken == {"quiet": [0], "flood": [*range(990, 1000)], "later": [0]}
    assert [*taken] == ["quiet", "flood", "later"]
    assert len(queue) == 0


def test_one_at_a_time_topics_have_turns_and_nothing_is_lost() -> None:
    queue = FairQueue()
    put(queue, "many", 0, 1, 2)
    put(queue, "few", 3)
    queue.put("few", b"4" * 20_000, None)
    taken = [queue.take_one() for _ in range(5)]
    assert [topic for topic, _ in taken] == ["many", "few", "many", "few", "many"]
    assert [int(payload[:1]) for _, ((payload, _),) in taken] == [0, 3, 1, 4, 2]
    assert (len(queue), queue._large_octets) == (0, 0)
    assert queue.behind_s() == 0


def test_topics_have_turns_however_much_each_brings() -> None:
    queue, served = FairQueue(limit_of_topic=8), Counter[str]()
    for _ in range(100):
        put(queue, "flood", *range(50))
        put(queue, "a", 1)
        put(queue, "b", 1)
        for topic, _ in queue.take(1):
            served[topic] += 1
    assert max(served.values()) - min(served.values()) <= 1


def test_a_known_topic_has_room_beside_a_thousand_strangers() -> None:
    queue = FairQueue(limit=500, limit_of_strangers=100)
    queue.know("drone")
    for i in range(1_000):
        put(queue, f"stranger{i}", i)
    put(queue, "drone", 1)
    assert len(queue) == 101
    assert "drone" in payloads(queue.take(1000))
    put(queue, "newcomer", 1)
    assert "newcomer" in payloads(queue.take(1000))


def test_where_all_is_full_a_known_topic_still_has_room_for_its_latest() -> None:
    queue = FairQueue(limit=20, limit_of_topic=10)
    for topic in ("a", "b", "c"):
        queue.know(topic)
        put(queue, topic, *range(10))
    assert payloads(queue.take(1000)) == {"a": [*range(10)], "b": [*range(10)], "c": [9]}


def test_memory_is_bounded_whatever_comes() -> None:
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    queue = FairQueue()
    for i in range(3_000):
        for _ in range(3):
            queue.put(f"plotfeed/telemetry/stranger{i}", bytes(100), None)
        queue.put("plotfeed/telemetry/big", bytes(1 << 20), None)
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after - before < 20 << 20
    assert queue.given_up == 12_000 - len(queue)
    assert len(queue.dropped) <= 51


def test_the_age_of_the_oldest_is_told() -> None:
    now_s = 5.0
    queue = FairQueue(now_s=lambda: now_s)
    assert queue.behind_s() == 0.0
    put(queue, "a", 1)
    now_s = 6.0
    put(queue, "b", 1)
    now_s = 7.5
    assert queue.behind_s() == 2.5
    queue.take(1)
    now_s = 8.0
    assert queue.behind_s() == 2.0
    queue.take(1)
    assert queue.behind_s() == 0.0


@given(
    st.lists(
        st.tuples(st.sampled_from("abcdef"), st.integers(1, 9)) | st.integers(1, 12), max_size=80
    ),
    st.sets(st.sampled_from("abc")),
)
def test_each_topic_keeps_its_order_and_every_message_is_counted(
    steps: list[tuple[str, int] | int], known: set[str]
) -> None:
    queue = FairQueue(limit=20, limit_of_topic=6, limit_of_strangers=2)
    for topic in known:
        queue.know(topic)
    number, taken, last = 0, 0, dict[str, int]()

    def take(least: int) -> int:
        turns = payloads(queue.take(least))
        for topic, numbers in turns.items():
            assert numbers == sorted(numbers)
            assert numbers[0] > last.get(topic, -1)
            last[topic] = numbers[-1]
        return sum(map(len, turns.values()))

    for step in steps:
        if isinstance(step, int):
            taken += take(step)
        else:
            topic, many = step
            put(queue, topic, *range(number, number + many))
            number += many
        assert len(queue) <= 20 + len(known)
        assert queue.given_up == queue.dropped.total() == number - taken - len(queue)
    take(1000)
    assert len(queue) == 0

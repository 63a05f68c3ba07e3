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


def test_one_at_a_time_topics_have_turns_and_nothing_is_lost() -> None:
    queue = FairQueue()
    put(queue, "many", 0, 1, 2)
    put(queue, "few", 3)
    queue.put("few", b"4" * 20_000, None)
    taken = [queue.take_one() for _ in range(5)]
    assert [(topic, payload[:1]) for topic, ((payload, _),) in taken] == [
        ("many", b"0"), ("few", b"3"), ("many", b"1"), ("few", b"4"), ("many", b"2")
    ]  # fmt: skip
    assert (len(queue), queue._large_octets, queue.behind_s()) == (0, 0, 0)


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
        st.tuples(st.sampled_from("abcdef"), st.sampled_from([1, 1, 2, 9]))
        | st.sampled_from([0, 0, 0, 1, 4, 12])
        | st.sampled_from(["know a", "know f", "forget a"]),
        min_size=20,
        max_size=80,
    )
)
def test_it_does_what_the_simplest_queue_of_queues_would_do(
    steps: list[tuple[str, int] | int | str],
) -> None:
    """Topics have turns; one that floods drops its own oldest, and strangers keep nobody out."""
    limit, of_topic, strangers = 20, 6, 2
    queue = FairQueue(limit=limit, limit_of_topic=of_topic, limit_of_strangers=strangers)
    turns, known, dropped, number = dict[str, list[int]](), set[str](), Counter[str](), 0

    def room(topic: str) -> bool:
        """Whether a topic of which nothing waits may have a turn."""
        is_full = sum(map(len, turns.values())) >= limit
        return topic in known or not (is_full or len({*turns} - known) >= strangers)

    for step in [*steps, 1000]:
        if isinstance(step, tuple):
            topic, many = step
            put(queue, topic, *range(number, number + many))
            for n in range(number, number + many):
                if topic in turns:
                    total = sum(map(len, turns.values()))
                    if len(turns[topic]) >= of_topic or total >= limit:
                        turns[topic].pop(0)
                        dropped[topic] += 1
                    turns[topic].append(n)
                elif room(topic):
                    turns[topic] = [n]
                else:
                    dropped[topic] += 1
            number += many
        elif isinstance(step, str):
            what, _, topic = step.partition(" ")
            (queue.know if what == "know" else queue.forget)(topic)
            (known.add if what == "know" else known.discard)(topic)
        elif step == 0 and turns:  # one message of the topic whose turn it is
            topic = next(iter(turns))
            first, *more = turns.pop(topic)
            assert payloads([queue.take_one()]) == {topic: [first]}
            if more:
                turns[topic] = more
        elif step:
            expected = dict[str, list[int]]()
            while turns and sum(map(len, expected.values())) < step:
                topic = next(iter(turns))
                expected[topic] = turns.pop(topic)
            assert [*payloads(queue.take(step)).items()] == [*expected.items()]
        assert len(queue) == sum(map(len, turns.values()))
        assert queue.dropped == dropped
    assert (len(queue), queue.given_up) == (0, dropped.total())

"""The bounded queue against a list, and its counts."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.messages.bounded_queue import BoundedQueue

STEPS = st.lists(
    st.one_of(st.integers(0, 30), st.sampled_from(["take", "put back", "drop", "drop all"])),
    max_size=60,
)


@given(st.integers(0, 5), st.one_of(st.none(), st.integers(0, 60)), st.booleans(), STEPS)
def test_it_keeps_its_order_and_limits_and_counts_everything(
    limit: int, limit_octets: int | None, alone: bool, steps: list[int | str]
) -> None:
    """A number is put in, and is its own size."""
    queue = BoundedQueue[int](
        limit, limit_octets=limit_octets, octets_of=lambda size: size, any_size_alone=alone
    )
    waiting: list[int] = []
    taken: list[int] = []
    put = dropped = 0
    for step in steps:
        if isinstance(step, int):
            fits = limit_octets is None or sum(waiting) + step <= limit_octets
            room = len(waiting) < limit and (fits or (alone and not waiting))
            assert queue.put(step) == room
            put, dropped = put + room, dropped + (not room)
            waiting += [step] * room
        elif step == "put back":
            while taken:
                waiting.insert(0, taken.pop())
                queue.put_back(waiting[0])
        elif step == "drop all":
            assert queue.drop_all() == waiting
            dropped += len(waiting)
            waiting.clear()
        elif waiting:
            assert queue.first() == waiting[0]
            if step == "take":
                taken.append(queue.take())
                assert taken[-1] == waiting.pop(0)
            else:
                assert queue.drop() == waiting.pop(0)
                dropped += 1
        found = queue.statistics()
        assert (found.limit, found.waiting, found.octets) == (limit, len(waiting), sum(waiting))
        assert (found.put, found.dropped) == (put, dropped)
        assert len(queue) == len(waiting)


def test_what_has_a_key_is_found_by_it_and_keeps_its_place() -> None:
    queue = BoundedQueue[str](3)
    for item, key in (("a", None), ("b", "key"), ("c", None)):
        assert queue.put(item, key)
    assert "key" in queue
    assert "other" not in queue
    assert queue.drop("key") == "b"
    assert "key" not in queue
    assert [queue.take(), queue.take()] == ["a", "c"]

"""The bounded queue against a list."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.messages.bounded_queue import BoundedQueue

STEPS = st.lists(
    st.one_of(st.integers(0, 30), st.sampled_from(["take", "put back", "clear"])), max_size=60
)


@given(st.integers(0, 5), st.integers(0, 60), st.booleans(), STEPS)
def test_it_keeps_its_order_and_limits(
    limit: int, limit_octets: int, alone: bool, steps: list[int | str]
) -> None:
    """A number is put in, and is its own size."""
    queue = BoundedQueue[int](
        limit, limit_octets=limit_octets, octets_of=lambda size: size, any_size_alone=alone
    )
    waiting: list[int] = []
    taken: list[int] = []
    for number, step in enumerate(steps):
        if isinstance(step, int):
            fits = sum(waiting) + step <= limit_octets
            room = len(waiting) < limit and (fits or (alone and not waiting))
            assert queue.has_room(step) == room
            assert queue.put(step) == room
            waiting += [step] * room
        elif step == "put back":
            while taken:
                waiting.insert(0, taken.pop())
                queue.put_back(waiting[0], ("back", number, len(taken)))
        elif step == "clear":
            queue.clear()
            waiting.clear()
        elif waiting:
            assert queue.first() == waiting[0]
            taken.append(queue.take())
            assert taken[-1] == waiting.pop(0)
        assert (len(queue), queue.octets) == (len(waiting), sum(waiting))


def test_what_has_a_key_is_found_by_it_and_others_keep_their_places() -> None:
    queue = BoundedQueue[str](3, limit_octets=10, octets_of=len)
    for item, key in (("a", None), ("b", "key"), ("c", None)):
        assert queue.put(item, key)
    assert queue.take("key") == "b"
    assert [queue.take(), queue.take()] == ["a", "c"]

"""The bounded queue against a list."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.messages.bounded_queue import BoundedQueue

STEPS = st.lists(st.one_of(st.integers(0, 30), st.sampled_from(["take", "clear"])), max_size=60)


@given(st.integers(0, 5), st.integers(0, 60), STEPS)
def test_it_keeps_its_order_and_limits(
    limit: int, limit_octets: int, steps: list[int | str]
) -> None:
    """A number is put in, and is its own size."""
    queue = BoundedQueue[int](limit, limit_octets=limit_octets, octets_of=lambda size: size)
    waiting: list[int] = []
    for step in steps:
        if isinstance(step, int):
            room = len(waiting) < limit and sum(waiting) + step <= limit_octets
            assert queue.put(step) == room
            waiting += [step] * room
        elif step == "clear":
            queue.clear()
            waiting.clear()
        elif waiting:
            assert queue.take() == waiting.pop(0)
        assert (len(queue), queue.octets) == (len(waiting), sum(waiting))

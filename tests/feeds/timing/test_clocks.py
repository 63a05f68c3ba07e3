from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import closing

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.waiting import PATIENCE_S

from plotfeed.feeds.timing.clock import (
    MOST_BEHIND_NS,
    InstantClock,
    LoopTimer,
    Schedule,
    TimerFd,
    WallClock,
    precise_timer,
)

MS = 1_000_000
S = 1_000_000_000
START = 1_767_268_800 * S


def test_a_wall_clock_tells_utc() -> None:
    before = time.time_ns()
    clock = WallClock()
    assert before - S < clock.now_ns() < time.time_ns() + S


def test_a_given_start_stands_still_until_the_session_begins() -> None:
    clock = WallClock(START)
    time.sleep(0.01)
    assert clock.now_ns() == START
    assert clock.start() == START
    assert START <= clock.now_ns() < START + 60 * S
    time.sleep(0.01)
    assert clock.start() >= START + 10 * MS  # it runs already


def test_a_clock_that_can_be_held_is_the_world_s_until_then() -> None:
    clock, real = WallClock(can_be_held=True), WallClock()
    assert (clock.is_real, real.is_real) == (False, True)
    assert abs(clock.now_ns() - real.now_ns()) < 10**9
    clock.pause()
    stood_ns = clock.now_ns()
    assert clock.is_paused
    assert clock.now_ns() == stood_ns


@pytest.mark.parametrize("speed", [0.5, 1.0, 20.0])
@pytest.mark.asyncio
async def test_nobody_wakes_before_the_time(speed: float) -> None:
    async with asyncio.timeout(PATIENCE_S):
        with closing(WallClock(START, speed=speed)) as clock:
            clock.start()
            for step in (1, 2, 3, 9):
                until = START + round(step * 5 * MS * speed) + 1
                await clock.sleep_until(until)
                assert clock.now_ns() >= until


@pytest.mark.asyncio
async def test_a_time_that_is_past_is_no_wait_and_lets_others_run() -> None:
    async with asyncio.timeout(PATIENCE_S):
        clock, ran = WallClock(START), 0

        async def other() -> None:
            nonlocal ran
            ran += 1

        task = asyncio.create_task(other())
        await clock.sleep_until(START - 1000 * S)
        await task
        clock.close()
    assert ran == 1


@pytest.mark.asyncio
async def test_a_fast_clock_waits_for_who_is_behind_and_tells_the_speed_it_reached() -> None:
    async with asyncio.timeout(PATIENCE_S):
        clock, before = WallClock(START, speed=1000.0), START
        clock.start()
        for until in range(START + S, START + 6 * S, S):
            await clock.sleep_until(until)
            time.sleep(0.01)  # noqa: ASYNC251 - ten seconds of its time
            assert before <= until <= clock.now_ns() <= until + MOST_BEHIND_NS
            assert clock.left_ns(until + S) > 0
            before = clock.now_ns()
        assert clock.reached < 500
        clock.set_speed(1.0)
        assert (clock.can_wait, clock.reached) == (False, 1.0)
        time.sleep(0.2)  # noqa: ASYNC251 - longer than a fast clock would run by itself
        assert clock.now_ns() >= before + 200 * MS
        clock.close()


@pytest.mark.asyncio
async def test_a_simulated_clock_jumps_and_never_goes_back() -> None:
    clock = InstantClock(START)
    assert clock.start() == START
    await clock.sleep_until(START + 3600 * S)
    assert clock.now_ns() == START + 3600 * S
    await clock.sleep_until(START)
    assert clock.now_ns() == START + 3600 * S
    clock.close()


@pytest.mark.parametrize("make", [LoopTimer, TimerFd, precise_timer])
@pytest.mark.asyncio
async def test_a_timer_keeps_its_order_of_waits(make: Callable[[], LoopTimer | TimerFd]) -> None:
    async with asyncio.timeout(PATIENCE_S):
        timer = make()
        begun = time.monotonic_ns()
        for after in (3 * MS, 1 * MS, 5 * MS, 5 * MS + 1, 20 * MS):
            await timer.wait_until(begun + after)
            assert time.monotonic_ns() >= begun + after
        timer.close()
        timer.close()


@pytest.mark.parametrize("make", [LoopTimer, TimerFd])
@pytest.mark.asyncio
async def test_a_wait_can_be_cancelled_and_the_timer_used_again(
    make: Callable[[], LoopTimer | TimerFd],
) -> None:
    async with asyncio.timeout(PATIENCE_S):
        timer = make()
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(timer.wait_until(time.monotonic_ns() + 3600 * S), 0.01)
        soon = time.monotonic_ns() + 2 * MS
        await timer.wait_until(soon)
        assert time.monotonic_ns() >= soon
        timer.close()


@pytest.mark.asyncio
async def test_a_cancelled_wait_does_not_end_the_next_one_early() -> None:
    async with asyncio.timeout(PATIENCE_S):
        timer = TimerFd()
        for _ in range(20):
            near = asyncio.ensure_future(timer.wait_until(time.monotonic_ns() + MS))
            await asyncio.sleep(0)
            near.cancel()
            time.sleep(0.002)  # noqa: ASYNC251 - it shall expire while nobody waits
            later = time.monotonic_ns() + 5 * MS
            await timer.wait_until(later)
            assert time.monotonic_ns() >= later
        timer.close()


@given(st.lists(st.integers(0, 20), max_size=60))
def test_things_are_done_in_the_order_of_their_deadlines(due: list[int]) -> None:
    """And what is put meanwhile, if it is due."""
    schedule, done = Schedule(), list[tuple[int, int]]()
    late = list[int]()
    for order, t in enumerate(due):
        schedule.put(t, lambda t=t, order=order: done.append((t, order)))  # type: ignore[misc]
    schedule.put(5, lambda: schedule.put(3, lambda: late.append(5)))
    for now in range(21):
        for due_ns, action in schedule.due_by(now):
            assert due_ns <= now
            action()
        assert all(t <= now for t, _ in done)
        assert late == [5] * (now >= 5)
    assert done == sorted((t, order) for order, t in enumerate(due))
    assert schedule.next_due_ns() is None

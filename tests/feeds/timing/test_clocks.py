"""Clocks, timers and schedules: nobody goes on before the time, and little after it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import closing

import numpy as np
import pytest
import pytest_asyncio
from hypothesis import given
from hypothesis import strategies as st
from support.waiting import PATIENCE_S

from plotfeed.feeds.timing.clock import (
    MAX_EARLY_NS,
    MOST_BEHIND_NS,
    SAVED_NS,
    SHARE,
    EarlyWaking,
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


def test_a_clock_that_can_be_held_is_the_world_s_until_then() -> None:
    clock, real = WallClock(can_be_held=True), WallClock()
    assert (clock.is_real, real.is_real) == (False, True)
    assert abs(real.now_ns() - time.time_ns()) < S
    assert abs(clock.now_ns() - real.now_ns()) < S
    clock.pause()
    stood_ns = clock.now_ns()
    assert clock.is_paused
    assert clock.now_ns() == stood_ns


def test_a_given_start_stands_still_until_the_session_begins() -> None:
    clock = WallClock(START)
    time.sleep(0.01)
    assert clock.now_ns() == START
    assert clock.start() == START
    assert START <= clock.now_ns() < START + 60 * S
    time.sleep(0.01)
    assert clock.start() >= START + 10 * MS  # it runs already


@pytest.mark.parametrize("speed", [0.25, 1.0, 50.0])
def test_what_is_left_is_real_time_without_end_where_time_stands(speed: float) -> None:
    clock = WallClock(START, speed=speed)
    begin_ns, before_ns = clock.start(), time.monotonic_ns()
    left_ns = clock.left_ns(begin_ns + round(3600 * S * speed))
    passed_ns = time.monotonic_ns() - before_ns
    assert 3600 * S - left_ns < 10 * S
    assert left_ns <= 3600 * S + passed_ns
    assert clock.left_ns(begin_ns - S) < 0
    clock.pause()
    assert clock.left_ns(clock.now_ns() + 1) > 10**9 * S
    assert InstantClock(0).left_ns(1) > 10**9 * S


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
    with closing(WallClock(START)) as clock:
        ran: list[int] = []
        asyncio.get_running_loop().call_soon(ran.append, 1)
        await clock.sleep_until(START - 1000 * S)
        assert clock.now_ns() < START + 60 * S
    assert ran == [1]


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
    for until in (START + 3600 * S, START):
        await clock.sleep_until(until)
        assert clock.now_ns() == START + 3600 * S
    clock.close()


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


# Timers, and how early to be awake for them.

TIMERS = pytest.mark.parametrize("make", [LoopTimer, TimerFd, precise_timer])


@TIMERS
@pytest.mark.asyncio
async def test_nobody_goes_on_before_the_time_however_near_it_is(
    make: Callable[[], LoopTimer],
) -> None:
    async with asyncio.timeout(PATIENCE_S):
        timer = make()
        for gap_ns in (0, -S, 1000, 20_000, 50_000, 300_000, MS, 5 * MS, 20 * MS) * 3:
            until_ns = time.monotonic_ns() + gap_ns
            await timer.wait_until(until_ns)
            assert time.monotonic_ns() >= until_ns
        timer.close()
        timer.close()


@TIMERS
@pytest.mark.asyncio
async def test_a_cancelled_wait_does_not_end_the_next_one_early(
    make: Callable[[], LoopTimer],
) -> None:
    async with asyncio.timeout(PATIENCE_S):
        with closing(make()) as timer:
            for _ in range(20):
                near = asyncio.ensure_future(timer.wait_until(time.monotonic_ns() + MS))
                await asyncio.sleep(0)
                near.cancel()
                time.sleep(0.002)  # noqa: ASYNC251 - it shall expire while nobody waits
                later = time.monotonic_ns() + 5 * MS
                await timer.wait_until(later)
                assert time.monotonic_ns() >= later


@pytest_asyncio.fixture
async def timer() -> AsyncIterator[TimerFd]:
    with closing(TimerFd()) as timer:
        yield timer


@pytest.fixture
def looked(timer: TimerFd, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Until when the timer has looked at the clock, which it does no more."""
    found: list[int] = []
    monkeypatch.setattr(timer, "_look_until", found.append)
    return found


@pytest.mark.parametrize("after_ns", [10_000, 3600 * S])
@pytest.mark.asyncio
async def test_who_is_woken_returns_at_once_however_near_the_time(
    timer: TimerFd, looked: list[int], after_ns: int
) -> None:
    asyncio.get_running_loop().call_soon(timer.wake)
    async with asyncio.timeout(PATIENCE_S):
        await timer.wait_until(time.monotonic_ns() + after_ns)
    assert looked == []


@pytest.mark.asyncio
async def test_who_need_not_be_exact_is_not_awake_for_it(timer: TimerFd, looked: list[int]) -> None:
    for _ in range(5):
        until_ns = time.monotonic_ns() + MS
        await timer.wait_until(until_ns, exactly=False)
        assert time.monotonic_ns() >= until_ns
    assert looked == []


@pytest.mark.asyncio
async def test_a_timer_that_expires_long_after_it_was_set_wakes_nobody(timer: TimerFd) -> None:
    asyncio.get_running_loop().call_soon(timer.wake)
    await timer.wait_until(time.monotonic_ns() + 2 * MS)
    time.sleep(0.01)  # noqa: ASYNC251 - it shall expire while nobody waits
    waiting = asyncio.ensure_future(timer.wait_for_wake())
    await asyncio.sleep(0.01)
    assert not waiting.done()
    timer.wake()
    await waiting


def test_how_early_to_wake_is_how_late_19_of_20_wake_ups_are() -> None:
    rng, early, found = np.random.default_rng(1), EarlyWaking(), []
    for i, late_ns in enumerate(rng.exponential(40_000, 8000)):
        early.woke(int(late_ns))
        found.append(early.early_ns(i * S))
    assert np.median(found[4000:]) == pytest.approx(40_000 * np.log(20), rel=0.1)


def test_a_stall_of_the_machine_is_soon_forgotten() -> None:
    early = EarlyWaking()
    for _ in range(200):
        early.woke(20_000)
    before_ns = early.early_ns(S)
    early.woke(50 * MS)
    assert early.early_ns(2 * S) <= 1.3 * before_ns
    for _ in range(50):
        early.woke(50 * MS)
    assert early.early_ns(3 * S) == MAX_EARLY_NS


@given(st.lists(st.tuples(st.integers(0, 2 * MS), st.integers(0, MS)), max_size=200))
def test_no_more_than_a_share_of_the_time_is_spent_awake(waits: list[tuple[int, int]]) -> None:
    early, begin_ns, spent_ns = EarlyWaking(), 5 * S, 0
    now_ns = begin_ns
    for gap_ns, late_ns in waits:
        early_ns = early.early_ns(now_ns)
        now_ns += gap_ns
        early.woke(late_ns)
        awake_ns = max(0, early_ns - late_ns)
        early.awake(awake_ns)
        now_ns, spent_ns = now_ns + awake_ns, spent_ns + awake_ns
        assert spent_ns <= SAVED_NS + (now_ns - begin_ns) / SHARE

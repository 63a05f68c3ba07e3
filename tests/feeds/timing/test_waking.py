"""Waking at the moment: how early to be awake, and that nobody is early for all that."""

from __future__ import annotations

import asyncio
import time
from contextlib import closing

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.waiting import PATIENCE_S

from plotfeed.feeds.timing.clock import (
    MAX_EARLY_NS,
    SAVED_NS,
    SHARE,
    EarlyWaking,
    InstantClock,
    TimerFd,
    WallClock,
)

MS = 1_000_000
S = 1_000_000_000


@pytest.mark.asyncio
async def test_nobody_who_wakes_early_goes_on_before_the_time() -> None:
    async with asyncio.timeout(PATIENCE_S):
        with closing(TimerFd()) as timer:
            for gap_ns in (0, -S, 1000, 20_000, 50_000, 300_000, MS, 5 * MS, 20 * MS) * 3:
                until_ns = time.monotonic_ns() + gap_ns
                await timer.wait_until(until_ns)
                assert time.monotonic_ns() >= until_ns


@pytest.mark.parametrize("after_ns", [10_000, 3600 * S])
@pytest.mark.asyncio
async def test_who_is_woken_returns_at_once_however_near_the_time(after_ns: int) -> None:
    async with asyncio.timeout(PATIENCE_S):
        with closing(TimerFd()) as timer:
            looked = list[int]()
            timer._look_until = looked.append  # type: ignore[method-assign]
            asyncio.get_running_loop().call_soon(timer.wake)
            await timer.wait_until(time.monotonic_ns() + after_ns)
            assert looked == []


@pytest.mark.asyncio
async def test_a_timer_that_expires_long_after_it_was_set_wakes_nobody() -> None:
    async with asyncio.timeout(PATIENCE_S):
        with closing(TimerFd()) as timer:
            asyncio.get_running_loop().call_soon(timer.wake)
            await timer.wait_until(time.monotonic_ns() + 2 * MS)
            time.sleep(0.01)  # noqa: ASYNC251 - it shall expire while nobody waits
            waiting = asyncio.ensure_future(timer.wait_for_wake())
            await asyncio.sleep(0.01)
            assert not waiting.done()
            timer.wake()
            await waiting


@pytest.mark.asyncio
async def test_who_need_not_be_exact_is_not_awake_for_it() -> None:
    async with asyncio.timeout(PATIENCE_S):
        with closing(TimerFd()) as timer:
            looked = list[int]()
            timer._look_until = looked.append  # type: ignore[method-assign]
            for _ in range(5):
                until_ns = time.monotonic_ns() + MS
                await timer.wait_until(until_ns, exactly=False)
                assert time.monotonic_ns() >= until_ns
            assert looked == []


def test_how_early_to_wake_is_how_late_19_of_20_wake_ups_are() -> None:
    rng, early = np.random.default_rng(1), EarlyWaking()
    for late_ns in rng.exponential(40_000, 4000):
        early.woke(int(late_ns))
    found = []
    for i, late_ns in enumerate(rng.exponential(40_000, 4000)):
        early.woke(int(late_ns))
        found.append(early.early_ns(i * S))
    assert np.median(found) == pytest.approx(40_000 * np.log(20), rel=0.1)


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


@pytest.mark.parametrize("speed", [0.25, 1.0, 50.0])
def test_what_is_left_is_real_time(speed: float) -> None:
    clock = WallClock(1_767_268_800 * S, speed=speed)
    begin_ns = clock.start()
    before_ns = time.monotonic_ns()
    left_ns = clock.left_ns(begin_ns + round(3600 * S * speed))
    passed_ns = time.monotonic_ns() - before_ns
    assert 3600 * S - left_ns < 10 * S
    assert left_ns <= 3600 * S + passed_ns
    assert clock.left_ns(begin_ns - S) < 0


def test_where_time_stands_there_is_no_end_of_it() -> None:
    clock = WallClock(1_767_268_800 * S)
    clock.start()
    clock.pause()
    assert clock.left_ns(clock.now_ns() + 1) > 10**9 * S
    assert InstantClock(0).left_ns(1) > 10**9 * S

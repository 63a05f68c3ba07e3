"""A lease ends at who has it before anybody else takes it for ended."""

from __future__ import annotations

import asyncio
import random

import pytest
from support.waiting import until

from plotfeed.feeds.fleet.lease import LeaseBook, WorkerLease


class Time:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.mark.asyncio
async def test_a_lease_is_held_from_when_it_was_asked_for_not_from_the_answer() -> None:
    """An answer that reaches a worker which was frozen meanwhile does not renew what has ended."""
    time = Time()
    lease = WorkerLease(2.0, time)
    number = await lease.until_to_be_asked()
    time.now_s = 1.0
    lease.granted(number)
    assert lease.holds
    time.now_s = 1.99
    assert lease.holds
    number = await lease.until_to_be_asked()
    time.now_s = 60.0  # frozen, and the answer waits in a buffer
    assert not lease.holds
    lease.granted(number)
    assert not lease.holds


@pytest.mark.asyncio
@pytest.mark.parametrize("seed", range(20))
async def test_no_two_hold_a_part_at_once_however_questions_and_answers_are_delayed(
    seed: int,
) -> None:
    """Workers whose clocks show anything, and run at the same pace as the book's."""
    by_chance, world = random.Random(seed), Time()  # noqa: S311
    book = LeaseBook(2.0, world)
    holders: list[WorkerLease] = []
    pending: list[tuple[WorkerLease, int, int]] = []
    for step in range(300):
        world.now_s += by_chance.uniform(0.0, 0.4)
        if not holders or (book.left_s("part") <= 0 and by_chance.random() < 0.5):
            offset_s = by_chance.uniform(-1e6, 1e6)
            holders.append(WorkerLease(2.0, lambda offset_s=offset_s: world.now_s + offset_s))
            book.begin("part")
            number = await holders[-1].until_to_be_asked()
            if book.renew("part", len(holders)):
                pending.append((holders[-1], number, len(holders)))
        for epoch, holder in enumerate(holders, 1):
            is_silent = epoch == len(holders) and (step // 40) % 2
            if by_chance.random() < 0.3 and not is_silent:
                holder._wanted.set()
                number = await holder.until_to_be_asked()
                world.now_s += by_chance.uniform(0.0, 0.3)
                if book.renew("part", epoch):
                    pending.append((holder, number, epoch))
        by_chance.shuffle(pending)
        while pending and by_chance.random() < 0.7:
            holder, number, _ = pending.pop()
            holder.granted(number)
        assert sum(holder.holds for holder in holders) <= 1
    assert len(holders) > 3


@pytest.mark.asyncio
async def test_who_connects_waits_for_an_answer_to_a_question_of_its_own() -> None:
    lease = WorkerLease(60.0)
    lease.granted(await lease.until_to_be_asked())
    assert lease.holds
    waiting = asyncio.create_task(lease.renewed())
    await asyncio.sleep(0)
    assert not waiting.done()
    lease.granted(await lease.until_to_be_asked())
    await until(waiting.done)


@pytest.mark.asyncio
async def test_what_is_lost_is_never_held_again() -> None:
    lease = WorkerLease(60.0)
    number = await lease.until_to_be_asked()
    lease.lose()
    lease.granted(number)
    assert not lease.holds

"""The loop of a session: what is done when, what can wait, and who is waited for."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any

import pytest
from support.waiting import until

from plotfeed.feeds.session.loop import LATER_EVERY_SIMULATED_NS, MAX_LATER, SessionLoop, first_of
from plotfeed.feeds.timing.clock import ActionKind, Clock, InstantClock, Schedule, WallClock

MS = 1_000_000


class Case:
    """A loop that writes down what it does and takes in, and when."""

    def __init__(
        self,
        clock: Clock | None = None,
        before_due: Sequence[Callable[[int], object]] = (),
        waits_for: Sequence[Any] = (),
    ) -> None:
        self.clock = clock or InstantClock(0)
        self.done: list[tuple[str, int]] = []
        self.inputs: list[str] = []
        self.told: list[int] = []  # When something came in, after nothing waited
        self.loop = SessionLoop(
            self.clock,
            Schedule(self.clock.wake),
            inputs=self,
            on_input=lambda: self.told.append(self.clock.now_ns()),
            drain=lambda: asyncio.sleep(0),
            waits_for=waits_for,
            before_due=before_due,
            write_later=lambda names: self.done.extend((n, self.clock.now_ns()) for n in names),
        )

    def at(
        self, t_ns: int, name: str, kind: ActionKind = ActionKind.WORK, later: Sequence[str] = ()
    ) -> None:
        """Do something then, and what can wait after it."""

        def act() -> None:
            self.loop.later(later)
            self.done.append((name, self.clock.now_ns()))

        self.loop.schedule.put(t_ns, act, kind)

    @property
    def names(self) -> list[str]:
        return [name for name, _ in self.done]

    def __len__(self) -> int:
        return len(self.inputs)

    def queue(self, topic: str, _payload: bytes, _content_type: str | None) -> None:
        self.inputs.append(topic)

    def take_in(self, as_of_ns: int, until: Callable[[], bool]) -> None:
        while self.inputs:
            self.done.append((self.inputs.pop(0), as_of_ns))
            if until():
                return

    def come_in(self, topic: str) -> None:
        self.loop.queue_input(topic, b"", None)


@pytest.mark.asyncio
async def test_what_can_wait_is_done_together_at_fixed_times() -> None:
    case, s = Case(), LATER_EVERY_SIMULATED_NS
    for t, name in ((5, "first"), (5, "second"), (6, "third"), (s + 1, "fourth")):
        case.at(t, name, later=[f"ledger of {name}"])
    await case.loop.work(3 * s)
    assert case.done == [
        *[("first", 5), ("second", 5), ("third", 6)],
        *[(f"ledger of {name}", s) for name in ("first", "second", "third")],
        *[("fourth", s + 1), ("ledger of fourth", 2 * s)],
    ]


@pytest.mark.asyncio
async def test_what_is_handed_in_comes_before_what_is_due_and_what_comes_in_waits_for_a_tick() -> (
    None
):
    times = [3, 5, 6, 8]

    def again(due_ns: int) -> None:
        while times and times[0] < due_ns:
            case.done.append(("again", times.pop(0)))

    def flood() -> None:
        for i in range(200):
            case.come_in(str(i))

    case = Case(before_due=[again])
    case.loop.schedule.put(5, flood)
    for t in (5, 6, 7):
        case.at(t, "due")
    await case.loop.work(10)
    expected = [("again", 3), ("due", 5), ("again", 5), ("due", 6), ("again", 6), ("due", 7)]
    assert case.done == expected
    assert (case.told, len(case.inputs)) == ([5], 200)


@pytest.mark.asyncio
async def test_what_can_wait_does_not_pile_up_however_late_the_session_is() -> None:
    class Late(InstantClock):
        """By which everything is long past."""

        leaps = False

        def now_ns(self) -> int:
            return 10**15

    case, number, waiting = Case(Late(0)), 3 * MAX_LATER, list[int]()

    def work() -> None:
        case.loop.later(["ledger"])
        waiting.append(len(waiting) + 1 - len(case.done))

    for t in range(number):
        case.loop.schedule.put(t, work)
    await case.loop.work(number)
    assert max(waiting) == MAX_LATER
    case.loop.do_all_later()
    assert len(case.done) == number


@pytest.mark.parametrize(
    ("least", "expected"),
    [(ActionKind.DELIVERY, ["delivery"]), (ActionKind.SENDING, ["sending", "delivery"])],
)
@pytest.mark.asyncio
async def test_at_the_end_only_what_was_handed_over_is_still_done(
    least: ActionKind, expected: list[str]
) -> None:
    case = Case()
    for t, name in enumerate(("work", "sending", "delivery"), 11):
        case.at(t, name, ActionKind[name.upper()])
    await case.loop.work(10)
    assert case.done == []
    await case.loop.finish(least)
    assert case.names == expected


@pytest.mark.asyncio
async def test_a_way_out_that_fills_up_holds_everything_until_it_has_room() -> None:
    """A stall leaves many things due at once: no more of them is done than it takes."""
    held = list[int]()

    class Patient:
        @property
        def is_full(self) -> bool:
            return len(case.done) - sum(held) >= 3

        async def room(self) -> None:
            held.append(len(case.done) - sum(held))

    case = Case(InstantClock(1_000), waits_for=[Patient()])
    for t_ns in range(10):
        case.at(t_ns, str(t_ns))
    await case.loop.work(1_000)
    assert case.names == [str(n) for n in range(10)]
    assert held == [3, 3, 3]


@pytest.mark.asyncio
async def test_while_time_stands_just_before_a_deadline_all_that_can_wait_is_done() -> None:
    """What becomes due meanwhile waits, and wakes the clock once time goes on."""
    clock = WallClock(0)
    case = Case(clock)
    case.at(5 * MS, "five", later=["ledger"])
    clock.start()
    stands_ns = clock.now_ns() + 6 * MS
    clock.step(6 * MS)
    case.at(stands_ns + MS // 2, "next")
    case.at(stands_ns + 3_600_000 * MS, "in an hour")
    working = asyncio.create_task(case.loop.work(None))
    await until(lambda: "ledger" in case.names)
    await until(lambda: clock.is_paused)
    case.come_in("in")
    await until(lambda: "in" in case.names)
    case.loop.later(["later"])  # as when a broker acknowledges
    await until(lambda: "later" in case.names)
    assert "next" not in case.names
    clock.resume()
    await until(lambda: "next" in case.names)
    case.at(clock.now_ns(), "sooner")
    await until(lambda: "sooner" in case.names)
    working.cancel()
    await asyncio.gather(working, return_exceptions=True)
    clock.close()
    assert "in an hour" not in case.names


@pytest.mark.asyncio
async def test_the_first_that_ends_ends_the_others_and_what_any_died_of_is_raised() -> None:
    ended: list[str] = []

    async def lasts() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            ended.append("the other")

    async def fails() -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        await first_of(fails(), lasts())
    await first_of(asyncio.sleep(0), lasts())
    await first_of(lasts(), within_s=0.01)
    assert len(ended) == 3

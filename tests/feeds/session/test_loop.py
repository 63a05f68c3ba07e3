from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence

import pytest
from support.waiting import until

from plotfeed.feeds.session.loop import LATER_EVERY_SIMULATED_NS, MAX_LATER, SessionLoop
from plotfeed.feeds.timing.clock import ActionKind, Clock, InstantClock, Schedule, WallClock

MS = 1_000_000


class Case:
    """A loop that writes down what it does and takes in, and when."""

    def __init__(
        self, clock: Clock | None = None, before_due: Sequence[Callable[[int], object]] = ()
    ) -> None:
        self.clock = clock or InstantClock(0)
        self.done: list[tuple[str, int]] = []
        self.inputs: list[str] = []
        self.loop = SessionLoop(
            self.clock,
            Schedule(self.clock.wake),
            inputs=self,
            drain=lambda: None,
            before_due=before_due,
            write_later=lambda names: self.done.extend((n, self.clock.now_ns()) for n in names),
        )

    def at(self, t_ns: int, name: str, kind: ActionKind = ActionKind.WORK) -> None:
        self.loop.schedule.put(t_ns, self.note(name), kind)

    def note(self, name: str) -> Callable[[], None]:
        return lambda: self.done.append((name, self.clock.now_ns()))

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

    def both(name: str) -> Callable[[], None]:
        def act() -> None:
            case.loop.later([f"ledger of {name}"])
            case.note(name)()

        return act

    for t, name in ((5, "first"), (5, "second"), (6, "third"), (s + 1, "fourth")):
        case.loop.schedule.put(t, both(name))
    await case.loop.work(3 * s)
    ledgers = [(f"ledger of {name}", s) for name in ("first", "second", "third")]
    assert case.done == [
        *[("first", 5), ("second", 5), ("third", 6)],
        *ledgers,
        *[("fourth", s + 1), ("ledger of fourth", 2 * s)],
    ]


@pytest.mark.asyncio
async def test_recorded_telemetry_is_taken_before_whatever_came_after_it() -> None:
    times = [3, 5, 6, 8]

    def again(due_ns: int) -> None:
        while times and times[0] < due_ns:
            case.done.append(("again", times.pop(0)))

    case = Case(before_due=[again])
    for t in (5, 6, 7):
        case.loop.schedule.put(t, lambda t=t: case.done.append(("due", t)))  # type: ignore[misc]
    await case.loop.work(10)
    assert case.done == [
        ("again", 3),
        ("due", 5),
        ("again", 5),
        ("due", 6),
        ("again", 6),
        ("due", 7),
    ]


@pytest.mark.asyncio
async def test_what_comes_in_waits_for_whoever_plans_to_take_it_in() -> None:
    case, told = Case(), list[int]()
    case.loop.on_input = lambda: told.append(case.clock.now_ns())

    def flood() -> None:
        for i in range(200):
            case.come_in(str(i))

    case.loop.schedule.put(5, flood)
    case.at(6, "six")
    await case.loop.work(10)
    assert told == [5]
    assert case.done == [("six", 6)]
    assert len(case.inputs) == 200


@pytest.mark.asyncio
async def test_what_can_wait_does_not_pile_up_however_late_the_session_is() -> None:
    class Late(InstantClock):
        """By which everything is long past."""

        leaps = False

        def now_ns(self) -> int:
            return 10**15

    case, number = Case(Late(0)), 3 * MAX_LATER
    waiting: list[int] = []

    def work() -> None:
        case.loop.later(["ledger"])
        waiting.append(len(waiting) + 1 - len(case.done))

    for t in range(number):
        case.loop.schedule.put(t, work)
    await case.loop.work(number)
    assert max(waiting) == MAX_LATER
    case.loop.do_all_later()
    assert len(case.done) == number


@pytest.mark.asyncio
async def test_at_the_end_only_what_was_handed_over_is_still_done() -> None:
    for least, expected in (
        (ActionKind.DELIVERY, ["delivery"]),
        (ActionKind.SENDING, ["sending", "delivery"]),
    ):
        case = Case()
        case.at(11, "work")
        case.at(12, "sending", ActionKind.SENDING)
        case.at(13, "delivery", ActionKind.DELIVERY)
        await case.loop.work(10)
        assert case.done == []
        await case.loop.finish(least)
        assert [name for name, _ in case.done] == expected


@pytest.mark.asyncio
async def test_a_full_way_out_holds_everything_until_it_has_room() -> None:
    class Patient:
        def __init__(self) -> None:
            self.is_full = True
            self.asked = 0

        async def room(self) -> None:
            self.asked += 1
            self.is_full = False

    case, patient = Case(), Patient()
    case.loop.wait_for([patient])
    case.at(5, "five")
    await case.loop.work(10)
    assert (case.done, patient.asked, case.loop.waited) == ([("five", 5)], 1, 1)


@pytest.mark.asyncio
async def test_a_way_out_that_fills_up_holds_what_is_overdue_as_well() -> None:
    """A stall leaves many things due at once: no more of them is done than it takes."""
    case = Case(InstantClock(1_000))
    held: list[int] = []

    class Patient:
        @property
        def is_full(self) -> bool:
            return len(case.done) - sum(held) >= 3

        async def room(self) -> None:
            held.append(len(case.done) - sum(held))

    case.loop.wait_for([Patient()])
    for t_ns in range(10):
        case.at(t_ns, str(t_ns))
    await case.loop.work(1_000)
    assert [name for name, _ in case.done] == [str(n) for n in range(10)]
    assert held == [3, 3, 3]


@pytest.mark.asyncio
async def test_while_time_stands_just_before_a_deadline_all_that_can_wait_is_done() -> None:
    clock = WallClock(0)
    case = Case(clock)

    def five() -> None:
        case.loop.later(["ledger"])
        case.note("five")()

    case.loop.schedule.put(5 * MS, five)
    clock.start()
    stands_ns = clock.now_ns() + 6 * MS
    clock.step(6 * MS)
    case.at(stands_ns + MS // 2, "next")
    working = asyncio.create_task(case.loop.work(None))
    await until(lambda: "ledger" in names(case))
    await until(lambda: clock.is_paused)
    case.come_in("in")
    case.loop.later(["later"])  # as when a broker acknowledges
    await until(lambda: {"in", "later"} <= names(case))
    assert "next" not in names(case)
    clock.resume()
    await working
    assert "next" in names(case)
    clock.close()


def names(case: Case) -> set[str]:
    return {name for name, _ in case.done}

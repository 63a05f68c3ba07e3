"""Replays that are paused, sought, hastened and stopped while they run."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from fractions import Fraction
from itertools import count

import pytest
from support.replays import MS, RECORDED, REGULAR, REPLAYED, Ears, Memory, message, simulated, since
from support.waiting import PATIENCE_S

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.replaying.replay_settings import ReplaySettings
from plotfeed.feeds.replaying.replayer import SEEK_NS, ReplayControl, Replayer
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.replay.recorded import Recorded


async def steered(
    steps: dict[int, Callable[[ReplayControl], object]],
    recorded: list[Recorded] = REGULAR,
    settings: ReplaySettings | None = None,
) -> tuple[Ears, ReplayControl]:
    """A replay in which something is asked for right after so many messages."""
    control, numbers = ReplayControl(), count(1)

    def left(_: Message) -> None:
        step = steps.get(next(numbers))
        if step is not None:
            step(control)

    return (await simulated(recorded, settings, control=control, on_message=left))[0], control


@pytest.mark.asyncio
async def test_nothing_leaves_in_a_pause_and_all_of_it_afterwards() -> None:
    def pause(control: ReplayControl) -> None:
        control.pause()
        assert control.is_paused
        assert control.position == (0, RECORDED + 300 * MS)
        asyncio.get_running_loop().call_later(0.01, resume, control)

    def resume(control: ReplayControl) -> None:
        assert control.position == (0, RECORDED + 300 * MS)
        control.resume()

    ears, _ = await steered({4: pause})
    assert ears.times() == [i * 100 * MS for i in range(10)]  # that clock stands still meanwhile


@pytest.mark.asyncio
async def test_what_was_made_ready_is_taken_back_by_a_pause() -> None:
    crowded = [message(i * MS) for i in range(40)]

    def pause(control: ReplayControl) -> None:
        control.pause()
        asyncio.get_running_loop().call_soon(control.resume)

    ears, _ = await steered({4: pause, 20: pause}, crowded)
    assert ears.times() == [i * MS for i in range(40)]
    assert ears.payloads() == [r.payload for r in crowded]
    slower, _ = await steered({4: lambda c: c.set_speed(Fraction(1, 8))}, crowded)
    assert slower.payloads() == ears.payloads()
    wanted = [min(i, 3) * MS + max(i - 3, 0) * 8 * MS for i in range(40)]
    assert all(0 <= b - a <= 8 for a, b in zip(wanted, slower.times(), strict=True))


@pytest.mark.asyncio
async def test_another_speed_counts_from_then_on() -> None:
    ears, control = await steered({3: lambda c: c.set_speed(Fraction(2)),
                             6: lambda c: c.set_speed(Fraction(1, 2))})  # fmt: skip
    wanted = since(0, 100, 200, 250, 300, 350, 550, 750, 950, 1150)
    # A change of speed falls on a whole nanosecond of either time.
    assert all(abs(a - b) <= 2 for a, b in zip(ears.times(), wanted, strict=True))
    assert control.speed == 1  # after the end there is none


@pytest.mark.asyncio
async def test_a_seek_goes_on_elsewhere() -> None:
    ears, _ = await steered({3: lambda c: c.seek(RECORDED + 700 * MS)})
    assert ears.payloads() == [r.payload for r in [*REGULAR[:3], *REGULAR[7:]]]
    jump_ms = 200 + SEEK_NS // MS
    assert ears.times() == since(0, 100, 200, jump_ms, jump_ms + 100, jump_ms + 200)


@pytest.mark.asyncio
async def test_a_seek_goes_back_too_and_not_before_the_beginning() -> None:
    ears, _ = await steered({5: lambda c: c.skip(-0.2), 9: lambda c: c.seek(0)})
    order = [0, 1, 2, 3, 4, 2, 3, 4, 5, *range(10)]
    assert ears.payloads() == [REGULAR[i].payload for i in order]


@pytest.mark.asyncio
async def test_a_seek_stays_in_its_lap() -> None:
    laps: list[tuple[int, int]] = []

    def seek(control: ReplayControl) -> None:
        laps.append(control.position)
        control.seek(RECORDED + 800 * MS)

    ears, _ = await steered({13: seek}, settings=ReplaySettings(laps=3))
    assert laps == [(1, RECORDED + 200 * MS)]
    assert ears.payloads() == [REGULAR[i].payload for i in [*range(10), 0, 1, 2, 8, 9, *range(10)]]


@pytest.mark.asyncio
async def test_a_seek_beyond_the_end_ends_it() -> None:
    ears, control = await steered({3: lambda c: c.skip(3600)})
    assert len(ears.heard) == 3
    assert control.pace is None


@pytest.mark.asyncio
async def test_a_pause_before_a_seek_lasts() -> None:
    def pause(control: ReplayControl) -> None:
        control.pause()
        control.seek(RECORDED + 500 * MS)
        asyncio.get_running_loop().call_later(0.01, control.toggle)

    ears, _ = await steered({2: pause})
    assert ears.payloads() == [r.payload for r in [*REGULAR[:2], *REGULAR[5:]]]


@pytest.mark.parametrize("silence_ms", [0, 20, 5000])
@pytest.mark.asyncio
async def test_one_stands_at_its_end_until_it_is_sought_or_stopped(silence_ms: int) -> None:
    end_ns = RECORDED + (900 + silence_ms) * MS
    stood: list[tuple[int, int]] = []

    class Standing(ReplayControl):
        def stand(self, end_ns: int) -> int | None:
            stood_before, due_ns = self.is_paused, super().stand(end_ns)
            if self.is_paused and not stood_before:
                stood.append(self.position)
                asyncio.get_running_loop().call_soon(self.stop if len(stood) == 4 else self.go_on)
            return due_ns

        def go_on(self) -> None:
            self.resume()
            self.seek(RECORDED + (7000 if len(stood) == 2 else 700) * MS)

    control = Standing()
    settings = ReplaySettings(stands_at_ns=end_ns)
    ears, totals = await simulated(REGULAR, settings, control=control)
    assert ears.payloads() == [r.payload for r in [*REGULAR, *REGULAR[7:], *REGULAR[7:]]]
    assert stood == [(0, end_ns)] * 4
    assert totals.laps == 1


@pytest.mark.asyncio
async def test_it_stops_when_it_is_asked_to() -> None:
    ears, _ = await steered({4: lambda c: c.stop()}, settings=ReplaySettings(laps=None))
    assert len(ears.heard) == 4


@pytest.mark.asyncio
async def test_a_replay_without_deadlines_can_be_stopped_and_paused() -> None:
    async with asyncio.timeout(PATIENCE_S):
        clock, control, held = InstantClock(REPLAYED), ReplayControl(), list[int]()
        ears = Ears(clock)

        def resume() -> None:
            held.append(len(ears.heard))
            control.resume()

        def left(_: Message) -> None:
            if len(ears.heard) == 5:
                control.pause()
                asyncio.get_running_loop().call_later(0.01, resume)
            if len(ears.heard) == 25:
                control.stop()

        ears.on_message = left
        settings = ReplaySettings(fastest=True, laps=None)
        await Replayer(Memory(REGULAR), [ears], settings, clock=clock, control=control).run()
    assert held == [10]  # as many as a lap has leave in one go
    assert ears.payloads() == [r.payload for r in REGULAR] * 3

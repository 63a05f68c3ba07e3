"""When messages leave: under a clock that jumps, so that every nanosecond can be told."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from itertools import count, pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.replays import (
    MS,
    RECORDED,
    REGULAR,
    REPLAYED,
    Ears,
    Memory,
    S,
    message,
    simulated,
    since,
)
from support.waiting import PATIENCE_S

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.replaying.replay_settings import LinkRule, Moment, ReplaySettings
from plotfeed.feeds.replaying.replayer import AHEAD, BATCH, READY_NS, SEEK_NS, Replayer
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.timing.clock import InstantClock, WallClock
from plotfeed.replay.recorded import Recorded, Stage

GAPS = st.lists(st.integers(0, 2 * S), min_size=1, max_size=30)


@settings(max_examples=30, deadline=None)
@given(GAPS)
@pytest.mark.asyncio
async def test_messages_leave_spaced_as_they_were_to_the_nanosecond(gaps_ns: list[int]) -> None:
    times = [sum(gaps_ns[:i]) for i in range(len(gaps_ns))]
    recorded = [message(t, payload=bytes([i])) for i, t in enumerate(times)]
    ears, totals = await simulated(recorded)
    assert ears.times() == times
    assert ears.payloads() == [r.payload for r in recorded]
    assert (totals.messages, totals.worst_ns) == (len(times), 0)


@settings(max_examples=20, deadline=None)
@given(GAPS, st.sampled_from([Fraction(1, 10), Fraction(2), Fraction(7, 3), Fraction(1000)]))
@pytest.mark.asyncio
async def test_at_another_speed_nothing_drifts(gaps_ns: list[int], speed: Fraction) -> None:
    times = [sum(gaps_ns[:i]) for i in range(len(gaps_ns))]
    ears, _ = await simulated([message(t) for t in times], ReplaySettings(speed=speed))
    for found, t in zip(ears.times(), times, strict=True):
        assert 0 <= t / speed - found < 1


@pytest.mark.asyncio
async def test_what_was_recorded_out_of_order_leaves_in_order_and_laps_follow_without_a_seam() -> (
    None
):
    ears, _ = await simulated([message(0), message(10 * MS), message(5 * MS), message(12 * MS)])
    assert ears.times() == since(0, 5, 10, 12)
    ears, totals = await simulated(REGULAR, ReplaySettings(laps=3))
    assert ears.times() == [i * 100 * MS for i in range(30)]
    assert ears.payloads() == [r.payload for r in REGULAR] * 3
    assert totals.laps == 3
    # Before a link the time counts at which a message was due.
    recorded = [
        message(20_000, stage=Stage.BEFORE, publish_since_ns=0),
        message(50 * MS + 90_000, stage=Stage.BEFORE, publish_since_ns=50 * MS),
        message(60 * MS),
    ]
    ears, _ = await simulated(recorded, ReplaySettings(stage="before"))
    assert ears.times() == since(0, 50)


@pytest.mark.parametrize(
    ("start", "end", "laps", "left_ms"),
    [
        ("0.25", None, 1, [50, 150, 250, 350, 450, 550, 650]),
        (None, "0.3", 1, [0, 100, 200]),
        ("0.3", "0.5", 1, [0, 100]),
        ("2026-01-01T12:00:00.85Z", None, 1, [50]),
        ("2020-01-01T00:00:00Z", "2026-01-01T13:00:00.2+01:00", 1, [0, 100]),
        ("5", None, 1, []),
        ("0.5", "0.2", 1, []),
        ("0.25", "0.45", 3, [50, 150, 250, 350, 450, 550]),
        (None, "3600", 2, range(0, 2000, 100)),
    ],
)
@pytest.mark.asyncio
async def test_a_part_begins_and_ends_at_its_times_and_is_repeated_as_long_as_it_is(
    start: str | None, end: str | None, laps: int, left_ms: Sequence[int]
) -> None:
    first, last = (None if text is None else Moment.parse(text) for text in (start, end))
    part = ReplaySettings(start=first, end=last, laps=laps)
    ears, _ = await simulated(REGULAR, part)
    begun_ns = REPLAYED + READY_NS
    assert [t - begun_ns for t, _ in ears.heard] == since(*left_ms)


@pytest.mark.parametrize("laps", [1, 5, None])
@pytest.mark.asyncio
async def test_a_recording_without_messages_is_over_at_once(laps: int | None) -> None:
    for fastest in (False, True):
        ears, totals = await simulated([], ReplaySettings(laps=laps, fastest=fastest))
        assert ears.heard == []
        assert totals.laps == 0
    truth = [message(0, "plotfeed/truth")]
    assert (await simulated(truth, ReplaySettings(laps=laps)))[0].heard == []


class Endless:
    """A recording that has no end, and counts what has been read of it."""

    def __init__(self) -> None:
        self.read = 0

    def messages(self, _start_ns: int | None, _end_ns: int | None) -> Iterator[Recorded]:
        for i in count():
            self.read += 1
            yield message(i * MS)


@pytest.mark.asyncio
async def test_no_more_is_read_ahead_than_there_is_room_for() -> None:
    async with asyncio.timeout(PATIENCE_S):
        source, ears = Endless(), Ears(InstantClock(REPLAYED))
        replayer = Replayer(clock=ears.clock)
        ears.on_message = lambda _: replayer.stop() if len(ears.heard) == 10 else None
        await replayer.run(source, [ears])
    assert source.read <= AHEAD + 2 * BATCH


class SlowlyRead(Memory):
    """A recording whose second batch comes long after the first."""

    def messages(self, start_ns: int | None, end_ns: int | None) -> Iterator[Recorded]:
        for number, each in enumerate(super().messages(start_ns, end_ns)):
            if number == BATCH:
                time.sleep(0.05)
            yield each


@pytest.mark.asyncio
async def test_simulated_time_waits_for_what_is_still_being_read() -> None:
    """Else what a link holds would leave first, and what is yet to be read too late."""
    recorded = [message(i * MS, f"p/{'ab'[i % 2]}/plots") for i in range(2 * BATCH)]
    slow = LinkRule("p/a", LinkSettings(latency_ms=1000.0))
    ears = Ears(InstantClock(REPLAYED))
    settings = ReplaySettings(links=(slow,))
    await Replayer(settings, clock=ears.clock).run(SlowlyRead(recorded), [ears])
    assert len(ears.heard) == 2 * BATCH
    for t_ns, one in ears.heard:
        assert t_ns - one.due_utc_ns == (1000 * MS if one.topic == "p/a/plots" else 0)


@pytest.mark.asyncio
async def test_what_reading_raises_ends_the_replay() -> None:
    class Torn:
        def messages(self, _start_ns: int | None, _end_ns: int | None) -> Iterator[Recorded]:
            yield message(0)
            raise OSError(5, "Input/output error")

    for fastest in (False, True):
        with pytest.raises(OSError, match="Input/output"):
            await Replayer(ReplaySettings(fastest=fastest)).run(Torn(), [])


@pytest.mark.asyncio
async def test_real_time_keeps_the_order_and_is_never_early() -> None:
    recorded = [message(i * 2 * MS + i % 3) for i in range(50)]

    clock = WallClock()
    ears = Ears(clock)
    totals = await Replayer(clock=clock).run(Memory(recorded), [ears])
    clock.close()
    assert totals.messages == 50
    assert ears.payloads() == [r.payload for r in recorded]
    assert all(t >= m.due_utc_ns for t, m in ears.heard)
    dues = [m.due_utc_ns for _, m in ears.heard]
    assert [b - a for a, b in pairwise(dues)] == [
        b.log_time_ns - a.log_time_ns for a, b in pairwise(recorded)
    ]


async def steered(
    steps: dict[int, Callable[[Replayer], object]],
    recorded: list[Recorded] = REGULAR,
    settings: ReplaySettings | None = None,
) -> tuple[Ears, Replayer]:
    """A replay in which something is asked for right after so many messages."""
    replayer, numbers = Replayer(settings, clock=InstantClock(REPLAYED)), count(1)

    def left(_: Message) -> None:
        step = steps.get(next(numbers))
        if step is not None:
            step(replayer)

    return (await simulated(recorded, replayer=replayer, on_message=left))[0], replayer


@pytest.mark.asyncio
async def test_nothing_leaves_in_a_pause_and_all_of_it_afterwards() -> None:
    def pause(control: Replayer) -> None:
        control.pause()
        assert control.is_paused
        assert control.position == (0, RECORDED + 300 * MS)
        asyncio.get_running_loop().call_later(0.01, resume, control)

    def resume(control: Replayer) -> None:
        assert control.position == (0, RECORDED + 300 * MS)
        control.resume()

    ears, _ = await steered({4: pause})
    assert ears.times() == [i * 100 * MS for i in range(10)]  # that clock stands still meanwhile


@pytest.mark.asyncio
async def test_what_was_made_ready_is_taken_back_by_a_pause() -> None:
    crowded = [message(i * MS) for i in range(40)]

    def pause(control: Replayer) -> None:
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


JUMP_MS = 200 + SEEK_NS // MS


@pytest.mark.parametrize(
    ("steps", "order", "left_ms"),
    [
        (
            {3: lambda c: c.seek(RECORDED + 700 * MS)},
            [0, 1, 2, 7, 8, 9],
            [0, 100, 200, JUMP_MS, JUMP_MS + 100, JUMP_MS + 200],
        ),
        # Back too, and not before the beginning.
        (
            {5: lambda c: c.skip(-0.2), 9: lambda c: c.seek(0)},
            [0, 1, 2, 3, 4, 2, 3, 4, 5, *range(10)],
            None,
        ),
        ({3: lambda c: c.skip(3600)}, [0, 1, 2], [0, 100, 200]),
        ({4: lambda c: c.stop()}, [0, 1, 2, 3], [0, 100, 200, 300]),
    ],
)
@pytest.mark.asyncio
async def test_a_seek_goes_on_elsewhere_and_it_ends_beyond_the_end_or_when_it_is_stopped(
    steps: dict[int, Callable[[Replayer], object]], order: list[int], left_ms: list[int] | None
) -> None:
    ears, control = await steered(steps)
    assert ears.payloads() == [REGULAR[i].payload for i in order]
    assert left_ms is None or ears.times() == since(*left_ms)
    assert control.pace is None


@pytest.mark.asyncio
async def test_a_seek_stays_in_its_lap() -> None:
    laps: list[tuple[int, int]] = []

    def seek(control: Replayer) -> None:
        laps.append(control.position)
        control.seek(RECORDED + 800 * MS)

    ears, _ = await steered({13: seek}, settings=ReplaySettings(laps=3))
    assert laps == [(1, RECORDED + 200 * MS)]
    assert ears.payloads() == [REGULAR[i].payload for i in [*range(10), 0, 1, 2, 8, 9, *range(10)]]


@pytest.mark.asyncio
async def test_a_pause_before_a_seek_lasts() -> None:
    def pause(control: Replayer) -> None:
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

    class Standing(Replayer):
        def stand(self, end_ns: int) -> int | None:
            stood_before, due_ns = self.is_paused, super().stand(end_ns)
            if self.is_paused and not stood_before:
                stood.append(self.position)
                asyncio.get_running_loop().call_soon(self.stop if len(stood) == 4 else self.go_on)
            return due_ns

        def go_on(self) -> None:
            self.resume()
            self.seek(RECORDED + (7000 if len(stood) == 2 else 700) * MS)

    standing = Standing(ReplaySettings(stands_at_ns=end_ns), clock=InstantClock(REPLAYED))
    ears, totals = await simulated(REGULAR, replayer=standing)
    assert ears.payloads() == [r.payload for r in [*REGULAR, *REGULAR[7:], *REGULAR[7:]]]
    assert stood == [(0, end_ns)] * 4
    assert totals.laps == 1


@pytest.mark.asyncio
async def test_a_replay_without_deadlines_can_be_stopped_and_paused() -> None:
    async with asyncio.timeout(PATIENCE_S):
        clock, held = InstantClock(REPLAYED), list[int]()
        ears = Ears(clock)
        control = Replayer(ReplaySettings(fastest=True, laps=None), clock=clock)

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
        await control.run(Memory(REGULAR), [ears])
    assert held == [10]  # as many as a lap has leave in one go
    assert ears.payloads() == [r.payload for r in REGULAR] * 3
    dues = [m.due_utc_ns for _, m in ears.heard]
    assert [due - dues[0] for due in dues[:10]] == [i * 100 * MS for i in range(10)]

"""A recording replayed, lap after lap: every message at its time, through its link, and away.

What may be asked of it while it runs, and how the times inside messages are moved.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from fractions import Fraction
from functools import partial
from itertools import count
from typing import NamedTuple

from plotfeed.feeds.console.process import undisturbed
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.transports import Transport
from plotfeed.feeds.replaying.replay_settings import ReplaySettings
from plotfeed.feeds.replaying.routes import ReplayCounters, Routes
from plotfeed.feeds.timing.clock import Clock, InstantClock, Schedule, WallClock
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.proto.asterix.codec.retime_asterix import Retimer
from plotfeed.proto.content_types import ASTERIX, JSON, SAPIENT_MESSAGE
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.message_kinds import OUR_MESSAGES, kind_of
from plotfeed.proto.retime import retime_json, retime_protobuf, retime_text
from plotfeed.proto.utc import NS
from plotfeed.replay.files import RepeatableRecording
from plotfeed.replay.pacing import Laps, Pace, lap_period_ns
from plotfeed.replay.recorded import UDP_TOPIC, Recorded, Stage, next_messages

log = logging.getLogger(__name__)

TIME = "time"  # The user property that CloudEvents tells the time of a message by
MOST_SAID = 20

Mover = Callable[[bytes, int], bytes]  # A payload and a shift in nanoseconds; raises `DecodeError`


class Restamper:
    """Moves the times in messages."""

    def __init__(self, left: Counter[str]) -> None:
        """`left` counts the messages, or parts of them, that are left alone, by what they are."""
        self._left = left
        self._asterix = Retimer()
        self._movers: dict[str, Mover | None] = {}  # By the kind of message

    def payload(self, recorded: Recorded, shift_ns: int) -> bytes:
        """The message's payload, its times later by that."""
        kind = kind_of(recorded.topic, recorded.content_type, recorded.payload)
        if not kind and recorded.topic.startswith(UDP_TOPIC):
            kind = ASTERIX
        if kind not in self._movers:
            self._movers[kind] = self._mover(kind)
        if (mover := self._movers[kind]) is None:
            what = recorded.content_type or "octets that nothing is said of"
            self._leave(f"{what} on {recorded.topic}")
            return recorded.payload
        try:
            return mover(recorded.payload, shift_ns)
        except DecodeError as error:
            self._leave(f"messages on {recorded.topic}: {error}")
            return recorded.payload

    def properties(self, recorded: Recorded, shift_ns: int) -> tuple[tuple[str, str], ...]:
        """The message's user properties, their times later by that."""
        return tuple(
            (name, self._text(value, shift_ns) if name == TIME else value)
            for name, value in recorded.properties
        )

    def _text(self, text: str, shift_ns: int) -> str:
        try:
            return retime_text(text, shift_ns)
        except ValueError:
            self._leave("a property time that is none")
            return text

    def _leave(self, what: str) -> None:
        is_new, is_full = what not in self._left, len(self._left) >= MOST_SAID
        if is_new and not is_full:
            log.warning("left alone: %s", what)
        self._left["others" if is_new and is_full else what] += 1

    def _mover(self, kind: str) -> Mover | None:
        """What moves such messages; None where nothing does."""
        if kind == ASTERIX:
            return self._move_asterix
        if kind == JSON:
            return retime_json
        if kind == SAPIENT_MESSAGE:
            try:
                from plotfeed.proto.sapient.decode_sapient import retime_sapient
            except ImportError:  # the extra is not installed
                return None
            return retime_sapient
        ours = OUR_MESSAGES.get(kind)
        if ours is None:
            return None
        return lambda data, shift_ns: retime_protobuf(data, ours, shift_ns)

    def _move_asterix(self, data: bytes, shift_ns: int) -> bytes:
        done = self._asterix.retime(data, shift_ns)
        for what in done.left:
            self._leave(what)
        return done.octets


BATCH = 256  # Messages looked at in one go
BEFORE = Stage.BEFORE


class ReplayItem(NamedTuple):
    """A message, and when it was recorded."""

    unrolled_ns: int  # In the line of all laps
    lap: int  # From 0
    recorded_ns: int  # When it left or was received; before a link, when it was due
    recorded: Recorded


class ReplayReader:
    """What is to be replayed of a recording, lap after lap; it may be read in a thread."""

    def __init__(self, source: RepeatableRecording, settings: ReplaySettings) -> None:
        # Recorded time at which each lap begins; None until something has been read.
        self.begin_ns: int | None = None
        self.laps: Laps | None = None  # Known once a lap has been read to its end
        self._source = source
        self._settings = settings
        self._bounds: tuple[int | None, int | None] | None = None
        self._is_taken: dict[tuple[str, str, str], bool] = {}

    def batches(self, lap: int = 0, from_ns: int | None = None) -> Iterator[list[ReplayItem]]:
        """Messages from that lap on, and in it from that recorded time on; a batch may be empty."""
        self._bounds = self._bounds or self._found_bounds()
        first_of_laps_ns, end_ns = self._bounds
        most = self._settings.laps
        while most is None or lap < most:
            start_ns = first_of_laps_ns if from_ns is None else from_ns
            first_ns, last_ns, number = None, 0, 0
            messages = self._source.messages(start_ns, end_ns)
            while some := next_messages(messages, BATCH):
                items = self._items(some, lap, start_ns, end_ns)
                if items:
                    times = [item.recorded_ns for item in items]
                    if first_ns is None:
                        first_ns = min(times)
                    if self.begin_ns is None:
                        self.begin_ns = first_ns if start_ns is None else start_ns
                    last_ns, number = max(last_ns, *times), number + len(items)
                yield items
            if self.laps is None and first_ns is not None and self.begin_ns is not None:
                period_ns = lap_period_ns(self.begin_ns, first_ns, last_ns, number)
                stands_at_ns = self._settings.stands_at_ns
                if stands_at_ns is not None:
                    period_ns = max(period_ns, stands_at_ns + 1 - self.begin_ns)
                elif end_ns is not None:
                    period_ns = min(period_ns, end_ns - self.begin_ns)
                self.laps = Laps(begin_ns=self.begin_ns, period_ns=period_ns)
            if self.laps is None or (from_ns is None and first_ns is None):
                return
            lap, from_ns = lap + 1, None

    def _items(
        self, messages: Sequence[Recorded], lap: int, start_ns: int | None, end_ns: int | None
    ) -> list[ReplayItem]:
        """The messages that are asked for and of that time."""
        offset_ns = self.laps.unrolled(lap, 0) if self.laps else 0
        is_taken, takes = self._is_taken, self._settings.takes
        items: list[ReplayItem] = []
        for recorded in messages:
            stage = recorded.stage
            # Its text, since the hash of an enum takes longer.
            key = (recorded.topic, recorded.content_type, stage._value_)
            if (taken := is_taken.get(key)) is None:
                taken = is_taken[key] = takes(recorded.topic, recorded.content_type, stage)
            if taken:
                t_ns = recorded.publish_time_ns if stage is BEFORE else recorded.log_time_ns
                if (start_ns is None or t_ns >= start_ns) and (end_ns is None or t_ns < end_ns):
                    items.append(ReplayItem(t_ns + offset_ns, lap, t_ns, recorded))
        return items

    def _found_bounds(self) -> tuple[int | None, int | None]:
        start, end = self._settings.start, self._settings.end
        if start is None and end is None:
            return None, None
        first = next(self._source.messages(None, None), None)
        if first is None:
            return None, None
        first_ns = first.log_time_ns
        # What begins before the recording begins with it.
        start_ns = None if start is None else max(start.at(first_ns), first_ns)
        return start_ns, None if end is None else end.at(first_ns)


# Messages, and what they hold, that wait before no more are read.
AHEAD, AHEAD_OCTETS = 4096, 16 << 20


class ReadAhead:
    """What is read ahead of whoever sends: all of it is sent, and reading waits at a limit."""

    def __init__(self, reader: ReplayReader, on_news: Callable[[], object]) -> None:
        """`on_news` is called when there is something after there was nothing, or the end is."""
        self.finished = False  # Nothing more will come, unless it is told to go on elsewhere
        self._reader, self._batches = reader, reader.batches()
        self._on_news = on_news
        self._items: deque[ReplayItem] = deque()
        self._octets = 0
        self._full = False
        self._room = asyncio.Event()
        self._room.set()

    def peek(self) -> ReplayItem | None:
        """The next message, if one has been read."""
        return self._items[0] if self._items else None

    def pop(self) -> ReplayItem:
        """Take it."""
        item = self._items.popleft()
        self._octets -= len(item.recorded.payload)
        if self._full and len(self._items) <= AHEAD // 2 and self._octets <= AHEAD_OCTETS // 2:
            self._full = False
            self._room.set()
        return item

    def put_back(self, items: Sequence[ReplayItem]) -> None:
        """What was taken and not sent, in its order."""
        self._items.extendleft(reversed(items))
        self._octets += sum(len(item.recorded.payload) for item in items)

    def go_on(self, lap: int, from_ns: int) -> None:
        """Go on at that recorded time of that lap, and forget what was read before."""
        self._items.clear()
        self._octets = 0
        self._batches = self._reader.batches(lap, from_ns)
        self.finished = self._full = False
        self._room.set()

    async def run(self) -> None:
        """Read ahead until cancelled; raises what reading raises."""
        loop = asyncio.get_running_loop()
        with ThreadPoolExecutor(1, thread_name_prefix="read-ahead") as thread:
            while True:
                await self._room.wait()
                if self.finished:
                    self._room.clear()
                    continue
                batches = self._batches
                items = await loop.run_in_executor(thread, next, batches, None)
                if batches is self._batches:
                    self._take(items)

    def read_now(self) -> None:
        """Read some without a thread, where nothing waits for its time."""
        while not self._items and not self.finished:
            self._take(next(self._batches, None))

    def _take(self, items: list[ReplayItem] | None) -> None:
        """What was read next; None where nothing is left."""
        was_empty, self.finished = not self._items, items is None
        self._items.extend(items or ())
        self._octets += sum(len(item.recorded.payload) for item in items or ())
        if len(self._items) >= AHEAD or self._octets >= AHEAD_OCTETS:
            self._full = True
            self._room.clear()
        if was_empty and (items or self.finished):
            self._on_news()


SEEK_NS = NS // 10  # A replay goes on so long after a seek, for what is there has to be read first
# A message is made ready this long before it is due, so that only sending is left.
READY_NS = 20_000_000
SPARE_NS = 100_000  # Less than this before a deadline, nothing else is made ready
# Messages sent before others have their turn in the loop, where there are no deadlines.
AT_ONCE = 1024
# Transports may take so long for the last messages; longer where a slow broker is waited for.
FAREWELL_S, PATIENT_FAREWELL_S = 1.0, 10.0


class Replayer:
    """A replay, what may be asked of it from within its loop, and where it is.

    One schedule for what is due and for what links delay, and a queue of what comes next. Before it
    has begun and after it has ended nothing can be asked of it.
    """

    def __init__(
        self,
        settings: ReplaySettings | None = None,
        *,
        clock: Clock | None = None,
        totals: ReplayCounters | None = None,
    ) -> None:
        """`clock` is else one of real time, or simulated with `fastest`; `totals` are filled in."""
        self.pace: Pace | None = None  # None before it has begun and after it has ended
        self.begin_ns = 0  # Recorded time at which each lap begins
        self.stopped = False
        self._settings = settings = settings or ReplaySettings()
        self._own_clock = InstantClock() if settings.fastest else WallClock()
        self.clock = clock or self._own_clock
        self._totals = totals = totals or ReplayCounters()
        self._schedule = Schedule()
        self._restamper = Restamper(totals.left)
        self._news = asyncio.Event()
        # What is on the schedule, and can be taken back until it leaves.
        self._ready: dict[int, ReplayItem] = {}
        self._numbers = count()

    @property
    def is_paused(self) -> bool:
        """Whether it stands still."""
        return self.pace is not None and self.pace.paused

    @property
    def speed(self) -> Fraction:
        """Times its own tempo."""
        return Fraction(1) if self.pace is None else self.pace.speed

    @property
    def position(self) -> tuple[int, int]:
        """Lap, of which the first is 0, and recorded time that it has reached."""
        if self.pace is None:
            return 0, self.begin_ns
        reached_ns = max(self.pace.position(self.clock.now_ns()), self.begin_ns)
        laps = self._reader.laps  # Of a recording whose end has been read
        return laps.rolled(reached_ns) if laps else (0, reached_ns)

    def pause(self) -> None:
        """Stand still; what links hold arrives all the same."""
        if self.pace is not None and not self.pace.paused:
            self._repace(self.pace.pause(self.clock.now_ns()))

    def resume(self) -> None:
        """Go on."""
        if self.pace is not None and self.pace.paused:
            self._repace(self.pace.resume(self.clock.now_ns()))

    def toggle(self) -> None:
        """Pause or resume."""
        if self.is_paused:
            self.resume()
        else:
            self.pause()

    def set_speed(self, speed: Fraction) -> None:
        """Go on at that speed."""
        if self.pace is not None:
            self._repace(self.pace.at_speed(speed, self.clock.now_ns()))

    def seek(self, recorded_ns: int) -> None:
        """Go on with what was recorded then, in the lap that it is in."""
        if self.pace is None:
            return
        (lap, _), laps = self.position, self._reader.laps
        recorded_ns = max(recorded_ns, self.begin_ns)
        unrolled_ns = laps.unrolled(lap, recorded_ns) if laps else recorded_ns
        self.pace = self.pace.seek(unrolled_ns, self.clock.now_ns() + SEEK_NS)
        self._ready.clear()
        self._ahead.go_on(lap, recorded_ns)
        self._wake()

    def skip(self, seconds: float) -> None:
        """Go on so much later, or earlier, than it is."""
        self.seek(self.position[1] + round(seconds * NS))

    def stand(self, end_ns: int) -> int | None:
        """Stand still at that recorded time, the end; when that will be, None if it stands."""
        if self.pace is None or self.pace.paused:
            return None
        now_ns, due_ns = self.clock.now_ns(), self.pace.due(end_ns)
        if now_ns < due_ns:
            return due_ns
        self._repace(replace(self.pace, recorded_ns=end_ns, due_ns=now_ns, paused=True))
        return None

    def stop(self) -> None:
        """End it."""
        self.stopped = True
        self._wake()

    async def run(
        self, source: RepeatableRecording, transports: Sequence[Transport]
    ) -> ReplayCounters:
        """Replay the recording over open transports, until its end or until it is stopped.

        Raises what reading the source raises, and `ReplayError`.
        """
        self._transports = transports
        self._routes = Routes(
            transports,
            self._settings,
            clock=self.clock,
            schedule=self._schedule,
            totals=self._totals,
        )
        self._reader = ReplayReader(source, self._settings)
        self._ahead = ReadAhead(self._reader, self._wake)
        try:
            with undisturbed():
                if self._settings.fastest and isinstance(self.clock, InstantClock):
                    await self._play(self.clock)
                else:
                    await self._play_while_reading()
                self._routes.flush()
                patient = self._settings.fastest and not self.stopped
                for transport in self._transports:
                    await transport.drain(PATIENT_FAREWELL_S if patient else FAREWELL_S)
        finally:
            self._routes.end()
            self.pace = None
            self._own_clock.close()
        return self._totals

    async def _play_while_reading(self) -> None:
        """Play and read ahead in two tasks; what went wrong in either is raised as it is."""
        reading = asyncio.create_task(self._ahead.run(), name="read-ahead")
        playing = asyncio.create_task(self._play(None), name="replay")
        try:
            await asyncio.wait({reading, playing}, return_when=asyncio.FIRST_COMPLETED)
            for task in (playing, reading):
                if task.done():
                    task.result()
        finally:
            for task in (playing, reading):
                task.cancel()
            await asyncio.gather(playing, reading, return_exceptions=True)

    async def _play(self, rush: InstantClock | None) -> None:
        """Play until nothing is left, or it is stopped; with `rush`, without deadlines."""
        while not self.stopped:
            self._news.clear()
            if rush is not None:
                self._ahead.read_now()
            if self.pace is None:
                self._begin()
            next_ns = self._work() if rush is None else self._rush(rush)
            if next_ns is None and self._ahead.finished and self._ahead.peek() is None:
                if self._settings.stands_at_ns is None or rush is not None:
                    return
                next_ns = self.stand(self._settings.stands_at_ns)
            is_reading = self._ahead.peek() is None and not self._ahead.finished
            if next_ns is None or (is_reading and rush is None and self.clock.can_wait):
                await self._news.wait()  # what comes next may be due before what is ready
            else:
                if rush is not None:
                    await self._breathe()
                    continue
                # Exactly where something is to be sent; or until there is news.
                is_due = next_ns == self._schedule.next_due_ns()
                await self.clock.sleep_until(next_ns, exactly=is_due)

    def _begin(self) -> None:
        """Begin as soon as the first message has been read."""
        begin_ns = self._reader.begin_ns
        if self._ahead.peek() is None or begin_ns is None:
            return
        start_utc_ns = self.clock.start() + READY_NS
        self._routes.later_ns = start_utc_ns - begin_ns
        self.begin_ns = begin_ns
        self.pace = Pace(recorded_ns=begin_ns, due_ns=start_utc_ns, speed=self._settings.speed)

    def _work(self) -> int | None:
        """Do what is due, make ready what is due soon; when more will be, None if not known."""
        for _, action in self._schedule.due_by(self.clock.now_ns()):
            action()
        pace = self.pace
        if pace is None:
            return None
        while not pace.paused and (item := self._ahead.peek()) is not None:
            due_ns, soonest_ns = pace.due(item.unrolled_ns), self._schedule.next_due_ns()
            now_ns, ready_ns = self.clock.now_ns(), due_ns - READY_NS
            if ready_ns > now_ns:
                return ready_ns if soonest_ns is None else min(soonest_ns, ready_ns)
            if soonest_ns is not None and soonest_ns < min(due_ns, now_ns + SPARE_NS):
                return soonest_ns
            self._plan(self._ahead.pop(), due_ns)
        return self._schedule.next_due_ns()

    def _plan(self, item: ReplayItem, due_ns: int) -> None:
        send = self._departure(item, due_ns, is_ahead=True)
        if send is not None:
            number = next(self._numbers)
            self._ready[number] = item
            self._schedule.put(due_ns, partial(self._leave, number, send))

    def _leave(self, number: int, send: Callable[[], object]) -> None:
        """Let what is due leave, unless it was taken back."""
        if self._ready.pop(number, None) is not None:
            send()

    def _rush(self, clock: InstantClock) -> int | None:
        """Do some of what comes next at once; the time that it is, or None if nothing is left."""
        for _ in range(AT_ONCE):
            pace = self.pace
            item = None if pace is None or pace.paused else self._ahead.peek()
            soonest_ns = self._schedule.next_due_ns()
            if pace is not None and item is not None:
                due_ns = pace.due(item.unrolled_ns)
                if soonest_ns is None or due_ns <= soonest_ns:
                    clock.jump(due_ns)
                    if (send := self._departure(self._ahead.pop(), due_ns)) is not None:
                        send()
                    continue
            if soonest_ns is None:
                waits = self.is_paused or self._ahead.finished
                return None if waits else clock.now_ns()
            clock.jump(soonest_ns)
            for _, action in self._schedule.due_by(soonest_ns):
                action()
        return clock.now_ns()

    async def _breathe(self) -> None:
        """Let others have their turn, and a broker that is slow take its time."""
        self._routes.flush()
        await asyncio.sleep(0)
        for broker in (t for t in self._transports if isinstance(t, MqttTransport)):
            while broker.is_full and not self.stopped:
                self._news.clear()
                waits = [asyncio.create_task(x) for x in (broker.room(), self._news.wait())]
                await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
                for wait in waits:
                    wait.cancel()
                await asyncio.gather(*waits, return_exceptions=True)

    def _departure(
        self, item: ReplayItem, due_ns: int, *, is_ahead: bool = False
    ) -> Callable[[], object] | None:
        """What sends the message, which is due then; None if it is not sent."""
        recorded, properties = item.recorded, item.recorded.properties
        self._totals.laps = item.lap + 1
        route, payload = self._routes.of(recorded), recorded.payload
        if route.obstacle:
            self._totals.skipped[route.obstacle] += 1
            return None
        shift_ns = self._settings.stamps.shift_ns(due_ns, item.recorded_ns)
        if shift_ns:
            payload = self._restamper.payload(recorded, shift_ns)
            properties = self._restamper.properties(recorded, shift_ns)
        if route.datagram is not None:
            return partial(self._routes.send_datagram, route.datagram, payload, due_ns)
        message = Message(
            topic=route.topic,
            payload=payload,
            content_type=recorded.content_type,
            due_utc_ns=due_ns,
            properties=properties,
            retain=recorded.retain,
            qos=min(recorded.qos, 1),
        )
        for transport in self._transports if is_ahead else ():
            transport.prepare((message,))
        return partial(self._routes.send, message, route.over)

    def _repace(self, pace: Pace) -> None:
        """Go on so: what has not left is taken back, as it is due at other times now."""
        self.pace = pace
        back = [n for n, item in self._ready.items() if item.unrolled_ns > pace.recorded_ns]
        self._ahead.put_back([self._ready.pop(number) for number in back])
        self._wake()

    def _wake(self) -> None:
        self._news.set()
        self.clock.wake()

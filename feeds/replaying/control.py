"""A replay in the hands of whoever watches it: pause, seek and speed while it runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction

from plotfeed.feeds.timing.clock import Clock
from plotfeed.proto.utc import NS
from plotfeed.replay.pacing import Laps, Pace

SEEK_NS = NS // 10  # A replay goes on so long after a seek, for what is there has to be read first


class ReplayControl:
    """What may be asked of a replay, from within its loop, and where it is.

    Before the replay has begun and after it has ended nothing can be asked.
    """

    def __init__(self) -> None:
        self.pace: Pace | None = None  # None before it has begun and after it has ended
        self.begin_ns = 0  # Recorded time at which each lap begins
        self.stopped = False
        self._clock: Clock | None = None
        self._laps: Callable[[], Laps | None] = lambda: None
        self._on_pace: Callable[[], object] = lambda: None
        self._on_seek: Callable[[int, int], object] = lambda _lap, _from_ns: None

    def begin(
        self,
        pace: Pace,
        clock: Clock,
        *,
        begin_ns: int,
        laps: Callable[[], Laps | None],
        on_pace: Callable[[], object],
        on_seek: Callable[[int, int], object],
    ) -> None:
        """The replay begins, and is told what is asked of it.

        `laps` gives those of a recording whose end has been read, else None.
        """
        self.pace, self._clock = pace, clock
        self.begin_ns, self._laps = begin_ns, laps
        self._on_pace, self._on_seek = on_pace, on_seek

    def end(self) -> None:
        """The replay has ended."""
        self.pace = None

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
        reached_ns = max(self.pace.position(self._now_ns()), self.begin_ns)
        laps = self._laps()
        return (0, reached_ns) if laps is None else laps.rolled(reached_ns)

    def pause(self) -> None:
        """Stand still; what links hold arrives all the same."""
        if self.pace is not None and not self.pace.paused:
            self._set(self.pace.pause(self._now_ns()))

    def resume(self) -> None:
        """Go on."""
        if self.pace is not None and self.pace.paused:
            self._set(self.pace.resume(self._now_ns()))

    def toggle(self) -> None:
        """Pause or resume."""
        if self.is_paused:
            self.resume()
        else:
            self.pause()

    def set_speed(self, speed: Fraction) -> None:
        """Go on at that speed."""
        if self.pace is not None:
            self._set(self.pace.at_speed(speed, self._now_ns()))

    def seek(self, recorded_ns: int) -> None:
        """Go on with what was recorded then, in the lap that it is in."""
        if self.pace is None:
            return
        (lap, _), laps = self.position, self._laps()
        recorded_ns = max(recorded_ns, self.begin_ns)
        unrolled_ns = recorded_ns if laps is None else laps.unrolled(lap, recorded_ns)
        self.pace = self.pace.seek(unrolled_ns, self._now_ns() + SEEK_NS)
        self._on_seek(lap, recorded_ns)

    def skip(self, seconds: float) -> None:
        """Go on so much later, or earlier, than it is."""
        self.seek(self.position[1] + round(seconds * NS))

    def stand(self, end_ns: int) -> int | None:
        """Stand still at that recorded time, the end; when that will be, None if it stands."""
        if self.pace is None or self.pace.paused:
            return None
        now_ns, due_ns = self._now_ns(), self.pace.due(end_ns)
        if now_ns < due_ns:
            return due_ns
        self._set(replace(self.pace, recorded_ns=end_ns, due_ns=now_ns, paused=True))
        return None

    def stop(self) -> None:
        """End it."""
        self.stopped = True
        self._on_pace()

    def _set(self, pace: Pace) -> None:
        self.pace = pace
        self._on_pace()

    def _now_ns(self) -> int:
        return 0 if self._clock is None else self._clock.now_ns()

"""When each message of a recording is due again: a straight line from recorded time to a clock.

Every due time is counted from one anchor in whole numbers, never from the message before, so that
nothing adds up. Pause, seek and change of speed put the anchor elsewhere and give another `Pace`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from fractions import Fraction

from plotfeed.proto.utc import NS

MIN_SPEED, MAX_SPEED = Fraction(1, 1000), Fraction(10_000)
# Speeds are fractions with a denominator up to this, so that 0.1 is one tenth.
FINEST_SPEED = 1_000_000
LONE_LAP_NS = NS  # From one lap to the next of a recording whose messages all have the same time


def speed_of(factor: float) -> Fraction:
    """A speed as a fraction; raises `ValueError` beyond 0.001 to 10000."""
    if not MIN_SPEED <= factor <= MAX_SPEED:  # and NaN
        raise ValueError(f"expected 0.001 to 10000, not {factor:g}")
    return Fraction(factor).limit_denominator(FINEST_SPEED)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """What was recorded at `recorded_ns` is due at `due_ns`, and the rest accordingly."""

    recorded_ns: int
    due_ns: int  # On the clock of the replay
    speed: Fraction = Fraction(1)
    paused: bool = False  # Nothing is due, and what was due until the anchor has left
    _ratio: tuple[int, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_ratio", self.speed.as_integer_ratio())

    def due(self, recorded_ns: int) -> int:
        """When something recorded then is due, were it not paused; rounded down."""
        numerator, denominator = self._ratio
        return self.due_ns + (recorded_ns - self.recorded_ns) * denominator // numerator

    def position(self, now_ns: int) -> int:
        """The latest recorded time p that is due by then: due(p) <= now < due(p + 1)."""
        if self.paused:
            return self.recorded_ns
        numerator, denominator = self._ratio
        since_ns = now_ns - self.due_ns + 1
        return self.recorded_ns - (-since_ns * numerator // denominator) - 1

    def pause(self, now_ns: int) -> Pace:
        """Stand still from then on."""
        return self._anchored(now_ns, paused=True)

    def resume(self, now_ns: int) -> Pace:
        """Go on from then on, with what follows the anchor."""
        return replace(self, due_ns=now_ns, paused=False) if self.paused else self

    def at_speed(self, speed: Fraction, now_ns: int) -> Pace:
        """Go on at another speed from then on."""
        return replace(self._anchored(now_ns), speed=speed)

    def seek(self, recorded_ns: int, now_ns: int) -> Pace:
        """Go on with what was recorded at that time and later, at once; or be paused before it."""
        before_ns = 1 if self.paused else 0
        return replace(self, recorded_ns=recorded_ns - before_ns, due_ns=now_ns)

    def _anchored(self, now_ns: int, *, paused: bool | None = None) -> Pace:
        paused = self.paused if paused is None else paused
        return replace(self, recorded_ns=self.position(now_ns), due_ns=now_ns, paused=paused)


@dataclass(frozen=True, slots=True, kw_only=True)
class Laps:
    """A recording replayed again and again, as one line of time."""

    begin_ns: int  # Recorded time at which every lap begins
    period_ns: int  # From one lap to the next

    def unrolled(self, lap: int, recorded_ns: int) -> int:
        """The place of a recorded time in the line of all laps, of which the first is 0."""
        return recorded_ns + lap * self.period_ns

    def rolled(self, unrolled_ns: int) -> tuple[int, int]:
        """Lap and recorded time; what lies before the beginning is in the first lap."""
        lap = max(0, (unrolled_ns - self.begin_ns) // self.period_ns)
        return lap, unrolled_ns - lap * self.period_ns


def lap_period_ns(begin_ns: int, first_ns: int, last_ns: int, messages: int) -> int:
    """Time from one lap to the next, where nobody says when the recording ends.

    `messages` were recorded from `first_ns` to `last_ns`: the lap ends one mean spacing after its
    last message, so that a regular feed stays regular over the seam.
    """
    spacing_ns = (last_ns - first_ns) // (messages - 1) if messages > 1 else 0
    return last_ns - begin_ns + (spacing_ns or LONE_LAP_NS)

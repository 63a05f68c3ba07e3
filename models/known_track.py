"""A path that is known to its end: a scripted one, or a recorded flight."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np

from plotfeed.models.live_samples import FOREVER_NS
from plotfeed.models.state import NS, Floats


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of time in which a drone's position is one cubic in the time since its start."""

    start_ns: int
    end_ns: int
    alive: bool
    coefficients: Floats  # (4, 3): metres, m/s, m/s2, m/s3


_NOWHERE = np.zeros((4, 3))


@dataclass(slots=True)
class KnownTrack:
    """Samples of a drone, in the order of time."""

    max_gap_ns: int
    """A longer gap between samples is not bridged: the drone was gone meanwhile."""
    tail_ns: int
    """How long the drone lives on past its last sample."""
    period_ns: int = 0
    """The path starts again after this; 0 for never."""
    t_utc_ns: list[int] = field(default_factory=list)
    position_ecef_m: list[Floats] = field(default_factory=list)
    velocity_ecef_m_s: list[Floats] = field(default_factory=list)
    starts: frozenset[int] = frozenset()
    """Indices of samples to which no path leads from the one before."""

    def append(self, t_utc_ns: int, position_ecef_m: Floats, velocity_ecef_m_s: Floats) -> None:
        """Add a sample, later than all others."""
        self.t_utc_ns.append(t_utc_ns)
        self.position_ecef_m.append(position_ecef_m)
        self.velocity_ecef_m_s.append(velocity_ecef_m_s)

    def span_ns(self, _drone: int) -> tuple[int, int]:
        """The times of the first and the last sample."""
        return self.t_utc_ns[0], self.t_utc_ns[-1]

    def segment_at(self, t_utc_ns: int) -> Segment:
        """The stretch that holds a time."""
        times = self.t_utc_ns
        shift_ns = 0
        if self.period_ns and t_utc_ns >= times[0]:
            shift_ns = (t_utc_ns - times[0]) // self.period_ns * self.period_ns
        k = bisect_right(times, t_utc_ns - shift_ns) - 1
        if k < 0:
            return Segment(-FOREVER_NS, times[0], False, _NOWHERE)
        start_ns, last = times[k], k == len(times) - 1
        goes_on = not last and k + 1 not in self.starts
        if goes_on and times[k + 1] - start_ns <= self.max_gap_ns:
            return Segment(start_ns + shift_ns, times[k + 1] + shift_ns, True, self._hermite(k))
        next_ns = FOREVER_NS if last else times[k + 1]
        gone_ns = min(start_ns + self.tail_ns, next_ns)
        if t_utc_ns >= gone_ns:
            return Segment(gone_ns, next_ns, False, _NOWHERE)
        straight = np.stack([self.position_ecef_m[k], self.velocity_ecef_m_s[k], *_NOWHERE[:2]])
        return Segment(start_ns, gone_ns, True, straight)

    def _hermite(self, k: int) -> Floats:
        """The cubic through samples k and k+1, in the time since k; (4, 3)."""
        duration_s = (self.t_utc_ns[k + 1] - self.t_utc_ns[k]) / NS
        p0, p1 = self.position_ecef_m[k : k + 2]
        v0, v1 = self.velocity_ecef_m_s[k : k + 2]
        mean_velocity = (p1 - p0) / duration_s
        c2 = (3 * mean_velocity - 2 * v0 - v1) / duration_s
        c3 = (v0 + v1 - 2 * mean_velocity) / duration_s**2
        return np.stack([p0, v0, c2, c3])

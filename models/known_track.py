"""Paths that are known to their end: scripted ones, recorded flights, and one after another."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.live_samples import FOREVER_NS
from plotfeed.models.state import NS, Floats


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of time in which a drone's position is one cubic in the time since its start."""

    start_ns: int
    end_ns: int
    alive: bool
    coefficients: Floats  # (4, 3): metres, m/s, m/s2, m/s3

    def position_m(self, t_utc_ns: ArrayLike) -> Floats:
        """Where the drone is at times within; (..., 3)."""
        tau_s = (np.asarray(t_utc_ns, np.int64) - self.start_ns)[..., None] / NS
        c0, c1, c2, c3 = self.coefficients
        position_m: Floats = ((c3 * tau_s + c2) * tau_s + c1) * tau_s + c0
        return position_m

    def between(self, start_ns: int, end_ns: int) -> Segment:
        """The part of it that lies between those times."""
        end_ns = min(end_ns, self.end_ns)
        if start_ns <= self.start_ns or not self.alive:
            return replace(self, start_ns=max(start_ns, self.start_ns), end_ns=end_ns)
        tau_s = (start_ns - self.start_ns) / NS
        _, c1, c2, c3 = self.coefficients
        moved = [self.position_m(start_ns), (3 * c3 * tau_s + 2 * c2) * tau_s + c1]
        return Segment(start_ns, end_ns, True, np.stack([*moved, 3 * c3 * tau_s + c2, c3]))


MAX_TRACKS = 256
"""One after another of a drone that are kept: who diverts it more often loses what was first."""
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

    @classmethod
    def straight(
        cls, t_utc_ns: Sequence[int], position_ecef_m: Floats, *, repeat: bool = False
    ) -> Self:
        """A path of constant velocity between knots (k, 3), gone after the last one."""
        track = cls(FOREVER_NS, 0)
        for (t0, p0), (t1, p1) in pairwise(zip(t_utc_ns, position_ecef_m, strict=True)):
            velocity = (p1 - p0) / ((t1 - t0) / NS)
            track.append(t0, p0, velocity)
            track.append(t1, p1, velocity)
        track.period_ns = t_utc_ns[-1] - t_utc_ns[0] if repeat else 0
        return track

    @classmethod
    def smooth(
        cls,
        t_utc_ns: Sequence[int],
        position_ecef_m: Floats,
        velocity_ecef_m_s: Floats,
        *,
        repeat: bool = False,
    ) -> Self:
        """A path by the cubics through knots with velocities (k, 3), gone after the last one."""
        track = cls(FOREVER_NS, 0)
        track.t_utc_ns = [*t_utc_ns]
        track.position_ecef_m, track.velocity_ecef_m_s = [*position_ecef_m], [*velocity_ecef_m_s]
        track.period_ns = t_utc_ns[-1] - t_utc_ns[0] if repeat else 0
        return track

    def later(self, by_ns: int) -> KnownTrack:
        """A path that is the same, so much later."""
        return replace(self, t_utc_ns=[t_utc_ns + by_ns for t_utc_ns in self.t_utc_ns])

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


class TrackChain:
    """Tracks of one drone, each followed from a time on in place of the one before."""

    def __init__(self, first: KnownTrack) -> None:
        """Follow that one, until there is another."""
        self._from_ns = [-FOREVER_NS]
        self._tracks = [first]

    def then(self, from_ns: int, track: KnownTrack) -> None:
        """Follow that one from then on; what was to follow from later on is followed no more."""
        while self._from_ns[-1] >= from_ns:
            del self._from_ns[-1], self._tracks[-1]
        if len(self._tracks) == MAX_TRACKS:
            del self._from_ns[1], self._tracks[0]
        self._from_ns.append(from_ns)
        self._tracks.append(track)

    def put_off(self, by_ns: int) -> None:
        """Have all of it so much later."""
        self._from_ns[1:] = [from_ns + by_ns for from_ns in self._from_ns[1:]]
        self._tracks = [track.later(by_ns) for track in self._tracks]

    def span_ns(self, drone: int) -> tuple[int, int]:
        """The times of the first sample and the last."""
        return self._tracks[0].span_ns(drone)[0], self._tracks[-1].span_ns(drone)[1]

    def segment_at(self, t_utc_ns: int) -> Segment:
        """The stretch that holds a time."""
        k = bisect_right(self._from_ns, t_utc_ns) - 1
        segment = self._tracks[k].segment_at(t_utc_ns)
        if len(self._tracks) == 1:
            return segment
        until_ns = self._from_ns[k + 1] if k + 1 < len(self._tracks) else FOREVER_NS
        return segment.between(self._from_ns[k], until_ns)

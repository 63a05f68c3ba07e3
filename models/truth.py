"""Samples of telemetry and scripted paths in, the state of every drone at any time out.

Between two samples a drone follows the cubic with their positions and velocities (Hermite); past
the last it keeps its velocity until it is stale, and then it is gone. Everything is in ECEF, so
that one flight can be seen from any number of sites.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plotfeed.models.frames import LocalFrame
from plotfeed.models.numerics import as_floats
from plotfeed.models.state import (
    NS,
    Emitter,
    Floats,
    Ints,
    PlaceState,
    Signature,
    Signatures,
    TruthState,
    with_room,
)

S = TypeVar("S", bound=PlaceState)

FOREVER_NS = (1 << 63) - 1

SIGMA_VELOCITY_M_S = 1.0
"""An unknown velocity is fitted over as many samples as it takes to know it this well."""
MAX_FIT_SAMPLES = 20
MAX_FIT_S = 6.0
"""Longer than this a drone does not fly straight."""
DEFAULT_SIGMA_M = 0.5
"""Taken for the position accuracy of telemetry that states none."""


@dataclass(slots=True)
class _Track:
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

    def append(self, t_utc_ns: int, position_ecef_m: Floats, velocity_ecef_m_s: Floats) -> None:
        self.t_utc_ns.append(t_utc_ns)
        self.position_ecef_m.append(position_ecef_m)
        self.velocity_ecef_m_s.append(velocity_ecef_m_s)

    def forget_before(self, t_utc_ns: int) -> None:
        """Drop samples that no state at or after that time needs."""
        first = bisect_right(self.t_utc_ns, t_utc_ns) - 1
        if first > 64:  # in blocks, so that the lists are not shifted at every sample
            del self.t_utc_ns[:first]
            del self.position_ecef_m[:first]
            del self.velocity_ecef_m_s[:first]


@dataclass(frozen=True, slots=True)
class _Segment:
    """A stretch of time in which a drone's position is one cubic in the time since its start."""

    start_ns: int
    end_ns: int
    alive: bool
    coefficients: Floats  # (4, 3): metres, m/s, m/s2, m/s3


_NOWHERE = np.zeros((4, 3))


class Trajectories:
    """Every drone's samples. Drones are numbered in the order in which they first appeared."""

    def __init__(self, *, stale_after_s: float, history_s: float = 60.0) -> None:
        self.stale_after_ns = round(stale_after_s * NS)
        self.history_ns = round(history_s * NS)
        self.names: list[str] = []
        self.version = 0
        """Changes with every sample: states computed under another version may be out of date."""
        self._index: dict[str, int] = {}
        self._tracks: list[_Track] = []
        self._start_ns: Ints = np.zeros(0, np.int64)
        self._end_ns: Ints = np.zeros(0, np.int64)
        self._alive: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._coefficients: Floats = np.zeros((4, 3, 0))
        self._rcs_m2: Floats = np.zeros(0)
        self._sound_power_db: Floats = np.zeros(0)
        self._emitters: list[tuple[Emitter, ...]] = []

    def add_sample(
        self,
        drone: str,
        t_utc_ns: int,
        *,
        latitude_deg: float,
        longitude_deg: float,
        height_m: float,
        velocity_enu_m_s: Sequence[float] | None,
        sigma_m: float | None,
        signature: Signature,
        keep_history: bool = False,
    ) -> None:
        """Add a sample later than the drone's last; height above the ellipsoid.

        Velocity components that are NaN or absent are fitted to the latest positions; `sigma_m`,
        the positions' standard deviation, says over how many. Samples that no sensor can ask for
        any more are forgotten unless `keep_history`.
        """
        row = self._row(drone, _Track(self.stale_after_ns, self.stale_after_ns))
        track = self._tracks[row]
        frame = LocalFrame(latitude_deg, longitude_deg, height_m)
        position = frame.to_ecef(np.zeros(3))
        velocity = np.full(3, np.nan)
        if velocity_enu_m_s is not None:
            velocity = as_floats(velocity_enu_m_s)
        if np.isnan(velocity).any():
            fitted = fit_velocity(
                [*track.t_utc_ns[-MAX_FIT_SAMPLES + 1 :], t_utc_ns],
                [*track.position_ecef_m[-MAX_FIT_SAMPLES + 1 :], position],
                DEFAULT_SIGMA_M if sigma_m is None else sigma_m,
            )
            velocity = np.where(np.isnan(velocity), frame.rotate_from_ecef(fitted), velocity)
        track.append(t_utc_ns, position, frame.rotate_to_ecef(velocity))
        if not keep_history:
            track.forget_before(t_utc_ns - self.history_ns)
        self._changed(row, signature)

    def add_path(
        self,
        drone: str,
        t_utc_ns: Sequence[int],
        position_ecef_m: ArrayLike,
        *,
        signature: Signature,
        repeat: bool = False,
    ) -> None:
        """A scripted path: constant velocity between knots (k, 3), gone after the last one."""
        track = _Track(FOREVER_NS, 0)
        positions = as_floats(position_ecef_m)
        for (t0, p0), (t1, p1) in pairwise(zip(t_utc_ns, positions, strict=True)):
            velocity = (p1 - p0) / ((t1 - t0) / NS)
            track.append(t0, p0, velocity)
            track.append(t1, p1, velocity)
        if repeat:
            track.period_ns = t_utc_ns[-1] - t_utc_ns[0]
        self._changed(self._row(drone, track), signature)

    @property
    def signatures(self) -> Signatures:
        """What there is to sense of every drone, by its index."""
        return Signatures(
            rcs_m2=self._rcs_m2, sound_power_db=self._sound_power_db, emitters=self._emitters
        )

    @property
    def spans_ns(self) -> Ints:
        """Times of every drone's first and last sample, by its index; (n, 2)."""
        ends = [(track.t_utc_ns[0], track.t_utc_ns[-1]) for track in self._tracks]
        return np.array(ends, np.int64).reshape(-1, 2)

    def state_at(self, t_utc_ns: ArrayLike, drones: Ints | None = None) -> TruthState:
        """The drones that are there at a time, or of `drones` (m,) those there at times (m,)."""
        return self._at(t_utc_ns, drones, TruthState)

    def places_at(self, t_utc_ns: ArrayLike, drones: Ints | None = None) -> PlaceState:
        """`state_at` for who needs no velocities."""
        return self._at(t_utc_ns, drones, PlaceState)

    def _at(self, t_utc_ns: ArrayLike, drones: Ints | None, kind: type[S]) -> S:
        rows = np.arange(len(self.names)) if drones is None else drones
        t = np.full(rows.shape, t_utc_ns, np.int64)
        if self._bring_up_to(t, rows) and not self._holds(t, rows).all():
            # Some drone is asked for at times in several of its segments.
            parts = [self._at(t[i : i + 1], rows[i : i + 1], kind) for i in range(len(rows))]
            return kind.joined(parts)
        which: Ints | slice = slice(len(rows)) if drones is None else rows
        there = self._alive[which]
        if not there.all():
            which = rows = rows[there]
            t = t[there]
        coefficients = self._coefficients[:, :, which]
        tau_s = (t - self._start_ns[which]) / NS
        columns = {"drone": rows, "t_utc_ns": t, "position_ecef_m": _cubic(coefficients, tau_s).T}
        if issubclass(kind, TruthState):
            columns["velocity_ecef_m_s"] = _slope(coefficients, tau_s).T
        return kind.holding(columns)

    def position_at(self, t_utc_ns: Ints, drones: Ints) -> Floats:
        """ECEF positions of drones (m,) at times (m,), metres; (m, 3), NaN for one not there."""
        if self._bring_up_to(t_utc_ns, drones) and not self._holds(t_utc_ns, drones).all():
            parts = [
                self.position_at(t_utc_ns[i : i + 1], drones[i : i + 1]) for i in range(len(drones))
            ]
            return np.concatenate(parts)
        tau_s = (t_utc_ns - self._start_ns[drones]) / NS
        position_m: Floats = _cubic(self._coefficients[:, :, drones], tau_s).T
        position_m[~self._alive[drones]] = np.nan
        return position_m

    def positions_at(self, t_utc_ns: Ints) -> Floats:
        """ECEF positions of all drones at several times (k,), metres; (k, n, 3), NaN if not there.

        What `state_at` gives at each of them, to the last bit.
        """
        rows = np.arange(len(self.names))
        self._bring_up_to(np.broadcast_to(t_utc_ns[0], rows.shape), rows)
        one_piece = (t_utc_ns[0] >= self._start_ns[rows]) & (t_utc_ns[-1] < self._end_ns[rows])
        alive, coefficients = self._alive[: len(rows)], self._coefficients[:, :, : len(rows)]
        if not alive.all():
            coefficients = np.where(alive, coefficients, np.nan)
        tau_s = (t_utc_ns[:, None] - self._start_ns[: len(rows)]) / NS
        positions_m: Floats = np.moveaxis(_cubic(coefficients[:, :, None], tau_s), 0, -1)
        others = np.flatnonzero(~one_piece)
        for i, t in enumerate(t_utc_ns if len(others) else ()):
            state = self.state_at(int(t), others)
            positions_m[i, others] = np.nan
            positions_m[i, state.drone] = state.position_ecef_m
        return positions_m

    def _row(self, drone: str, new_track: _Track) -> int:
        row = self._index.get(drone)
        if row is not None:
            return row
        row = self._index[drone] = len(self.names)
        self.names.append(drone)
        self._tracks.append(new_track)
        self._emitters.append(())
        self._make_room(row + 1)
        return row

    def _make_room(self, rows: int) -> None:
        if rows <= len(self._start_ns):
            return
        for name in ("_start_ns", "_end_ns", "_alive", "_rcs_m2", "_sound_power_db"):
            setattr(self, name, with_room(getattr(self, name), rows))
        more = len(self._start_ns) - self._coefficients.shape[2]
        self._coefficients = np.pad(self._coefficients, ((0, 0), (0, 0), (0, more)))

    def _changed(self, row: int, signature: Signature) -> None:
        self._rcs_m2[row] = signature.rcs_m2
        self._sound_power_db[row] = signature.sound_power_db
        self._emitters[row] = signature.emitters
        self._end_ns[row] = self._start_ns[row]  # an empty stretch: looked up when next asked for
        self.version += 1

    def _holds(self, t_utc_ns: Ints, rows: Ints) -> NDArray[np.bool_]:
        """Whether the segments at hand are those of that time; (m,)."""
        return (t_utc_ns >= self._start_ns[rows]) & (t_utc_ns < self._end_ns[rows])

    def _bring_up_to(self, t_utc_ns: Ints, rows: Ints) -> bool:
        """Look up the segments of drones whose time has left the one at hand; whether any had."""
        outside = np.flatnonzero(~self._holds(t_utc_ns, rows))
        for i in outside:
            row = rows[i]
            segment = _segment(self._tracks[row], int(t_utc_ns[i]))
            self._start_ns[row], self._end_ns[row] = segment.start_ns, segment.end_ns
            self._alive[row] = segment.alive
            self._coefficients[:, :, row] = segment.coefficients
        return len(outside) > 0


def _cubic(coefficients: Floats, tau_s: Floats) -> Floats:
    """Positions by (4, 3, ...) coefficients, after (...) times; (3, ...), a row a component."""
    c0, c1, c2, c3 = coefficients
    position_m: Floats = c3 * tau_s
    for lower in (c2, c1):
        position_m += lower
        position_m *= tau_s
    position_m += c0
    return position_m


def _slope(coefficients: Floats, tau_s: Floats) -> Floats:
    """Velocities by (4, 3, ...) coefficients, after (...) times; (3, ...)."""
    _, c1, c2, c3 = coefficients
    velocity_m_s: Floats = c3 * (1.5 * tau_s)
    velocity_m_s += c2
    velocity_m_s *= 2 * tau_s
    velocity_m_s += c1
    return velocity_m_s


def _segment(track: _Track, t_utc_ns: int) -> _Segment:
    """The stretch of a track that holds a time."""
    times = track.t_utc_ns
    shift_ns = 0
    if track.period_ns and t_utc_ns >= times[0]:
        shift_ns = (t_utc_ns - times[0]) // track.period_ns * track.period_ns
    k = bisect_right(times, t_utc_ns - shift_ns) - 1
    if k < 0:
        return _Segment(-FOREVER_NS, times[0], False, _NOWHERE)
    start_ns, last = times[k], k == len(times) - 1
    if not last and times[k + 1] - start_ns <= track.max_gap_ns:
        return _Segment(start_ns + shift_ns, times[k + 1] + shift_ns, True, _hermite(track, k))
    next_ns = FOREVER_NS if last else times[k + 1]
    gone_ns = min(start_ns + track.tail_ns, next_ns)
    if t_utc_ns >= gone_ns:
        return _Segment(gone_ns, next_ns, False, _NOWHERE)
    straight = np.stack([track.position_ecef_m[k], track.velocity_ecef_m_s[k], *_NOWHERE[:2]])
    return _Segment(start_ns, gone_ns, True, straight)


def _hermite(track: _Track, k: int) -> Floats:
    """The cubic through samples k and k+1 with their velocities, in the time since k; (4, 3)."""
    duration_s = (track.t_utc_ns[k + 1] - track.t_utc_ns[k]) / NS
    p0, p1 = track.position_ecef_m[k : k + 2]
    v0, v1 = track.velocity_ecef_m_s[k : k + 2]
    mean_velocity = (p1 - p0) / duration_s
    c2 = (3 * mean_velocity - 2 * v0 - v1) / duration_s
    c3 = (v0 + v1 - 2 * mean_velocity) / duration_s**2
    return np.stack([p0, v0, c2, c3])


def fit_velocity(t_utc_ns: Sequence[int], position_m: Sequence[Floats], sigma_m: float) -> Floats:
    """Slope of the straight line through the latest positions, m/s; zero for a single one.

    It reaches back over as many samples as bring its standard deviation, sigma/sqrt(sum (t - mean
    t)^2), under `SIGMA_VELOCITY_M_S`: two where positions are fine, many where they are coarse, so
    that the steps of a quantised position are not taken for speed.
    """
    t_s = (np.asarray(t_utc_ns, dtype=np.int64) - t_utc_ns[-1]) / NS
    positions = np.asarray(position_m)
    slope = np.zeros(positions.shape[-1])
    for n in range(2, len(t_s) + 1):
        if t_s[-n] < -MAX_FIT_S and n > 2:
            break
        t = t_s[-n:] - t_s[-n:].mean()
        spread_s2 = float(t @ t)
        slope = t @ positions[-n:] / spread_s2
        if sigma_m <= SIGMA_VELOCITY_M_S * spread_s2**0.5:
            break
    return slope

"""Samples of drones that are heard of live, all in one log, and the stretches of path they make.

Each sample knows the one before it of its drone, so that any number of drones is added to, looked
up and forgotten in a few operations on whole columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from plotfeed.models.known_rows import trimmed, with_room
from plotfeed.models.state import NS, Bools, Floats, Ints

FOREVER_NS = (1 << 63) - 1
NONE = -1
"""The number of no sample."""

SIGMA_VELOCITY_M_S = 1.0
"""An unknown velocity is fitted over as many samples as it takes to know it this well."""
MAX_FIT_SAMPLES = 20
MAX_FIT_S = 6.0
"""Longer than this a drone does not fly straight."""


@dataclass(frozen=True, slots=True)
class Stretches:
    """Stretches of time in which positions are one cubic in the time since its start; (m,)."""

    start_ns: Ints
    end_ns: Ints
    alive: Bools
    coefficients: Floats
    """(4, 3, m): metres, m/s, m/s2, m/s3."""

    @classmethod
    def none(cls, m: int) -> Self:
        """Stretches that are yet to be filled in."""
        return cls(
            start_ns=np.zeros(m, np.int64),
            end_ns=np.zeros(m, np.int64),
            alive=np.zeros(m, np.bool_),
            coefficients=np.zeros((4, 3, m)),
        )

    def put(self, which: Ints, found: Stretches) -> None:
        """Fill in those."""
        self.start_ns[which], self.end_ns[which] = found.start_ns, found.end_ns
        self.alive[which] = found.alive
        self.coefficients[:, :, which] = found.coefficients


class LiveSamples:
    """A log of samples, by the rows of their drones; what is too old for anybody is forgotten."""

    def __init__(
        self, *, stale_after_ns: int, history_ns: int, max_speed_m_s: float = np.inf
    ) -> None:
        """A drone is gone so long after its last sample; so long a time before it is asked for.

        No velocity is fitted that is faster than `max_speed_m_s`.
        """
        self._max_speed_m_s = max_speed_m_s
        self._stale_after_ns = stale_after_ns
        self._history_ns = history_ns
        self._number = 0
        self._drone: Ints = np.zeros(0, np.int64)
        self._t_utc_ns: Ints = np.zeros(0, np.int64)
        self._position_ecef_m: Floats = np.zeros((0, 3))
        self._velocity_ecef_m_s: Floats = np.zeros((0, 3))
        self._before: Ints = np.zeros(0, np.int64)
        self._starts: Bools = np.zeros(0, np.bool_)
        """Samples to which no path leads from the one before."""
        self._any_starts = False
        self._latest: Ints = np.zeros(0, np.int64)
        """Number of the latest sample of each drone, and one more: 0 for none."""

    def __len__(self) -> int:
        """How many samples are kept."""
        return self._number

    def span_ns(self, drone: int) -> tuple[int, int]:
        """The times of the first sample that is kept of a drone, and of its latest."""
        last = first = int(self._latest[drone]) - 1
        while self._before[first] >= 0:
            first = int(self._before[first])
        return int(self._t_utc_ns[first]), int(self._t_utc_ns[last])

    def add(
        self,
        drones: Ints,
        t_utc_ns: Ints,
        position_ecef_m: Floats,
        starts: Sequence[int] = (),
    ) -> Ints:
        """Add samples of drones, of each in the order of time; their numbers, (n,).

        They have no velocities yet. To those at indices `starts` no path leads from before.
        """
        n = len(drones)
        if self._number + n > len(self._t_utc_ns):
            self._forget()
        self._latest = with_room(self._latest, int(drones.max()) + 1)
        for name in _COLUMNS:
            setattr(self, name, with_room(getattr(self, name), self._number + n))
        numbers: Ints = np.arange(self._number, self._number + n)
        new = slice(self._number, self._number + n)
        self._drone[new], self._t_utc_ns[new] = drones, t_utc_ns
        self._position_ecef_m[new] = position_ecef_m
        order = np.argsort(drones, kind="stable")
        sorted_drones = drones[order]
        again = np.flatnonzero(sorted_drones[1:] == sorted_drones[:-1])
        before = self._latest[drones] - 1
        before[order[again + 1]] = numbers[order[again]]
        self._before[new] = before
        self._starts[new] = False
        if len(starts):
            self._starts[numbers[list(starts)]] = self._any_starts = True
        last = np.ones(n, np.bool_)
        last[again] = False
        self._latest[sorted_drones[last]] = numbers[order[last]] + 1
        self._number += n
        return numbers

    def fly(self, numbers: Ints, velocity_ecef_m_s: Floats) -> None:
        """Give samples their velocities; (n, 3)."""
        self._velocity_ecef_m_s[numbers] = velocity_ecef_m_s

    def fitted_velocity(self, numbers: Ints, sigma_m: Floats) -> Floats:
        """Velocities of samples by `fit_velocity` over them and those before; (n, 3), ECEF."""
        if not len(numbers):
            return np.zeros((0, 3))
        chain = np.full((len(numbers), MAX_FIT_SAMPLES), NONE)
        chain[:, -1] = numbers
        for i in range(MAX_FIT_SAMPLES - 1, 0, -1):
            before = np.where(chain[:, i] >= 0, self._before[chain[:, i]], NONE)
            if self._any_starts:
                before[self._starts[chain[:, i]]] = NONE
            if (before < 0).all():
                break
            chain[:, i - 1] = before
        counts = (chain >= 0).sum(axis=1)
        t_s = (self._t_utc_ns[chain] - self._t_utc_ns[numbers][:, None]) / NS
        fitted = fit_velocities(t_s, self._position_ecef_m[chain], counts, sigma_m)
        return within_speed(fitted, self._max_speed_m_s)

    def stretches_at(self, drones: Ints, t_utc_ns: Ints) -> Stretches:
        """The stretches of drones (m,), each with a sample at least, that hold times (m,)."""
        at, after = self._latest[drones] - 1, np.full(len(drones), NONE)
        later = np.flatnonzero(t_utc_ns < self._t_utc_ns[at])
        while len(later):
            after[later] = at[later]
            at[later] = self._before[at[later]]
            later = later[at[later] >= 0]
            later = later[t_utc_ns[later] < self._t_utc_ns[at[later]]]
        known = at >= 0
        start_ns = self._t_utc_ns[at]
        next_ns = np.where(after >= 0, self._t_utc_ns[after], FOREVER_NS)
        bridged = known & (after >= 0) & (next_ns - start_ns <= self._stale_after_ns)
        if self._any_starts:
            bridged &= ~self._starts[after]
        tail_ns = np.minimum(FOREVER_NS - start_ns, self._stale_after_ns)
        gone_ns = np.minimum(start_ns + tail_ns, next_ns)
        alive = known & (bridged | (t_utc_ns < gone_ns))
        coefficients = np.zeros((4, 3, len(drones)))
        coefficients[0] = np.where(alive, self._position_ecef_m[at].T, 0.0)
        coefficients[1] = np.where(alive, self._velocity_ecef_m_s[at].T, 0.0)
        if bridged.any():
            which = np.flatnonzero(bridged)
            coefficients[2:, :, which] = self._bends(at[which], after[which])
        return Stretches(
            start_ns=np.where(alive, start_ns, np.where(known, gone_ns, -FOREVER_NS)),
            end_ns=np.where(alive & ~bridged, gone_ns, next_ns),
            alive=alive,
            coefficients=coefficients,
        )

    def _bends(self, first: Ints, second: Ints) -> Floats:
        """The higher coefficients of the cubics through samples (m,) and later ones; (2, 3, m)."""
        duration_s = (self._t_utc_ns[second] - self._t_utc_ns[first]) / NS
        p0, p1 = self._position_ecef_m[first].T, self._position_ecef_m[second].T
        v0, v1 = self._velocity_ecef_m_s[first].T, self._velocity_ecef_m_s[second].T
        mean_velocity = (p1 - p0) / duration_s
        c2 = (3 * mean_velocity - 2 * v0 - v1) / duration_s
        # By Python's own power, as for a track alone: NumPy's square differs in the last bit.
        c3 = (v0 + v1 - 2 * mean_velocity) / np.array([s**2 for s in duration_s.tolist()])
        return np.stack([c2, c3])

    def forget(self, drones: Ints, rows: int) -> None:
        """Forget all samples of those drones; of others there are none beyond so many rows."""
        self._latest[drones] = 0
        self._latest = trimmed(self._latest, rows)
        self._forget()
        for name in _COLUMNS:
            setattr(self, name, trimmed(getattr(self, name), self._number))

    def _forget(self) -> None:
        """Drop samples that no state within the history of their drones needs."""
        n = self._number
        before, drone = self._before[:n], self._drone[:n]
        known = drone < len(self._latest)
        latest = np.where(known, self._latest[np.where(known, drone, 0)], 0) - 1
        needed_from_ns = self._t_utc_ns[latest] - self._history_ns
        needed_from_ns[latest < 0] = FOREVER_NS
        keep = np.arange(n) == latest
        follows = np.flatnonzero(before >= 0)
        needed = self._t_utc_ns[follows] > needed_from_ns[follows]
        keep[before[follows[needed]]] = True
        keep[follows[needed]] = True
        kept = np.flatnonzero(keep)
        if len(kept) > n - n // 4:
            return
        renumbered = np.append(np.where(keep, np.cumsum(keep) - 1, NONE), NONE)
        has_any = self._latest > 0
        self._latest[has_any] = renumbered[self._latest[has_any] - 1] + 1
        self._number = len(kept)
        self._before[: len(kept)] = renumbered[before[kept]]
        for name in _COLUMNS:
            if name != "_before":
                column = getattr(self, name)
                column[: len(kept)] = column[kept]
        self._any_starts = bool(self._starts[: len(kept)].any())


_COLUMNS = (
    "_drone", "_t_utc_ns", "_position_ecef_m", "_velocity_ecef_m_s", "_before", "_starts"
)  # fmt: skip


def within_speed(velocity_m_s: Floats, max_speed_m_s: float) -> Floats:
    """Velocities (n, 3), those that are faster than that slowed down to it."""
    speed_m_s = np.linalg.norm(velocity_m_s, axis=1)
    if not (speed_m_s > max_speed_m_s).any():
        return velocity_m_s
    share = max_speed_m_s / np.maximum(speed_m_s, max_speed_m_s)
    slowed: Floats = velocity_m_s * share[:, None]
    return slowed


def fit_velocity(
    t_utc_ns: Sequence[int] | Ints, position_m: Sequence[Floats] | Floats, sigma_m: float
) -> Floats:
    """Slope of the straight line through the latest positions, m/s; zero for a single one.

    It reaches back over as many samples as bring its standard deviation, sigma/sqrt(sum (t - mean
    t)^2), under `SIGMA_VELOCITY_M_S`: two where positions are fine, many where they are coarse, so
    that the steps of a quantised position are not taken for speed.
    """
    t_s = (np.asarray(t_utc_ns, dtype=np.int64) - t_utc_ns[-1]) / NS
    positions, counts = np.asarray(position_m), np.array([len(t_s)])
    fitted: Floats = fit_velocities(t_s[None], positions[None], counts, np.array([sigma_m]))[0]
    return fitted


def fit_velocities(t_s: Floats, position_m: Floats, counts: Ints, sigma_m: Floats) -> Floats:
    """Slopes as `fit_velocity` finds them, by times (m, k) and positions (m, k, 3); (m, 3), m/s.

    Times are relative to the last of each; the last `counts` of each are known.
    """
    slopes = np.zeros((len(t_s), position_m.shape[-1]))
    open_ = np.flatnonzero(counts >= 2)
    for n in range(2, t_s.shape[1] + 1):
        if n > 2:
            open_ = open_[(counts[open_] >= n) & (t_s[open_, -n] >= -MAX_FIT_S)]
        if not len(open_):
            break
        latest_s = t_s[open_, -n:]
        t = latest_s - latest_s.mean(axis=1)[:, None]
        spread_s2 = np.matmul(t[:, None], t[:, :, None])[:, 0, 0]
        slopes[open_] = np.matmul(t[:, None], position_m[open_, -n:])[:, 0] / spread_s2[:, None]
        open_ = open_[sigma_m[open_] > SIGMA_VELOCITY_M_S * spread_s2**0.5]
    return slopes

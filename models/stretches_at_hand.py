"""The stretch of each drone's path that was asked for last, so that most lookups are arithmetic."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from plotfeed.models.known_rows import trimmed, with_room
from plotfeed.models.live_samples import FOREVER_NS, Stretches
from plotfeed.models.state import NS, Bools, Floats, Ints


class StretchesAtHand:
    """One stretch a drone, by its row; what lies outside is looked up, and is then at hand."""

    def __init__(self, looked_up: Callable[[Ints, Ints], Stretches]) -> None:
        """`looked_up` finds the stretches that hold times (m,), of rows (m,)."""
        self._looked_up = looked_up
        self._start_ns: Ints = np.zeros(0, np.int64)
        self._end_ns: Ints = np.zeros(0, np.int64)
        self._alive: Bools = np.zeros(0, np.bool_)
        self._coefficients: Floats = np.zeros((4, 3, 0))

    def make_room(self, rows: int) -> None:
        """Have so many rows at least."""
        if rows <= len(self._start_ns):
            return
        for name in ("_start_ns", "_end_ns", "_alive"):
            setattr(self, name, with_room(getattr(self, name), rows))
        more = len(self._start_ns) - self._coefficients.shape[2]
        self._coefficients = np.pad(self._coefficients, ((0, 0), (0, 0), (0, more)))

    def forget(self, rows: Ints, n: int) -> None:
        """Have nobody in those rows, and not much more room than for the first n."""
        self._start_ns[rows], self._end_ns[rows] = -FOREVER_NS, FOREVER_NS
        self._alive[rows] = False
        self._coefficients[:, :, rows] = 0.0
        for name in ("_start_ns", "_end_ns", "_alive"):
            setattr(self, name, trimmed(getattr(self, name), n))
        if len(self._start_ns) < self._coefficients.shape[2]:
            self._coefficients = self._coefficients[:, :, : len(self._start_ns)].copy()

    def drop(self, rows: Ints) -> None:
        """Look those up when they are next asked for: they are others now."""
        self._end_ns[rows] = self._start_ns[rows]

    def at(
        self, t_utc_ns: Ints, rows: Ints, *, everybody: bool = False
    ) -> tuple[Bools, Floats, Floats]:
        """Who of rows (m,) is there at times (m,), how long after the start of which cubic, s.

        (m,), (m,) and coefficients (4, 3, m). With `everybody`, rows are all from 0 on.
        """
        which: Ints | slice = slice(len(rows)) if everybody else rows
        start_ns, there = self._start_ns[which], self._alive[which]
        coefficients = self._coefficients[:, :, which]
        outside = np.flatnonzero((t_utc_ns < start_ns) | (t_utc_ns >= self._end_ns[which]))
        if len(outside):
            found = self._looked_up(t_utc_ns[outside], rows[outside])
            start_ns, there, coefficients = start_ns.copy(), there.copy(), coefficients.copy()
            start_ns[outside], there[outside] = found.start_ns, found.alive
            coefficients[:, :, outside] = found.coefficients
            # Of a drone asked for at several times, one stretch stays at hand, whole.
            kept, first = np.unique(rows[outside], return_index=True)
            self._start_ns[kept], self._end_ns[kept] = found.start_ns[first], found.end_ns[first]
            self._alive[kept] = found.alive[first]
            self._coefficients[:, :, kept] = found.coefficients[:, :, first]
        return there, (t_utc_ns - start_ns) / NS, coefficients

    def position_at(self, t_utc_ns: Ints, rows: Ints) -> Floats:
        """ECEF positions of rows (m,) at times (m,), metres; (m, 3), NaN for one not there."""
        there, tau_s, coefficients = self.at(t_utc_ns, rows)
        position_m = place(coefficients, tau_s).T
        position_m[~there] = np.nan
        return position_m

    def positions_at(self, t_utc_ns: Ints, n: int) -> Floats:
        """ECEF positions of the first n rows at times (k,), metres; (k, n, 3), NaN as above."""
        rows = np.arange(n)
        if len(t_utc_ns) == 1:
            return self.position_at(np.full(rows.shape, t_utc_ns[0]), rows)[None]
        self.at(np.broadcast_to(t_utc_ns[0], rows.shape), rows)
        one_piece = (t_utc_ns[0] >= self._start_ns[rows]) & (t_utc_ns[-1] < self._end_ns[rows])
        alive, coefficients = self._alive[:n], self._coefficients[:, :, :n]
        if not alive.all():
            coefficients = np.where(alive, coefficients, np.nan)
        tau_s = (t_utc_ns[:, None] - self._start_ns[:n]) / NS
        positions_m: Floats = np.moveaxis(place(coefficients[:, :, None], tau_s), 0, -1)
        others = np.flatnonzero(~one_piece)
        if len(others):
            times_ns, each = np.tile(t_utc_ns, len(others)), np.repeat(others, len(t_utc_ns))
            positions = self.position_at(times_ns, each).reshape(len(others), -1, 3)
            positions_m[:, others] = positions.swapaxes(0, 1)
        return positions_m


def place(coefficients: Floats, tau_s: Floats) -> Floats:
    """Positions by (4, 3, ...) coefficients, after (...) times; (3, ...), a row a component."""
    c0, c1, c2, c3 = coefficients
    position_m: Floats = c3 * tau_s
    for lower in (c2, c1):
        position_m += lower
        position_m *= tau_s
    position_m += c0
    return position_m


def slope(coefficients: Floats, tau_s: Floats) -> Floats:
    """Velocities by (4, 3, ...) coefficients, after (...) times; (3, ...)."""
    _, c1, c2, c3 = coefficients
    velocity_m_s: Floats = c3 * (1.5 * tau_s)
    velocity_m_s += c2
    velocity_m_s *= 2 * tau_s
    velocity_m_s += c1
    return velocity_m_s

"""Flights as they were told of, at any time: between places that are known, and never beyond."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from plotfeed.models.state import NS, Bools, Floats, Ints

APART_NS = 20_000_000
"""Places of a flight are kept at most so close to each other: closer ones say nothing more."""


@dataclass(frozen=True, slots=True)
class FlightPath:
    """One drone: times (n,), ascending, with its true places in ECEF, (n, 3), metres.

    Between places that are at most `gap_ns` apart it flies by the cubic of Hermite, with the
    velocity at each place that a parabola through it and its neighbours has. Elsewhere it is not
    there.
    """

    t_utc_ns: Ints
    position_ecef_m: Floats
    velocity_ecef_m_s: Floats
    gap_ns: int

    @classmethod
    def of(cls, t_utc_ns: Ints, position_ecef_m: Floats, gap_ns: int) -> Self:
        """Take places in any order, some perhaps told by several sensors."""
        order = np.argsort(t_utc_ns, kind="stable")
        t_ns, place_m = t_utc_ns[order], position_ecef_m[order]
        _, kept = np.unique(t_ns // APART_NS, return_index=True)
        t_ns, place_m = t_ns[kept], place_m[kept]
        return cls(t_ns, place_m, _velocities(t_ns, place_m, gap_ns), gap_ns)

    def states_at(self, t_utc_ns: Ints) -> tuple[Floats, Floats]:
        """Places and velocities in ECEF at times (m,), each (m, 3); NaN where it is not there."""
        last = len(self.t_utc_ns) - 1
        if last < 1:
            nowhere = np.full((len(t_utc_ns), 3), np.nan)
            return nowhere, nowhere
        i = np.clip(np.searchsorted(self.t_utc_ns, t_utc_ns, side="right") - 1, 0, last - 1)
        begin_ns, span_ns = self.t_utc_ns[i], self.t_utc_ns[i + 1] - self.t_utc_ns[i]
        since_ns = t_utc_ns - begin_ns
        there = (since_ns >= 0) & (since_ns <= span_ns) & (span_ns <= self.gap_ns)
        span_s = np.where(there, span_ns / NS, np.nan)[:, None]
        u = np.where(there, since_ns / span_ns, np.nan)[:, None]
        p, q = self.position_ecef_m[i], self.position_ecef_m[i + 1]
        v, w = self.velocity_ecef_m_s[i] * span_s, self.velocity_ecef_m_s[i + 1] * span_s
        way = q - p
        # Hermite's cubic, counted from the first place so that no digits of ECEF are lost.
        a, b = v + w - 2 * way, 3 * way - 2 * v - w
        return p + u * (v + u * (b + u * a)), (v + u * (2 * b + 3 * u * a)) / span_s


def _velocities(t_utc_ns: Ints, position_ecef_m: Floats, gap_ns: int) -> Floats:
    """Velocities at places; what lies beyond a gap has no part in them."""
    n = len(t_utc_ns)
    if n < 2:
        return np.zeros((n, 3))
    span_ns = np.diff(t_utc_ns)
    slopes = np.diff(position_ecef_m, axis=0) / (span_ns / NS)[:, None]
    near = span_ns <= gap_ns
    # That of the parabola weighs each side by the length of the other.
    before, after = np.zeros(n), np.zeros(n)
    before[1:] = np.where(near, 1.0, 0.0)
    after[:-1] = np.where(near, 1.0, 0.0)
    lengths = np.concatenate([span_ns[:1], span_ns, span_ns[-1:]]) / NS
    two = (before > 0) & (after > 0)
    weight_before = np.where(two, lengths[1:], before)
    weight_after = np.where(two, lengths[:-1], after)
    total = np.maximum(weight_before + weight_after, 1e-300)
    padded = np.concatenate([np.zeros((1, 3)), slopes, np.zeros((1, 3))])
    found: Floats = (
        weight_before[:, None] * padded[:-1] + weight_after[:, None] * padded[1:]
    ) / total[:, None]
    return found


def covered_at(looks_utc_ns: Ints, t_utc_ns: Ints, gap_ns: int) -> Bools:
    """Whether times (m,) lie between two looks, ascending, that are at most `gap_ns` apart."""
    if len(looks_utc_ns) < 2:
        return np.zeros(len(t_utc_ns), np.bool_)
    i = np.searchsorted(looks_utc_ns, t_utc_ns, side="right")
    inside = (i > 0) & (i < len(looks_utc_ns))
    i = np.clip(i, 1, len(looks_utc_ns) - 1)
    found: Bools = inside & (looks_utc_ns[i] - looks_utc_ns[i - 1] <= gap_ns)
    return found | np.isin(t_utc_ns, looks_utc_ns)


def stays_of(times: Ints, gap: int) -> list[tuple[int, int]]:
    """Stretches of ascending times, first and last, within which no gap is larger."""
    if not len(times):
        return []
    ends = np.flatnonzero(np.diff(times) > gap)
    firsts = times[np.concatenate([[0], ends + 1])]
    lasts = times[np.append(ends, len(times) - 1)]
    return list(zip(firsts.tolist(), lasts.tolist(), strict=True))

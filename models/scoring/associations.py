"""Which track is of which drone, over time: with hysteresis, so that no crossing is a swap.

A track is taken for a drone's when that one was nearest, within the gate, so many steps in a row,
and until it has been out of the gate for so many. Several tracks may be of one drone.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from operator import itemgetter

import numpy as np

from plotfeed.models.state import Columns, Floats, Ints

NOBODY = -1


class TrackHolder:
    """Takes what there is step by step, and says which tracks are of which drones."""

    def __init__(
        self, drones: int, tracks: int, gate_m: float, *, confirm_steps: int, end_steps: int
    ) -> None:
        self._gate_m = gate_m
        self._confirm = confirm_steps
        self._end = end_steps
        self._place = np.full(drones + 1, NOBODY)
        """Of drones among those that are there; the last one is nobody."""
        self._held = np.full(tracks, NOBODY)
        self._within = np.zeros(tracks, np.int64)
        """Step at which a track was last within the gate of whom it is held to be of."""
        self._wanted = np.full(tracks, NOBODY)
        self._since = np.zeros(tracks, np.int64)
        self._until = np.full(tracks, -2)
        """The step up to which the same one was nearest."""

    def step(
        self, k: int, drones: Ints, tracks: Ints, distances_m: Floats
    ) -> tuple[Ints, Ints, Ints]:
        """Tracks, the drones that they are of, and since which step, new ones from earlier on.

        `distances_m` (m, n) are those from the drones (m,) to the tracks (n,) of this step.
        """
        none = np.zeros(0, np.int64)
        if not len(tracks):
            return none, none, none
        held = self._held[tracks]
        if not len(drones):
            self._end_old(k, tracks, held)
            return none, none, none
        every = np.arange(len(tracks))
        self._place[drones] = np.arange(len(drones))
        place = self._place[held]
        self._place[drones] = NOBODY
        near = (held != NOBODY) & (place != NOBODY)
        near[near] = distances_m[place[near], every[near]] < self._gate_m
        self._within[tracks[near]] = k
        held = self._end_old(k, tracks, held)
        nearest = np.argmin(distances_m, axis=0)
        is_free = (held == NOBODY) & (distances_m[nearest, every] < self._gate_m)
        free, wanted = tracks[is_free], drones[nearest[is_free]]
        goes_on = (self._wanted[free] == wanted) & (self._until[free] == k - 1)
        since = np.where(goes_on, self._since[free], k)
        self._wanted[free], self._since[free], self._until[free] = wanted, since, k
        is_new = k - since >= self._confirm - 1
        new = free[is_new]
        self._held[new], self._within[new] = wanted[is_new], k
        old = tracks[near]
        return (
            np.concatenate([old, new]),
            np.concatenate([self._held[old], wanted[is_new]]),
            np.concatenate([np.full(len(old), k), since[is_new]]),
        )

    def _end_old(self, k: int, tracks: Ints, held: Ints) -> Ints:
        """Whom tracks are held to be of, once those are forgotten that were out for long."""
        gone = (held != NOBODY) & (k - self._within[tracks] >= self._end)
        if not gone.any():
            return held
        self._held[tracks[gone]] = NOBODY
        return np.where(gone, NOBODY, held)


@dataclass(frozen=True, kw_only=True)
class Segments(Columns):
    """Stretches of steps, (n,), over which a track is of one drone, by track and time."""

    track: Ints
    drone: Ints
    first: Ints
    last: Ints


def segments_of(track: Ints, drone: Ints, step: Ints, end_steps: int) -> Segments:
    """Stretches of what is assigned, row by row, (n,); fewer missing steps do not part them."""
    order = np.lexsort((step, drone, track))
    track, drone, step = track[order], drone[order], step[order]
    parts = np.ones(len(step), np.bool_)
    parts[1:] = (np.diff(track) != 0) | (np.diff(drone) != 0) | (np.diff(step) > end_steps)
    first = np.flatnonzero(parts)
    last = np.append(first[1:], len(step))[: len(first)] - 1
    found = Segments(track=track[first], drone=drone[first], first=step[first], last=step[last])
    return found.rows(np.lexsort((found.first, found.track)))


def swaps_of(segments: Segments) -> int:
    """How often a track passes from one drone to another."""
    same = np.diff(segments.track) == 0
    return int(np.count_nonzero(same & (np.diff(segments.drone) != 0)))


@dataclass(frozen=True, slots=True)
class Followed:
    """How tracks follow one drone: the fewest of them that tell as much of it as all do."""

    number_changes: int
    """How often the next of these tracks has another number."""
    breaks: int
    """How often no track was of the drone between two that were, while it was there."""
    longest_steps: int
    first_step: int
    """-1 if it never had any."""
    tracks: int


def followed(segments: Segments, there: Ints) -> Followed:
    """How a drone that is there at these steps, in order, is followed by its own segments."""
    columns = (segments.first.tolist(), segments.last.tolist(), segments.track.tolist())
    rows = sorted(zip(*columns, strict=True))
    chosen: list[int] = []
    breaks, reached, i = 0, -1, 0
    while i < len(rows):
        start = max(rows[i][0], reached + 1)
        best = rows[i]
        while i < len(rows) and rows[i][0] <= start:
            best = max(best, rows[i], key=itemgetter(1))
            i += 1
        if best[1] <= reached:
            continue
        hole = np.searchsorted(there, [reached + 1, start])
        breaks += bool(chosen and hole[1] > hole[0])
        chosen.append(best[2])
        reached = best[1]
    return Followed(
        number_changes=sum(a != b for a, b in pairwise(chosen)),
        breaks=breaks,
        longest_steps=max((last - first + 1 for first, last, _ in rows), default=0),
        first_step=rows[0][0] if rows else -1,
        tracks=len({track for *_, track in rows}),
    )

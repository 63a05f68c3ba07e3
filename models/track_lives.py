"""When tracks begin and end by hits and misses, and the numbers that they have meanwhile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plotfeed.models.state import Bools, Columns, Ints, trimmed, with_room

MAX_TRACKS = 65535  # Numbers are 1 to this: what 16 bits hold but 0


class TrackNumbers:
    """Numbers of tracks as they begin: the next that is free, round and round between two."""

    def __init__(self, first: int = 1, last: int = MAX_TRACKS) -> None:
        self._first, self._last = first, last
        self._newest = first - 1

    def given(self, wanted: int, in_use: Ints) -> Ints:
        """Numbers for so many tracks, or for as many as there are numbers left; (n,)."""
        taken = set(in_use.tolist()) if wanted else set()
        room = self._last - self._first + 1 - len(taken)
        found = []
        for _ in range(min(wanted, room)):
            self._go_on()
            while self._newest in taken:
                self._go_on()
            taken.add(self._newest)
            found.append(self._newest)
        return np.array(found, np.int64)

    def _go_on(self) -> None:
        self._newest = self._first if self._newest >= self._last else self._newest + 1


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackRule:
    """A track begins with `confirm_hits` among `confirm_window` looks, ends with `drop_misses`.

    A sensor looks at a drone once a period. One that it has not looked at for a period and
    `patience_ns` counts as missed: a beam comes by a little earlier or later. Numbers of tracks are
    from `first_number` to `last_number`.
    """

    confirm_hits: int
    confirm_window: int
    drop_misses: int
    period_ns: int
    patience_ns: int = 0
    first_number: int = 1
    last_number: int = MAX_TRACKS


@dataclass(frozen=True, kw_only=True)
class LivingTracks(Columns):
    """Tracks that were hit or missed; `misses` are those in a row, `hit_utc_ns` the last hit's."""

    drone: Ints
    track: Ints
    misses: Ints
    hit_utc_ns: Ints
    first: Bools
    last: Bools


_OF_LIVES = ("_looked_ns", "_hit_ns", "_misses", "_track", "_hits")


class TrackLives:
    """The tracks of one sensor, fed with its looks sector by sector."""

    def __init__(self, rule: TrackRule) -> None:
        self._rule = rule
        self._end_ns: int | None = None
        self._numbers = TrackNumbers(rule.first_number, rule.last_number)
        self._looked_ns: Ints = np.zeros(0, np.int64)  # 0 for a drone that is not followed
        self._hit_ns: Ints = np.zeros(0, np.int64)
        self._misses: Ints = np.zeros(0, np.int64)
        self._track: Ints = np.zeros(0, np.int64)  # 0 for none
        self._hits: Bools = np.zeros((0, rule.confirm_window), np.bool_)

    @property
    def drones(self) -> Ints:
        """The drones that have a track, or were detected of late."""
        return np.flatnonzero(self._looked_ns)

    def take(
        self, drone: Ints, t_utc_ns: Ints, hit: Bools, *, start_ns: int, end_ns: int
    ) -> LivingTracks:
        """The tracks to report after a sector, by drone; one look a drone, with ascending indices.

        Time between this sector and the one before it is not counted: nobody looked.
        """
        rows = int(drone[-1]) + 1 if len(drone) else 0
        for name in _OF_LIVES:
            setattr(self, name, with_room(getattr(self, name), rows))
        if self._end_ns is not None and start_ns > self._end_ns:
            self._looked_ns[self.drones] += start_ns - self._end_ns
        self._end_ns = end_ns
        others = np.setdiff1d(self.drones, drone)
        due_ns = self._looked_ns[others] + self._rule.period_ns + self._rule.patience_ns
        missed = others[due_ns <= end_ns]
        self._looked_ns[missed] += self._rule.period_ns
        self._looked_ns[drone] = t_utc_ns
        self._hit_ns[drone[hit]] = t_utc_ns[hit]
        self._count(missed, np.zeros(len(missed), np.bool_))
        self._count(drone, hit)
        first = self._begin(drone[hit])
        found = np.union1d(drone, missed)
        found = found[self._track[found] > 0]
        living = LivingTracks(
            drone=found,
            track=self._track[found],
            misses=self._misses[found],
            hit_utc_ns=self._hit_ns[found],
            first=np.isin(found, first),
            last=self._misses[found] >= self._rule.drop_misses,
        )
        self._forget(living.drone[living.last])
        return living

    def forget(self, drone: Ints, n: int) -> None:
        """Take those drones for others; there are n, and no room is kept for many more."""
        self._forget(drone[drone < len(self._track)])
        n = max(n, int(self.drones.max(initial=-1)) + 1)
        for name in _OF_LIVES:
            setattr(self, name, trimmed(getattr(self, name), n))

    def _count(self, drone: Ints, hit: Bools) -> None:
        self._hits[drone] = np.concatenate([self._hits[drone, 1:], hit[:, None]], axis=1)
        self._misses[drone] = np.where(hit, 0, self._misses[drone] + 1)
        self._forget(drone[~self._hits[drone].any(axis=1) & (self._track[drone] == 0)])

    def _begin(self, drone: Ints) -> Ints:
        """Give numbers to the drones that were hit often enough and have none; those drones."""
        often = self._hits[drone].sum(axis=1) >= self._rule.confirm_hits
        new: Ints = drone[often & (self._track[drone] == 0)]
        numbers = self._numbers.given(len(new), self._track[self._track > 0])
        new = new[: len(numbers)]
        self._track[new] = numbers
        return new

    def _forget(self, drone: Ints) -> None:
        for column in (self._looked_ns, self._misses, self._track, self._hits):
            column[drone] = 0

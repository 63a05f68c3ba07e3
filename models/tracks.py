"""Tracks as a sensor on board makes them, and one way to them: the truth with a filter's errors.

When they begin and end by hits and misses, and the numbers that they have meanwhile.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.numerics import as_floats
from plotfeed.models.state import NS, Bools, Columns, Floats, Ints, trimmed, with_room

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


@dataclass(frozen=True, slots=True)
class AlphaBeta:
    """The critically damped filter: a straight line by least squares through all plots so far.

    In it a plot that is n scans old weighs theta^n.
    """

    smoothing_scans: float

    @property
    def memory(self) -> float:
        """What a scan leaves of a plot's weight, theta = exp(-1 / smoothing_scans)."""
        return math.exp(-1.0 / self.smoothing_scans)

    @property
    def alpha(self) -> float:
        """Gain of the position: 1 - theta^2."""
        return 1.0 - self.memory**2  # Brookner, Tracking and Kalman Filtering Made Easy, ch. 1

    @property
    def beta(self) -> float:
        """Gain of the velocity: (1 - theta)^2."""
        return (1.0 - self.memory) ** 2

    def position_variance(self, misses: ArrayLike) -> Floats:
        """Variance of x after so many periods without a plot, as a multiple of a plot's own."""
        position, both, velocity = self._stationary()
        n = as_floats(misses)
        return position + n * (2.0 * both + n * velocity)

    def velocity_variance(self) -> float:
        """Variance of v, as a multiple of a plot's own over T^2."""
        return self._stationary()[2]

    def _stationary(self) -> tuple[float, float, float]:
        """Variance of x, covariance of x and vT, variance of vT, of plots with variance 1.

        The P that stays as it is under P = A P A' + K K', with K = (alpha, beta)' and
        A = (1 - alpha, 1 - alpha; -beta, 1 - beta).
        """
        alpha, beta = self.alpha, self.beta
        whole = alpha * (4.0 - 2.0 * alpha - beta)
        return (
            (2.0 * alpha**2 + 2.0 * beta - 3.0 * alpha * beta) / whole,
            beta * (2.0 * alpha - beta) / whole,
            2.0 * beta**2 / whole,
        )


@dataclass(frozen=True, kw_only=True)
class TrackerLooks(Columns):
    """A look at each drone, by ascending index, and the error of the plot if there was one.

    Covariances are (n, 3, 3), east, north and up; NaN where there was no plot.
    """

    drone: Ints
    t_utc_ns: Ints
    hit: Bools
    covariance_m2: Floats


@dataclass(frozen=True, kw_only=True)
class LocalStates(Columns):
    """Where drones are, east, north and up of one place, (n, 3), all at one time."""

    drone: Ints
    position_enu_m: Floats
    velocity_enu_m_s: Floats


@dataclass(frozen=True, kw_only=True)
class TrackStates(Columns):
    """Tracks at one time, east, north and up of one place; vectors and sigmas are (n, 3).

    `misses` are the looks since the last plot, of which `age_s` is the age. `drone` is -1 where
    nobody knows; `has_height` tells whether the sensor measures where a track is upwards.
    """

    drone: Ints
    track: Ints
    misses: Ints
    age_s: Floats
    first: Bools
    last: Bools
    position_enu_m: Floats
    velocity_enu_m_s: Floats
    sigma_position_m: Floats
    sigma_velocity_m_s: Floats
    has_height: Bools


_OF_SMOOTHED = ("_t_ns", "_units", "_covariance_m2", "_states")


class SmoothedTruth:
    """The tracks of one sensor, fed sector by sector."""

    def __init__(self, rule: TrackRule, smoothing_scans: float) -> None:
        self._lives = TrackLives(rule)
        self._filter = AlphaBeta(smoothing_scans)
        self._period_s = rule.period_ns / NS
        self._t_ns: Ints = np.zeros(0, np.int64)
        self._units: Floats = np.zeros((0, 2, 3))  # errors of position and velocity, over sigma
        self._covariance_m2: Floats = np.zeros((0, 3, 3))
        self._states: Floats = np.zeros((0, 2, 3))  # position and velocity when last reported

    @property
    def drones(self) -> Ints:
        """The drones that have a track, or were detected of late."""
        return self._lives.drones

    def end(self) -> None:
        """End all tracks, of which nothing more is told; later ones have other numbers."""
        self.forget(self.drones, len(self._covariance_m2))

    def forget(self, drone: Ints, n: int) -> None:
        """Take those drones for others; there are n, and no room is kept for many more."""
        self._lives.forget(drone, n)
        self._covariance_m2[drone[drone < len(self._covariance_m2)]] = np.nan
        n = max(n, int(self.drones.max(initial=-1)) + 1)
        for name in _OF_SMOOTHED:
            setattr(self, name, trimmed(getattr(self, name), n))

    def take(
        self,
        looks: TrackerLooks,
        truth: LocalStates,
        *,
        start_ns: int,
        end_ns: int,
        rng: np.random.Generator,
        has_height: bool = True,
    ) -> TrackStates:
        """The tracks to report at the end of a sector, of a sensor that has heights or has none.

        `truth` is of that time, for the drones looked at and those in `drones`, as far as they are
        still there. A track whose drone is gone flies straight on until it ends.
        """
        rows = int(looks.drone[-1]) + 1 if len(looks) else 0
        for name in _OF_SMOOTHED:
            setattr(self, name, with_room(getattr(self, name), rows))
        looks = looks.rows(np.isin(looks.drone, truth.drone))
        # Of its plots of late: those before it knew the drone are another life's.
        unknown = np.setdiff1d(looks.drone, self.drones)
        self._covariance_m2[unknown] = np.nan
        self._learn_errors(looks.rows(looks.hit))
        living = self._lives.take(
            looks.drone, looks.t_utc_ns, looks.hit, start_ns=start_ns, end_ns=end_ns
        )
        self._move(living.drone, truth, end_ns)
        self._draw(living.drone, living.first, end_ns, rng)
        covariance_m2 = np.nan_to_num(self._covariance_m2[living.drone], nan=0.0)
        scale = np.sqrt(self._filter.position_variance(living.misses))[:, None]
        rate_hz = self._filter.velocity_variance() ** 0.5 / self._period_s
        shaped_m = _shaped(covariance_m2, self._units[living.drone])
        sigma_m = np.sqrt(np.diagonal(covariance_m2, axis1=1, axis2=2))
        return TrackStates(
            drone=living.drone,
            track=living.track,
            misses=living.misses,
            age_s=(end_ns - living.hit_utc_ns) / NS,
            first=living.first,
            last=living.last,
            position_enu_m=self._states[living.drone, 0] + scale * shaped_m[:, 0],
            velocity_enu_m_s=self._states[living.drone, 1] + rate_hz * shaped_m[:, 1],
            sigma_position_m=scale * sigma_m,
            sigma_velocity_m_s=rate_hz * sigma_m,
            has_height=np.full(len(living), has_height, np.bool_),
        )

    def _learn_errors(self, hits: TrackerLooks) -> None:
        """A fading mean of the plots' covariances, by alpha; one without bounds teaches nothing."""
        bounded = np.isfinite(hits.covariance_m2).all(axis=(1, 2))
        hits = hits.rows(np.flatnonzero(bounded))
        before = self._covariance_m2[hits.drone]
        before = np.where(np.isnan(before), hits.covariance_m2, before)
        change = hits.covariance_m2 - before
        self._covariance_m2[hits.drone] = before + self._filter.alpha * change

    def _move(self, drone: Ints, truth: LocalStates, t_utc_ns: int) -> None:
        """Put tracks where their drones are, or would be."""
        into_s = ((t_utc_ns - self._t_ns[drone]) / NS)[:, None]
        self._states[drone, 0] += into_s * self._states[drone, 1]
        there = truth.rows(np.isin(truth.drone, drone))
        self._states[there.drone, 0] = there.position_enu_m
        self._states[there.drone, 1] = there.velocity_enu_m_s

    def _draw(self, drone: Ints, first: Bools, t_utc_ns: int, rng: np.random.Generator) -> None:
        into_s = np.abs(t_utc_ns - self._t_ns[drone]) / NS
        kept = np.exp(-into_s / (self._filter.smoothing_scans * self._period_s))
        kept = np.where(first, 0.0, kept)[:, None, None]
        drawn = rng.standard_normal((len(drone), 2, 3))
        self._units[drone] = kept * self._units[drone] + np.sqrt(1 - kept**2) * drawn
        self._t_ns[drone] = t_utc_ns


def _shaped(covariance: Floats, units: Floats) -> Floats:
    """Unit normals (n, k, 3) to errors of those covariances (n, 3, 3).

    By the symmetric root, which follows a covariance that changes by little with little change.
    """
    variances, axes = np.linalg.eigh(covariance)
    along = np.einsum("nia,nki->nka", axes, units)
    along *= np.sqrt(np.maximum(variances, 0.0))[:, None, :]
    shaped: Floats = np.einsum("nia,nka->nki", axes, along)
    return shaped


NEVER = np.iinfo(np.int64).max  # In place of a time


def enough_ns(drone: Ints, t_utc_ns: Ints, plots: int, within_ns: int, drones: int) -> Ints:
    """When each of so many drones has `plots` within that time, by rows (n,); else `NEVER`."""
    found = np.full(drones, NEVER, np.int64)
    order = np.lexsort((t_utc_ns, drone))
    drone, t_utc_ns = drone[order], t_utc_ns[order]
    last = slice(plots - 1, None)
    first = slice(0, max(len(drone) - plots + 1, 0))
    soon = (drone[last] == drone[first]) & (t_utc_ns[last] - t_utc_ns[first] <= within_ns)
    np.minimum.at(found, drone[last][soon], t_utc_ns[last][soon])
    return found

"""When a sensor that tracks has a track of a drone: where each begins, coasts and ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plotfeed.models.state import Bools, Columns, Floats, Ints, Plots, with_room

MAX_TRACKS = 65535
"""Numbers are 1 to this: what 16 bits hold but 0."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackRule:
    """A track begins with `confirm_hits` among `confirm_window` looks, ends with `drop_misses`.

    A sensor looks at a drone once a period. One that it has not looked at for a period and
    `patience_ns` counts as missed: a beam comes by a little earlier or later.
    """

    confirm_hits: int
    confirm_window: int
    drop_misses: int
    period_ns: int
    patience_ns: int = 0


@dataclass(frozen=True, kw_only=True)
class LivingTracks(Columns):
    """Tracks that were hit or missed; `misses` are those in a row, `hit_utc_ns` the last hit's."""

    drone: Ints
    track: Ints
    misses: Ints
    hit_utc_ns: Ints
    first: Bools
    last: Bools


class TrackLives:
    """The tracks of one sensor, fed with its looks sector by sector."""

    def __init__(self, rule: TrackRule) -> None:
        self._rule = rule
        self._end_ns: int | None = None
        self._newest = 0
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
        self._make_room(int(drone[-1]) + 1 if len(drone) else 0)
        self._stand_still_until(start_ns)
        self._end_ns = end_ns
        missed = self._not_looked_at(drone, end_ns)
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

    def _make_room(self, drones: int) -> None:
        for name in ("_looked_ns", "_hit_ns", "_misses", "_track", "_hits"):
            setattr(self, name, with_room(getattr(self, name), drones))

    def _stand_still_until(self, start_ns: int) -> None:
        if self._end_ns is not None and start_ns > self._end_ns:
            self._looked_ns[self.drones] += start_ns - self._end_ns

    def _not_looked_at(self, looked_at: Ints, end_ns: int) -> Ints:
        """The drones whose look is overdue at the end of a sector."""
        known = np.setdiff1d(self.drones, looked_at)
        due_ns = self._looked_ns[known] + self._rule.period_ns + self._rule.patience_ns
        return known[due_ns <= end_ns]

    def _count(self, drone: Ints, hit: Bools) -> None:
        self._hits[drone] = np.concatenate([self._hits[drone, 1:], hit[:, None]], axis=1)
        self._misses[drone] = np.where(hit, 0, self._misses[drone] + 1)
        self._forget(drone[~self._hits[drone].any(axis=1) & (self._track[drone] == 0)])

    def _begin(self, drone: Ints) -> Ints:
        """Give numbers to the drones that were hit often enough and have none; those drones."""
        often = self._hits[drone].sum(axis=1) >= self._rule.confirm_hits
        new: Ints = drone[often & (self._track[drone] == 0)]
        taken = set(self._track[self._track > 0].tolist()) if len(new) else set()
        new = new[: MAX_TRACKS - len(taken)]
        for row in new:
            self._newest = self._newest % MAX_TRACKS + 1
            while self._newest in taken:
                self._newest = self._newest % MAX_TRACKS + 1
            taken.add(self._newest)
            self._track[row] = self._newest
        return new

    def _forget(self, drone: Ints) -> None:
        for column in (self._looked_ns, self._misses, self._track, self._hits):
            column[drone] = 0


def stated_covariance_m2(plots: Plots) -> Floats:
    """East, north and up of the sensor; (n, 3, 3). Nothing of a height that is not measured.

    Of a level covariance where the sensor states one, else of range, azimuth and elevation. NaN
    for an error without bounds.
    """
    level_m2 = np.zeros((len(plots), 3, 3))
    level_m2[:, 0, 0] = plots.covariance_east_m2
    level_m2[:, 1, 1] = plots.covariance_north_m2
    level_m2[:, 0, 1] = level_m2[:, 1, 0] = plots.covariance_east_north_m2
    is_polar = np.isnan(plots.covariance_east_m2)[:, None, None]
    covariance_m2 = np.where(is_polar, _polar_covariance_m2(plots), level_m2)
    covariance_m2[~np.isfinite(covariance_m2).all(axis=(1, 2))] = np.nan
    return covariance_m2


def _polar_covariance_m2(plots: Plots) -> Floats:
    """Covariance to first order in the errors of range and angles, along their directions."""
    azimuth = np.radians(plots.azimuth_deg)
    elevation = np.radians(np.nan_to_num(plots.elevation_deg))
    sin_az, cos_az = np.sin(azimuth), np.cos(azimuth)
    sin_el, cos_el = np.sin(elevation), np.cos(elevation)
    along = np.stack([sin_az * cos_el, cos_az * cos_el, sin_el])
    right = np.stack([cos_az, -sin_az, np.zeros(len(plots))])
    above = np.stack([-sin_az * sin_el, -cos_az * sin_el, cos_el])
    with np.errstate(invalid="ignore"):
        spread_m = np.stack(
            [
                along * plots.sigma_range_m,
                right * plots.range_m * cos_el * np.radians(plots.sigma_azimuth_deg),
                above * plots.range_m * np.radians(np.nan_to_num(plots.sigma_elevation_deg)),
            ]
        )
        covariance_m2: Floats = np.einsum("kin,kjn->nij", spread_m, spread_m)
    return covariance_m2

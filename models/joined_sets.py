"""Which detections of pairs of stations are of one target: sets that fit to a place.

Sets begin with three pairs, whose place is found on the ellipse of the first; further pairs join if
they fit. Sets of several targets that fit by chance are ghosts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.special import chdtri

from plotfeed.models.frames import aer_to_enu, enu_to_aer, wrap_180
from plotfeed.models.multilateration import Sightings, Solved, range_sums_m, solved
from plotfeed.models.sensors.bistatic_places import ground_range_m
from plotfeed.models.state import FALSE_ALARM, Bools, Columns, Floats, Ints

OUTSIDE = 0.0027
"""Of right sets, the share that a gate of three sigmas leaves out."""
MOST_SETS = 20_000
"""That are tried for each three pairs: of more, the strongest detections alone."""
MOST_TRIPLES = 35
SURE = 5.0
"""Sigmas beyond which nothing is tried."""
SEARCHED = 91
"""Points of an ellipse."""
MOST_FITS = 400
"""Places that are kept of the sets of a scan, the best ones."""


@dataclass(frozen=True, kw_only=True)
class Detections(Columns):
    """What pairs measured in a scan, a row a detection."""

    pair: Ints
    sum_m: Floats
    sigma_sum_m: Floats
    azimuth_deg: Floats
    sigma_azimuth_deg: Floats
    elevation_deg: Floats
    sigma_elevation_deg: Floats
    snr: Floats
    drone: Ints


@dataclass(frozen=True, slots=True)
class JoinedSets:
    """Places of sets of detections, their mean ratios, and whose they are; (h,)."""

    fit: Solved
    snr: Floats
    drone: Ints
    """A false alarm's where detections are of several drones, or of none."""


@dataclass(frozen=True, kw_only=True)
class SetFinder:
    """Stations of pairs, (p, 3), heights that are expected, and what counts as a set.

    A set has detections of `fewest_pairs`, at least three; `covers` says of places (n, 3) whether
    the sensor reports them.
    """

    transmitters_m: Floats
    receivers_m: Floats
    height_m: float
    sigma_height_m: float
    fewest_pairs: int
    covers: Callable[[Floats], Bools]

    @cached_property
    def _triples(self) -> list[tuple[int, int, int]]:
        """Pairs with which sets begin: of every set that is large enough, one at least."""
        first = len(self.receivers_m) - self.fewest_pairs + 3
        return list(combinations(range(first), 3))[:MOST_TRIPLES]

    def sightings(self, found: list[Detections], sets: Ints) -> Sightings:
        """What sets of detections measured: (h, p) indices by pair, -1 for none."""
        columns = {}
        for name in ("sum_m", "azimuth_deg", "elevation_deg"):
            for column in (name, f"sigma_{name}"):
                values = [np.append(getattr(f, column), np.nan) for f in found]
                columns[column] = np.stack([v[s] for v, s in zip(values, sets.T, strict=True)], 1)
        return Sightings(
            transmitters_m=self.transmitters_m,
            receivers_m=self.receivers_m,
            height_m=self.height_m,
            sigma_height_m=self.sigma_height_m,
            **columns,
        )

    def joined(self, found: list[Detections]) -> JoinedSets | None:
        """All sets that fit, none of which is part of another; None if none does."""
        sets, place_m = np.zeros((0, len(found)), np.int64), np.zeros((0, 3))
        for triple in self._triples:
            begun, where_m = self._begun(found, triple, sets)
            begun, where_m = self._extended(found, begun, where_m)
            sets, place_m = np.concatenate([sets, begun]), np.concatenate([place_m, where_m])
        if not len(sets):
            return None
        sets, first = np.unique(sets, axis=0, return_index=True)
        sets, place_m = self._largest(sets, place_m[first])
        seen = self.sightings(found, sets)
        fit = solved(place_m, seen)
        snr = np.stack([np.append(f.snr, np.nan)[s] for f, s in zip(found, sets.T, strict=True)], 1)
        drone = np.stack(
            [np.append(f.drone, -2)[s] for f, s in zip(found, sets.T, strict=True)], axis=1
        )
        whose = drone.max(axis=1)
        of_one = ((drone == whose[:, None]) | (drone == -2)).all(axis=1)
        return JoinedSets(fit, np.nanmean(snr, axis=1), np.where(of_one, whose, FALSE_ALARM))

    def _begun(
        self, found: list[Detections], triple: tuple[int, int, int], known: Ints
    ) -> tuple[Ints, Floats]:
        """Sets of detections of three pairs that fit, and their places; none that is known."""
        most = int(MOST_SETS ** (1 / 3))
        chosen = [np.argsort(-found[p].snr, kind="stable")[:most] for p in triple]
        picks = np.stack(np.meshgrid(*chosen, indexing="ij"), -1).reshape(-1, 3)
        if len(known):
            is_known = (picks[:, None] == known[:, list(triple)]).all(axis=-1).any(axis=1)
            picks = picks[~is_known]
        sets = np.full((len(picks), len(found)), -1, np.int64)
        sets[:, list(triple)] = picks
        if not len(sets):
            return sets, np.zeros((0, 3))
        of_three = replace(
            self,
            transmitters_m=self.transmitters_m[list(triple)],
            receivers_m=self.receivers_m[list(triple)],
        )
        three = [found[p] for p in triple]
        alike = of_three._look_alike(three, picks)
        sets, picks = sets[alike], picks[alike]
        seen = of_three.sightings(three, picks)
        starts_m, may_fit = of_three._starts_m(seen)
        sets, picks = sets[may_fit], picks[may_fit]
        seen = of_three.sightings(three, picks)
        fit = solved(starts_m[may_fit], seen)
        good = self._fits(fit.square, seen) & self.covers(fit.place_m)
        best = np.flatnonzero(good)[np.argsort(fit.square[good], kind="stable")[:MOST_FITS]]
        return sets[best], fit.place_m[best]

    def _look_alike(self, found: list[Detections], picks: Ints) -> Bools:
        """Whether bearings of sets from one receiver are the same within five sigmas."""
        alike = np.ones(len(picks), np.bool_)
        for a, b in combinations(range(3), 2):
            if (self.receivers_m[a] != self.receivers_m[b]).any():
                continue
            one, other = found[a], found[b]
            off_deg = wrap_180(one.azimuth_deg[:, None] - other.azimuth_deg)
            most_deg = SURE * np.hypot(one.sigma_azimuth_deg[:, None], other.sigma_azimuth_deg)
            alike &= (np.abs(off_deg) <= most_deg)[picks[:, a], picks[:, b]]
        return alike

    def _starts_m(self, seen: Sightings) -> tuple[Floats, Bools]:
        """Nearest points to the other two sums on the ellipse of the first, at expected heights.

        And whether they are so near that a place between two of them may fit.
        """
        width_deg = np.minimum(4 * seen.sigma_azimuth_deg[:, 0] + 1.0, 180.0)
        share = np.linspace(-1.0, 1.0, SEARCHED)
        azimuth_deg = seen.azimuth_deg[:, 0, None] + width_deg[:, None] * share
        transmitter_m, receiver_m = seen.transmitters_m[0], seen.receivers_m[0]
        baseline_m = transmitter_m - receiver_m
        excess_m = seen.sum_m[:, 0, None] - np.linalg.norm(baseline_m)
        height_m = np.full(azimuth_deg.shape, self.height_m - receiver_m[2])
        ground_m = ground_range_m(
            np.broadcast_to(excess_m, azimuth_deg.shape),
            azimuth_deg,
            np.broadcast_to(baseline_m, (*azimuth_deg.shape, 3)),
            height_m,
        )
        points_m = aer_to_enu(azimuth_deg, 0.0, np.nan_to_num(ground_m)) + receiver_m
        points_m[..., 2] = self.height_m
        cost = np.where(np.isnan(ground_m), np.inf, 0.0)
        for p in (1, 2):
            sums_m = range_sums_m(points_m, seen.transmitters_m[[p]], seen.receivers_m[[p]])
            off_m = (seen.sum_m[:, p, None] - sums_m[..., 0]) / seen.sigma_sum_m[:, p, None]
            bearing_deg = enu_to_aer(points_m - seen.receivers_m[p])[0]
            turned = wrap_180(seen.azimuth_deg[:, p, None] - bearing_deg)
            cost += off_m**2 + (np.nan_to_num(turned) / seen.sigma_azimuth_deg[:, p, None]) ** 2
        best, rows = cost.argmin(axis=1), np.arange(len(cost))
        step_m = np.nan_to_num(ground_m[rows, best]) * np.radians(2 * width_deg / (SEARCHED - 1))
        finest_m = seen.sigma_sum_m[:, 1:3].min(axis=1)
        may_fit = cost[rows, best] <= 4 * SURE**2 + 8 * (step_m / finest_m) ** 2
        return np.asarray(points_m[rows, best]), may_fit

    def _extended(
        self, found: list[Detections], sets: Ints, place_m: Floats
    ) -> tuple[Ints, Floats]:
        """Sets with further pairs whose nearest detection fits to their place."""
        for p in range(len(self.receivers_m)):
            open_rows = np.flatnonzero(sets[:, p] < 0)
            if not len(open_rows) or not len(found[p]):
                continue
            stations_m = self.transmitters_m[[p]], self.receivers_m[[p]]
            sums_m = range_sums_m(place_m[open_rows], *stations_m)
            nearest = np.abs(found[p].sum_m - sums_m).argmin(axis=1)
            trial = sets[open_rows].copy()
            trial[:, p] = nearest
            seen = self.sightings(found, trial)
            fit = solved(place_m[open_rows], seen)
            good = self._fits(fit.square, seen)
            sets[open_rows[good]], place_m[open_rows[good]] = trial[good], fit.place_m[good]
        enough = (sets >= 0).sum(axis=1) >= self.fewest_pairs
        return sets[enough], place_m[enough]

    @staticmethod
    def _largest(sets: Ints, place_m: Floats) -> tuple[Ints, Floats]:
        """Sets that are no part of another."""
        held = sets >= 0
        same = (sets[:, None] == sets) | ~held[:, None]
        part = same.all(axis=-1) & (held.sum(axis=1)[:, None] < held.sum(axis=1))
        whole = ~part.any(axis=1)
        return sets[whole], place_m[whole]

    @staticmethod
    def _fits(square: Floats, seen: Sightings) -> Bools:
        return np.asarray(square <= chdtri(seen.rows(), OUTSIDE))

"""Which detections of pairs of stations are of one target: sets that fit to a place.

Sets begin with three pairs, whose place is found on the ellipse of the first; further pairs join if
they fit. Sets of several targets that fit by chance are ghosts. What two pairs have to say of each
other is worked out once, for all of their detections, and all sets of a scan are fitted together.

Places are by least squares from sums of ranges, directions and what is known of heights. A pair of
transmitter and receiver measures |x - tx| + |x - rx|, whose gradient is the sum of the unit vectors
from both. Stations near the ground leave heights open, up to a kilometre: so heights are expected
to be normal about a mean, as one more measurement. Steps are those of Gauss and Newton by QR, which
keeps twice the digits that normal equations do; the covariance is (J'J)^-1 of rows over their
standard deviations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from plotfeed.models.frames import aer_to_enu, enu_to_aer, wrap_180
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.sensors.bistatic_places import ground_range_m
from plotfeed.models.state import FALSE_ALARM, Bools, Columns, Floats, Ints

STEPS = 8  # Of Gauss and Newton, from a start that is as near as a search finds
LONGEST_STEP_M = 3000.0
LOST = 1e12  # Standard deviation, in units of a row, of what was not measured


@dataclass(frozen=True, slots=True, kw_only=True)
class Sightings:
    """What pairs measured of places, (h, p, 3), and standard deviations; stations are (p, 3).

    That is the sum of ranges, m, and directions seen from the receivers, azimuth and elevation,
    degrees; NaN for what they did not measure. Heights are expected above the origin.
    """

    transmitters_m: Floats
    receivers_m: Floats
    measured: Floats
    sigmas: Floats
    height_m: float
    sigma_height_m: float

    def rows(self) -> Ints:
        """How many rows each place has beyond the three that it takes; (h,)."""
        measured: Ints = np.count_nonzero(~np.isnan(self.measured), axis=(1, 2))
        return measured + 1 - 3


@dataclass(frozen=True, slots=True)
class Solved:
    """Places (h, 3), their covariances (h, 3, 3) and sums of squares of residuals (h,)."""

    place_m: Floats
    covariance_m2: Floats
    square: Floats


def range_sums_m(place_m: Floats, transmitters_m: Floats, receivers_m: Floats) -> Floats:
    """Ways from transmitters by places to receivers; (..., 3), (p, 3), (p, 3) in, (..., p) out."""
    place_m = place_m[..., None, :]
    out = np.linalg.norm(place_m - transmitters_m, axis=-1)
    return np.asarray(out + np.linalg.norm(place_m - receivers_m, axis=-1))


@nan_without_warnings
def solved(start_m: Floats, seen: Sightings) -> Solved:
    """Places nearest to what was measured, from starts (h, 3)."""
    place_m = start_m.copy()
    for _ in range(STEPS):
        jacobian, residual = linearised(place_m, seen)
        q, r = _orthogonal(jacobian)
        step_m = _upper_solved(r, np.einsum("hri,hr->hi", q, residual))
        length_m = np.linalg.norm(step_m, axis=-1, keepdims=True)
        place_m += np.nan_to_num(step_m * np.minimum(1.0, LONGEST_STEP_M / (length_m + 1e-9)))
    jacobian, residual = linearised(place_m, seen)
    return Solved(place_m, covariance(jacobian), (residual**2).sum(axis=1))


@nan_without_warnings
def covariance(jacobian: Floats) -> Floats:
    """(J'J)^-1 of scaled rows, by QR; (h, rows, 3) in, (h, 3, 3) out."""
    _, r = _orthogonal(jacobian)
    inverse = np.stack([_upper_solved(r, np.broadcast_to(e, (len(r), 3))) for e in np.eye(3)], -1)
    return np.asarray(inverse @ np.swapaxes(inverse, -1, -2))


@nan_without_warnings
def linearised(place_m: Floats, seen: Sightings) -> tuple[Floats, Floats]:
    """Jacobians and residuals over their standard deviations; (h, rows, 3) and (h, rows)."""
    from_rx = place_m[:, None] - seen.receivers_m
    from_tx = place_m[:, None] - seen.transmitters_m
    range_m = np.linalg.norm(from_rx, axis=-1)
    other_m = np.linalg.norm(from_tx, axis=-1)
    toward = from_rx / range_m[..., None]
    ground_m = np.hypot(from_rx[..., 0], from_rx[..., 1])
    azimuth = np.arctan2(from_rx[..., 0], from_rx[..., 1])
    elevation = np.arctan2(from_rx[..., 2], ground_m)
    right = np.stack([np.cos(azimuth), -np.sin(azimuth), np.zeros_like(azimuth)], axis=-1)
    above = np.stack(
        [
            -np.sin(azimuth) * np.sin(elevation),
            -np.cos(azimuth) * np.sin(elevation),
            np.cos(elevation),
        ],
        axis=-1,
    )
    h = len(place_m)
    up = np.broadcast_to([0.0, 0.0, 1.0], (h, 1, 3))
    sum_m, azimuth_deg, elevation_deg = np.moveaxis(seen.measured, -1, 0)
    sigma_sum_m, *of_angles_deg = np.moveaxis(seen.sigmas, -1, 0)
    sigma_azimuth, sigma_elevation = np.radians(of_angles_deg)
    off_azimuth = np.radians(wrap_180(azimuth_deg - np.degrees(azimuth)))
    off_elevation = np.radians(elevation_deg - np.degrees(elevation))
    parts = [
        (toward + from_tx / other_m[..., None], sum_m - range_m - other_m, sigma_sum_m),
        (right / ground_m[..., None], off_azimuth, sigma_azimuth),
        (above / range_m[..., None], off_elevation, sigma_elevation),
        (up, seen.height_m - place_m[:, 2:], np.full((h, 1), seen.sigma_height_m)),
    ]
    known = [np.where(np.isnan(part[1]), LOST, part[2]) for part in parts]
    jacobian = np.concatenate(
        [part[0] / sigma[..., None] for part, sigma in zip(parts, known, strict=True)], axis=1
    )
    residual = np.concatenate(
        [np.nan_to_num(part[1]) / sigma for part, sigma in zip(parts, known, strict=True)], axis=1
    )
    return jacobian, residual


def _orthogonal(jacobian: Floats) -> tuple[Floats, Floats]:
    """Q and R of (h, rows, 3), by Gram and Schmidt in their modified form: many at once."""
    q, r = jacobian.copy(), np.zeros((len(jacobian), 3, 3))
    for i in range(3):
        r[:, i, i] = np.sqrt(np.einsum("hr,hr->h", q[:, :, i], q[:, :, i]))
        q[:, :, i] /= r[:, i, i, None]
        for j in range(i + 1, 3):
            r[:, i, j] = np.einsum("hr,hr->h", q[:, :, i], q[:, :, j])
            q[:, :, j] -= r[:, i, j, None] * q[:, :, i]
    return q, r


def _upper_solved(r: Floats, b: Floats) -> Floats:
    """Solutions of upper triangular equations; (h, 3, 3) and (h, 3) in, NaN where there is none."""
    x = np.empty(b.shape)
    x[:, 2] = b[:, 2] / r[:, 2, 2]
    x[:, 1] = (b[:, 1] - r[:, 1, 2] * x[:, 2]) / r[:, 1, 1]
    x[:, 0] = (b[:, 0] - r[:, 0, 1] * x[:, 1] - r[:, 0, 2] * x[:, 2]) / r[:, 0, 0]
    return x


OUTSIDE = 0.0027  # Of right sets, the share that a gate of three sigmas leaves out
MOST_DETECTIONS = 64  # Of a pair, with which sets begin: of more, the strongest alone
# That are tried for each three pairs: of more, those that are nearest to each other.
MOST_SETS = 20_000
MOST_TRIPLES = 35
SURE = 5.0  # Sigmas beyond which nothing is tried
SEARCHED = 91  # Points of an ellipse
MOST_FITS = 2000  # Places that are kept of the sets that begin in a scan, the best ones
NONE = -1  # In a set, of a pair that does not belong to it


@dataclass(frozen=True, kw_only=True)
class Detections(Columns):
    """What a pair measured in a scan, (n, 3) as in `Sightings`, a row a detection."""

    measured: Floats
    sigmas: Floats
    snr: Floats
    drone: Ints


@dataclass(frozen=True, slots=True)
class JoinedSets:
    """Places of sets of detections, their mean ratios, and whose they are; (h,)."""

    fit: Solved
    snr: Floats
    drone: Ints
    """A false alarm's where detections are of several drones, or of none."""


@dataclass(frozen=True, slots=True)
class _Ellipses:
    """Points where the targets of a pair's detections may be, at the expected height.

    Of n detections: places (n, S, 3), how far each is from the next, and whether there is one of
    that height, (n, S).
    """

    points_m: Floats
    step_m: Floats
    is_there: Bools


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
        """What sets of detections measured: (h, p) indices by pair, `NONE` for none."""
        return Sightings(
            transmitters_m=self.transmitters_m,
            receivers_m=self.receivers_m,
            measured=_of_sets([f.measured for f in found], sets, np.nan),
            sigmas=_of_sets([f.sigmas for f in found], sets, np.nan),
            height_m=self.height_m,
            sigma_height_m=self.sigma_height_m,
        )

    def joined(self, found: list[Detections]) -> JoinedSets | None:
        """All sets that fit, none of which is part of another; None if none does."""
        sets, place_m = self._extended(found, *self._begun(found))
        if not len(sets):
            return None
        sets, place_m = _largest(sets, place_m)
        fit = solved(place_m, self.sightings(found, sets))
        snr = _of_sets([f.snr for f in found], sets, np.nan)
        drone = _of_sets([f.drone for f in found], sets, FALSE_ALARM - 1)
        whose = drone.max(axis=1)
        of_one = ((drone == whose[:, None]) | (drone == FALSE_ALARM - 1)).all(axis=1)
        return JoinedSets(fit, np.nanmean(snr, axis=1), np.where(of_one, whose, FALSE_ALARM))

    def _begun(self, found: list[Detections]) -> tuple[Ints, Floats]:
        """Sets of detections of three pairs that fit, and their places."""
        chosen = [np.argsort(-f.snr, kind="stable")[:MOST_DETECTIONS] for f in found]
        strongest = [f.rows(np.sort(which)) for f, which in zip(found, chosen, strict=True)]
        ellipses: dict[int, _Ellipses] = {}
        misses: dict[tuple[int, int], Floats] = {}
        every_set, every_start = [], []
        for a, b, c in self._triples:
            if not all(len(strongest[p]) for p in (a, b, c)):
                continue
            if a not in ellipses:
                ellipses[a] = self._ellipses(strongest[a], a)
            for p in (b, c):
                if (a, p) not in misses:
                    misses[a, p] = self._misses(ellipses[a], strongest, a, p)
            picks, starts_m = self._nearest(strongest, (a, b, c), ellipses[a], misses)
            sets = np.full((len(picks), len(found)), NONE, np.int64)
            for column, p in enumerate((a, b, c)):
                sets[:, p] = np.sort(chosen[p])[picks[:, column]]
            every_set.append(sets)
            every_start.append(starts_m)
        if not every_set:
            return np.zeros((0, len(found)), np.int64), np.zeros((0, 3))
        sets, starts_m = np.concatenate(every_set), np.concatenate(every_start)
        seen = self.sightings(found, sets)
        fit = solved(starts_m, seen)
        good = _fits(fit.square, seen) & self.covers(fit.place_m)
        best = np.flatnonzero(good)[np.argsort(fit.square[good], kind="stable")[:MOST_FITS]]
        return sets[best], fit.place_m[best]

    def _ellipses(self, detections: Detections, pair: int) -> _Ellipses:
        """Where the targets of a pair's detections may be, in and about their bearings."""
        width_deg = np.minimum(4 * detections.sigmas[:, 1] + 1.0, 180.0)
        share = np.linspace(-1.0, 1.0, SEARCHED)
        azimuth_deg = detections.measured[:, 1, None] + width_deg[:, None] * share
        receiver_m = self.receivers_m[pair]
        baseline_m = self.transmitters_m[pair] - receiver_m
        excess_m = detections.measured[:, :1] - np.linalg.norm(baseline_m)
        ground_m = ground_range_m(
            np.broadcast_to(excess_m, azimuth_deg.shape),
            azimuth_deg,
            np.broadcast_to(baseline_m, (*azimuth_deg.shape, 3)),
            np.full(azimuth_deg.shape, self.height_m - receiver_m[2]),
        )
        points_m = aer_to_enu(azimuth_deg, 0.0, np.nan_to_num(ground_m)) + receiver_m
        points_m[..., 2] = self.height_m
        apart = np.radians(2 * width_deg / (SEARCHED - 1))
        return _Ellipses(points_m, np.nan_to_num(ground_m) * apart[:, None], ~np.isnan(ground_m))

    def _misses(self, of: _Ellipses, found: list[Detections], a: int, b: int) -> Floats:
        """Squares by which points of the one pair's ellipses miss what the other measured.

        In standard deviations; (n_a, n_b, S), infinite where there is no point, or where bearings
        of one receiver are not alike.
        """
        one, other = found[a], found[b]
        sums_m = range_sums_m(of.points_m, self.transmitters_m[[b]], self.receivers_m[[b]])
        bearing_deg = enu_to_aer(of.points_m - self.receivers_m[b])[0]
        off = (other.measured[:, :1] - sums_m[:, None, :, 0]) / other.sigmas[:, :1]
        turned = wrap_180(other.measured[:, 1, None] - bearing_deg[:, None])
        square = off**2 + (np.nan_to_num(turned) / other.sigmas[:, 1, None]) ** 2
        missed = np.where(of.is_there[:, None], square, np.inf)
        missed[~self._look_alike(one, other, a, b)] = np.inf
        return np.asarray(missed)

    def _look_alike(self, one: Detections, other: Detections, a: int, b: int) -> Bools:
        """Whether bearings of two pairs are the same within five sigmas; (n_a, n_b).

        True of all if they are seen from different receivers.
        """
        if (self.receivers_m[a] != self.receivers_m[b]).any():
            return np.ones((len(one), len(other)), np.bool_)
        off_deg = wrap_180(one.measured[:, 1, None] - other.measured[:, 1])
        most_deg = SURE * np.hypot(one.sigmas[:, 1, None], other.sigmas[:, 1])
        return np.asarray(np.abs(off_deg) <= most_deg)

    def _nearest(
        self,
        found: list[Detections],
        triple: tuple[int, int, int],
        of: _Ellipses,
        misses: dict[tuple[int, int], Floats],
    ) -> tuple[Ints, Floats]:
        """Detections of three pairs that may fit, (m, 3), and the nearest points, (m, 3).

        Those with a point on the ellipse of the first which misses the other two by so little that
        a place between two points may fit.
        """
        a, b, c = triple
        to_b, to_c = misses[a, b], misses[a, c]
        sigma_b_m, sigma_c_m = found[b].sigmas[:, 0], found[c].sigmas[:, 0]
        longest_m, least_b, least_c = of.step_m.max(axis=1), to_b.min(axis=2), to_c.min(axis=2)
        # First what two of them exclude, by the longest step and the least error there may be.
        finest_m = min(sigma_b_m.min(), sigma_c_m.min())
        most = _allowed(longest_m, finest_m)[:, None]
        may_be = (least_b <= most)[:, :, None] & (least_c <= most)[:, None, :]
        may_be &= self._look_alike(found[b], found[c], b, c)
        i, j, k = np.nonzero(may_be)
        if len(i) > MOST_SETS:
            of_both = least_b[i, j] + least_c[i, k]
            kept = np.sort(np.argsort(of_both, kind="stable")[:MOST_SETS])
            i, j, k = i[kept], j[kept], k[kept]
        missed = to_b[i, j] + to_c[i, k]
        best, rows = missed.argmin(axis=1), np.arange(len(i))
        finest_of_m = np.minimum(sigma_b_m[j], sigma_c_m[k])
        may_fit = missed[rows, best] <= _allowed(of.step_m[i, best], finest_of_m)
        return np.stack([i, j, k], axis=-1)[may_fit], of.points_m[i, best][may_fit]

    def _extended(
        self, found: list[Detections], sets: Ints, place_m: Floats
    ) -> tuple[Ints, Floats]:
        """Sets with further pairs whose nearest detection fits to their place; each once."""
        for p in range(len(self.receivers_m)):
            open_rows = np.flatnonzero(sets[:, p] == NONE)
            if not len(open_rows) or not len(found[p]):
                continue
            stations_m = self.transmitters_m[[p]], self.receivers_m[[p]]
            sums_m = range_sums_m(place_m[open_rows], *stations_m)
            nearest = np.abs(found[p].measured[:, 0] - sums_m).argmin(axis=1)
            trial = sets[open_rows].copy()
            trial[:, p] = nearest
            seen = self.sightings(found, trial)
            fit = solved(place_m[open_rows], seen)
            good = _fits(fit.square, seen)
            sets[open_rows[good]], place_m[open_rows[good]] = trial[good], fit.place_m[good]
            sets, first = np.unique(sets, axis=0, return_index=True)
            place_m = place_m[first]
        enough = (sets != NONE).sum(axis=1) >= self.fewest_pairs
        return sets[enough], place_m[enough]


def _allowed(step_m: Floats, sigma_m: Floats | float) -> Floats:
    """Squares that a point may miss by where others are so far away: five sigmas of each of two."""
    return np.asarray(4 * SURE**2 + 8 * (step_m / sigma_m) ** 2)


def _of_sets(columns: list[NDArray[Any]], sets: Ints, nothing: float) -> NDArray[Any]:
    """Values of detections of sets, a column a pair; (h, p, ...)."""
    nobody = np.full((1, *columns[0].shape[1:]), nothing)
    values = [np.concatenate([column, nobody]) for column in columns]
    return np.stack([v[s] for v, s in zip(values, sets.T, strict=True)], axis=1)


def _largest(sets: Ints, place_m: Floats) -> tuple[Ints, Floats]:
    """Sets that are no part of another."""
    held = sets != NONE
    size = held.sum(axis=1)
    small = np.flatnonzero(size < sets.shape[1])
    same = (sets[small, None] == sets) | ~held[small, None]
    part = (same.all(axis=-1) & (size[small, None] < size)).any(axis=1)
    whole = np.ones(len(sets), np.bool_)
    whole[small[part]] = False
    return sets[whole], place_m[whole]


def _fits(square: Floats, seen: Sightings) -> Bools:
    return np.asarray(square <= chdtri(seen.rows(), OUTSIDE))

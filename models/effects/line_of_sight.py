"""What stands in the way: ground and walls, horizons of places, and what is left behind them.

Of a place, the highest slope of ground and walls up to each distance is known by azimuth: a ray is
free if it leaves the place more steeply than all that lies before its end. Air that bends rays is
an Earth of a larger radius (ITU-R P.834): in true east, north and up everything is raised by
d^2/2a (1 - 1/k), by d^2/8a at k = 4/3.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plotfeed.models.frames import Axes, LocalFrame, geodetic_to_ecef, wrap_180
from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.propagation import USUAL_K
from plotfeed.models.state import Floats, Ints


@dataclass(frozen=True, eq=False, kw_only=True)
class ElevationTile:
    """A raster of heights, metres, rows southwards and columns eastwards, in degrees of WGS-84.

    The first sample is at `north_deg` and `west_deg`; `void` is the value of what is not known.
    """

    heights_m: NDArray[Any]
    north_deg: float
    west_deg: float
    row_step_deg: float
    column_step_deg: float
    void: float = np.nan

    def height_m(self, latitude_deg: Floats, longitude_deg: Floats) -> Floats:
        """Heights between the four samples about each place, bilinear; NaN outside or at a void."""
        rows, columns = self.heights_m.shape
        down = (self.north_deg - latitude_deg) / self.row_step_deg
        right = (longitude_deg - self.west_deg) / self.column_step_deg
        inside = (down >= 0) & (down <= rows - 1) & (right >= 0) & (right <= columns - 1)
        found_m = np.full(latitude_deg.shape, np.nan)
        down, right = down[inside], right[inside]
        row = np.minimum(down.astype(np.int64), max(rows - 2, 0))
        column = np.minimum(right.astype(np.int64), max(columns - 2, 0))
        found_m[inside] = self._between(row, column, down - row, right - column)
        return found_m

    def _between(
        self, row: NDArray[Any], column: NDArray[Any], down: Floats, right: Floats
    ) -> Floats:
        height_m = np.zeros(len(row))
        last_row, last_column = (n - 1 for n in self.heights_m.shape)
        for i, by_row in ((0, 1 - down), (1, down)):
            for j, by_column in ((0, 1 - right), (1, right)):
                at = np.minimum(row + i, last_row), np.minimum(column + j, last_column)
                corner = self.heights_m[at].astype(np.float64)
                corner[corner == self.void] = np.nan
                height_m += corner * by_row * by_column
        return height_m


@dataclass(frozen=True, eq=False)
class Ground:
    """Several rasters: where they overlap, the first one that knows.

    `undulation_m` is added, by latitudes and longitudes: what heights are counted from may be the
    sea.
    """

    tiles: Sequence[ElevationTile]
    undulation_m: Callable[[Floats, Floats], Floats] | None = None

    def height_m(self, latitude_deg: Floats, longitude_deg: Floats) -> Floats:
        """Heights at places, metres above the ellipsoid; NaN where none knows."""
        found_m = np.full(latitude_deg.shape, np.nan)
        for tile in self.tiles:
            open_ = np.isnan(found_m)
            if not open_.any():
                break
            found_m[open_] = tile.height_m(latitude_deg[open_], longitude_deg[open_])
        if self.undulation_m is not None:
            known = ~np.isnan(found_m)
            found_m[known] += self.undulation_m(latitude_deg[known], longitude_deg[known])
        return found_m


@dataclass(frozen=True, eq=False)
class Walls:
    """The upper edges of walls, ECEF, metres: from, and to; (n, 3) each."""

    from_ecef_m: Floats
    to_ecef_m: Floats

    @classmethod
    def of_rings(cls, rings: Sequence[Floats], tops_m: Sequence[float]) -> Walls:
        """Walls of footprints: rings of longitude and latitude, (k, 2), each up to a height.

        Rings may repeat their first corner at the end; heights are above the ellipsoid.
        """
        if not rings:
            return cls(np.zeros((0, 3)), np.zeros((0, 3)))
        lengths = [len(ring) for ring in rings]
        corners = np.concatenate(rings)
        heights_m = np.repeat(as_floats(tops_m), lengths)
        ecef_m = geodetic_to_ecef(corners[:, 1], corners[:, 0], heights_m)
        ends = np.cumsum(lengths)
        following = np.arange(len(corners)) + 1
        following[ends - 1] = ends - lengths
        return cls(ecef_m, ecef_m[following])

    def __len__(self) -> int:
        return len(self.from_ecef_m)


EARTH_RADIUS_M = 6_371_000.0
# What is left of a power that is cut off: 200 dB less, so that its level still is a number.
OPAQUE = 1e-20
STEEPEST = 1e3  # Slope of what stands at the very place
APART_M = 4e6  # Between azimuths, on the one axis on which horizons are searched
NEAREST_M = 0.5
AT_ONCE = 1 << 19  # Samples of the ground, or crossings, that are worked out together
# Of rays and walls about one place; the houses of a whole city are some millions.
MOST_CROSSINGS = 1 << 25
HORIZONTAL_M = 1e-3


@nan_without_warnings
def knife_edge_loss_db(nu: ArrayLike) -> Floats:
    """Loss behind one sharp edge, dB, by the parameter of Fresnel; (...).

    ITU-R P.526, 4.1: within 0.13 dB of Fresnel's integral where nu is above -0.78, and 0 below.
    """
    beyond = as_floats(nu) - 0.1
    loss_db = 6.9 + 20 * np.log10(np.hypot(beyond, 1) + beyond)
    return np.where(as_floats(nu) > -0.78, loss_db, 0.0)


@dataclass(frozen=True, eq=False)
class Horizon:
    """The staircase of slopes about a place, by azimuth and distance, each step above the last.

    `azimuth` counts equal parts of the circle from north, of which there are `azimuths`; columns
    are in its order, then in that of distance, (n,).
    """

    azimuths: int
    azimuth: Ints
    distance_m: Floats
    slope: Floats

    @cached_property
    def _places(self) -> tuple[Floats, Floats, Floats]:
        """Where steps begin on one axis of all azimuths, and what holds from there."""
        numbers = np.arange(self.azimuths)
        azimuth = np.concatenate([numbers, self.azimuth])
        distance_m = np.concatenate([np.zeros(self.azimuths), self.distance_m])
        slope = np.concatenate([np.full(self.azimuths, -np.inf), self.slope])
        place = azimuth * APART_M + distance_m
        order = np.argsort(place, kind="stable")
        return place[order], distance_m[order], slope[order]

    def before(self, azimuth_deg: Floats, ground_m: Floats) -> tuple[Floats, Floats]:
        """Distance and slope of the highest thing before those distances; (...) each.

        -inf where there is nothing, or no azimuth.
        """
        place, distance_m, slope = self._places
        number = np.floor(np.nan_to_num(azimuth_deg) * (self.azimuths / 360)) % self.azimuths
        wanted = number * APART_M + np.clip(ground_m, HORIZONTAL_M, APART_M / 2)
        found = np.searchsorted(place, wanted) - 1
        return distance_m[found], slope[found]


@dataclass(frozen=True, kw_only=True)
class HorizonSettings:
    """How finely horizons are traced, and how far."""

    azimuths: int
    step_m: float
    reach_m: float
    k: float = USUAL_K


def raise_per_m2(k: float) -> float:
    """What bent rays make of distances: metres up by square metre of them."""
    return (1 - 1 / k) / (2 * EARTH_RADIUS_M)


def horizon_of(
    frame: LocalFrame, ground: Ground | None, walls: Walls | None, settings: HorizonSettings
) -> Horizon:
    """The horizon of a place by the ground, heights above the ellipsoid, and walls.

    Raises `ValueError` where there are more walls about it than can be worked out.
    """
    parts = []
    if ground is not None:
        parts += list(_steps_of_ground(frame, ground, settings))
    if walls is not None and len(walls):
        parts += [_staircase(some) for some in _crossings(frame, walls, settings)]
    if not parts:
        parts = [(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))]
    columns = zip(*parts, strict=True)
    azimuth, distance_m, slope = _staircase(tuple(np.concatenate(c) for c in columns))
    return Horizon(settings.azimuths, azimuth, _single(distance_m), _single(slope))


def _staircase(steps: tuple[Any, ...]) -> tuple[Ints, Floats, Floats]:
    """Steps that stand above all before them, in the order of azimuth and distance."""
    azimuth, distance_m, slope = steps
    order = np.lexsort((distance_m, azimuth))
    azimuth, distance_m, slope = azimuth[order], distance_m[order], slope[order]
    # Azimuths apart by more than slopes ever are: one running maximum is that of each.
    shifted = np.clip(slope, -STEEPEST, STEEPEST) + azimuth * (4 * STEEPEST)
    highest = np.maximum.accumulate(shifted) if len(shifted) else shifted
    is_step = np.ones(len(shifted), np.bool_)
    is_step[1:] = highest[1:] > highest[:-1]
    return azimuth[is_step], distance_m[is_step], slope[is_step]


def _single(values: Floats) -> Floats:
    """Values to 24 bits, a tenth of a millimetre a kilometre: half as much to keep."""
    return values.astype(np.float32).astype(np.float64)


def _steps_of_ground(
    frame: LocalFrame, ground: Ground, settings: HorizonSettings
) -> Sequence[tuple[Ints, Floats, Floats]]:
    """Steps of the staircases of rays over the ground, some azimuths at a time."""
    distance_m = np.arange(settings.step_m, settings.reach_m + settings.step_m, settings.step_m)
    numbers = np.arange(settings.azimuths)
    rays = max(AT_ONCE // len(distance_m), 1)
    found = []
    for first in range(0, settings.azimuths, rays):
        azimuth = numbers[first : first + rays]
        angle = (azimuth + 0.5) * (2 * np.pi / settings.azimuths)
        east, north = (np.outer(f(angle), distance_m) for f in (np.sin, np.cos))
        level = -(distance_m**2) / (2 * EARTH_RADIUS_M)
        up = np.broadcast_to(level, east.shape)
        latitude_deg, longitude_deg, height_m = frame.to_geodetic(np.stack([east, north, up], -1))
        ground_m = ground.height_m(latitude_deg, longitude_deg)
        above = up + (ground_m - height_m)
        slope = above / distance_m + raise_per_m2(settings.k) * distance_m
        slope = np.where(np.isnan(slope), -np.inf, slope)
        highest = np.maximum.accumulate(slope, axis=1)
        is_step = np.isfinite(slope)
        is_step[:, 1:] &= highest[:, 1:] > highest[:, :-1]
        ray, sample = np.nonzero(is_step)
        found.append((azimuth[ray], distance_m[sample], slope[ray, sample]))
    return found


def _crossings(
    frame: LocalFrame, walls: Walls, settings: HorizonSettings
) -> Iterator[tuple[Ints, Floats, Floats]]:
    """Where rays from a place cross walls: so a ray is compared where it enters and leaves.

    Some walls at a time; raises `ValueError` where there are too many crossings.
    """
    start, end = frame.from_ecef(walls.from_ecef_m), frame.from_ecef(walls.to_ecef_m)
    per_deg = settings.azimuths / 360
    from_deg, to_deg = (np.degrees(np.arctan2(p[:, 0], p[:, 1])) for p in (start, end))
    turn_deg = wrap_180(to_deg - from_deg)
    low_deg = np.where(turn_deg < 0, to_deg, from_deg)
    first = np.ceil(low_deg * per_deg - 0.5).astype(np.int64)
    last = np.ceil((low_deg + np.abs(turn_deg)) * per_deg - 0.5).astype(np.int64)
    count = last - first
    if count.sum() > MOST_CROSSINGS:
        raise ValueError(f"walls are crossed {count.sum()} times, at most {MOST_CROSSINGS}")
    group = np.cumsum(count) // AT_ONCE
    for some in np.split(np.arange(len(count)), np.flatnonzero(np.diff(group)) + 1):
        yield _crossed(start[some], end[some], first[some], count[some], settings)


@nan_without_warnings
def _crossed(
    start: Floats, end: Floats, first: Ints, count: Ints, settings: HorizonSettings
) -> tuple[Ints, Floats, Floats]:
    """Azimuths, distances and slopes where each of those walls is crossed by `count` rays."""
    wall = np.repeat(np.arange(len(count)), count)
    number = first[wall] + np.arange(len(wall)) - (np.cumsum(count) - count)[wall]
    angle = (number + 0.5) * (2 * np.pi / settings.azimuths)
    east, north = np.sin(angle), np.cos(angle)
    here, along = start[wall], end[wall] - start[wall]
    share = -(east * here[:, 1] - north * here[:, 0]) / (east * along[:, 1] - north * along[:, 0])
    place = here + np.clip(share, 0.0, 1.0)[:, None] * along
    distance_m = place[:, 0] * east + place[:, 1] * north
    near = (distance_m > NEAREST_M) & (distance_m < settings.reach_m)
    distance_m = distance_m[near]
    slope = place[near, 2] / distance_m + raise_per_m2(settings.k) * distance_m
    return number[near] % settings.azimuths, distance_m, slope


@dataclass(frozen=True, eq=False, kw_only=True)
class Obstruction:
    """Horizons of a sensor and of its transmitters, which are at `ends_enu_m`, (m, 3), of it.

    With `diffracts`, what lies in the way weakens by the one edge that stands highest before the
    end; without, it cuts off all.
    """

    frames: tuple[Axes, ...]
    horizons: tuple[Horizon, ...]
    diffracts: bool
    k: float = USUAL_K

    @nan_without_warnings
    def power_factor(
        self, place_enu_m: Floats, wavelength_m: ArrayLike, from_enu_m: ArrayLike = (0.0, 0.0, 0.0)
    ) -> Floats:
        """Factor of power one way, of places (..., 3) from one of its ends; (...) out."""
        which, from_m = 0, as_floats(from_enu_m)
        if len(self.horizons) > 1 and from_m.any():
            ends_m = np.array([self.frames[0].from_ecef(f.origin_ecef_m) for f in self.frames])
            which = int(np.argmin(((ends_m - from_m.reshape(-1, 3)[0]) ** 2).sum(axis=1)))
        if which:
            place_enu_m = self.frames[which].from_ecef(self.frames[0].to_ecef(place_enu_m))
        east, north, up = place_enu_m[..., 0], place_enu_m[..., 1], place_enu_m[..., 2]
        ground_m = np.maximum(np.sqrt(east * east + north * north), HORIZONTAL_M)
        azimuth_deg = np.degrees(np.arctan2(east, north)) % 360
        edge_m, edge_slope = self.horizons[which].before(azimuth_deg, ground_m)
        over = edge_slope - (up / ground_m + raise_per_m2(self.k) * ground_m)
        if not self.diffracts:
            return np.where(over > 0, OPAQUE, 1.0)
        reciprocals = ground_m / (edge_m * (ground_m - edge_m))
        nu = edge_m * over * np.sqrt(2 * reciprocals / as_floats(wavelength_m))
        lost_db = knife_edge_loss_db(nu)
        return np.where(np.isnan(lost_db), 1.0, 10 ** (-lost_db / 10))

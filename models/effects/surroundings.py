"""What the world does to signals on their way, whatever it is made of: one factor of power."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models import special
from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.propagation import two_ray_factor
from plotfeed.models.state import Bools, Floats

HERE = (0.0, 0.0, 0.0)
SHARPEST_M = 1e-9  # A wavelength that bends over nothing
# Power beyond which what is left has come straight: an edge that it grazes leaves a quarter.
SEEN = 0.2


class OnTheWay(Protocol):
    """Something that weakens, or strengthens, what passes."""

    def power_factor(
        self, place_enu_m: Floats, wavelength_m: ArrayLike, from_enu_m: ArrayLike = HERE
    ) -> Floats:
        """Factor of power one way between places, (..., 3), east, north and up; (...) out."""


@dataclass(frozen=True)
class Surroundings:
    """All that a sensor's signals meet, at least one thing: the product of what each leaves."""

    things: tuple[OnTheWay, ...]

    def power_factor(
        self, place_enu_m: Floats, wavelength_m: ArrayLike, from_enu_m: ArrayLike = HERE
    ) -> Floats:
        """Factor of power one way between places, (..., 3), east, north and up; (...) out."""
        factor = self.things[0].power_factor(place_enu_m, wavelength_m, from_enu_m)
        for thing in self.things[1:]:
            factor = factor * thing.power_factor(place_enu_m, wavelength_m, from_enu_m)
        return factor

    def let_see(self, place_enu_m: Floats) -> Bools:
        """Whether nothing stands in the straight way to places, (..., 3); (...)."""
        return np.asarray(self.power_factor(place_enu_m, SHARPEST_M) > SEEN)


@dataclass(frozen=True)
class SeenFrom:
    """What is on the way as it is met elsewhere, by places east, north and up of there.

    Of a sensor of several stations: surroundings are known by places seen from the first.
    """

    things: OnTheWay
    place_enu_m: tuple[float, float, float]

    def power_factor(
        self, place_enu_m: Floats, wavelength_m: ArrayLike, from_enu_m: ArrayLike = HERE
    ) -> Floats:
        """Factor of power one way between places, (..., 3), east, north and up; (...) out."""
        here_m = np.array(self.place_enu_m)
        start_m = as_floats(from_enu_m) + here_m
        return self.things.power_factor(place_enu_m + here_m, wavelength_m, start_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Multipath:
    """Two rays over flat ground of a reflection coefficient, -1 to 1, so far below the antenna.

    The antenna is taken to radiate and to hear as much along either ray.
    """

    reflection: float
    antenna_height_m: float

    def power_factor(
        self, place_enu_m: Floats, wavelength_m: ArrayLike, from_enu_m: ArrayLike = HERE
    ) -> Floats:
        """Factor of power one way between places, (..., 3), east, north and up; (...) out."""
        other_enu_m = as_floats(from_enu_m)
        offset_m = place_enu_m - other_enu_m
        return two_ray_factor(
            self.antenna_height_m + other_enu_m[..., 2],
            self.antenna_height_m + place_enu_m[..., 2],
            np.hypot(offset_m[..., 0], offset_m[..., 1]),
            wavelength_m,
            self.reflection,
        )


NEAREST_M = 1.0  # Nearer to a tower than this along the ray, nothing stands before it


@dataclass(frozen=True)
class Pillar:
    """A tower east and north of the sensor, up to its top, so wide, metres."""

    top_enu_m: tuple[float, float, float]
    width_m: float

    @nan_without_warnings
    def power_factor(
        self, place_enu_m: Floats, wavelength_m: ArrayLike, from_enu_m: ArrayLike = HERE
    ) -> Floats:
        """Factor of power one way between places (..., 3), by Fresnel's integral past both edges.

        |1 - (1 + j)/2 (C - jS)|^2 between the edges, for rays below the top; 1 above it. (...)
        """
        start = as_floats(from_enu_m)
        along = place_enu_m - start
        ground_m = np.hypot(along[..., 0], along[..., 1])
        east, north = (self.top_enu_m[i] - start[..., i] for i in (0, 1))
        before_m = (east * along[..., 0] + north * along[..., 1]) / ground_m
        beside_m = (east * along[..., 1] - north * along[..., 0]) / ground_m
        behind_m = ground_m - before_m
        height_m = start[..., 2] + before_m / ground_m * along[..., 2]
        is_past = (before_m > NEAREST_M) & (behind_m > NEAREST_M) & (height_m < self.top_enu_m[2])
        scale = np.sqrt(2 * ground_m / (as_floats(wavelength_m) * before_m * behind_m))
        s_low, c_low = special.fresnel(scale * (beside_m - self.width_m / 2))
        s_high, c_high = special.fresnel(scale * (beside_m + self.width_m / 2))
        cut = (1 + 1j) / 2 * ((c_high - c_low) - 1j * (s_high - s_low))
        return np.where(is_past, np.abs(1 - cut) ** 2, 1.0)


@dataclass(frozen=True, kw_only=True)
class City:
    """An environment by the laws of Al-Hourani, Kandeepan and Lardner 2014.

    Among drones at one elevation a share is in sight, expit(b (elevation - a) - ln a); what is lost
    beyond free space is `in_sight_db` or `hidden_db`, give or take `shadowing_db`.
    """

    a: float
    b: float
    in_sight_db: float
    hidden_db: float
    shadowing_db: float = 0.0

    def sight_probability(self, elevation_deg: Floats) -> Floats:
        """Probability that a drone at that elevation is in sight; (...)."""
        return np.asarray(special.expit(self.b * (elevation_deg - self.a) - np.log(self.a)))

    def power_factor(self, elevation_deg: Floats, draws: Floats | None) -> Floats:
        """Factor of power beyond free space; (n,), and (2, n) draws of pairs: uniform and normal.

        Without draws, of what is likelier, in sight or not.
        """
        sight = self.sight_probability(elevation_deg) > (0.5 if draws is None else draws[0])
        lost_db = np.where(sight, self.in_sight_db, self.hidden_db)
        if draws is not None:
            lost_db = lost_db + self.shadowing_db * draws[1]
        return np.asarray(10 ** (-lost_db / 10))


# 10.1109/LWC.2014.2342736: a and b of the sigmoid, and mean excess losses at 2 GHz.
CITIES = {
    "suburban": City(a=4.88, b=0.43, in_sight_db=0.1, hidden_db=21.0),
    "urban": City(a=9.61, b=0.16, in_sight_db=1.0, hidden_db=20.0),
    "dense-urban": City(a=12.08, b=0.11, in_sight_db=1.6, hidden_db=23.0),
    "high-rise": City(a=27.23, b=0.08, in_sight_db=2.3, hidden_db=34.0),
}

"""What the world does to signals on their way, whatever it is made of: one factor of power."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.numerics import as_floats
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

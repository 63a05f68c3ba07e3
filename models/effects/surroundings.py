"""What the world does to signals on their way, whatever it is made of: one factor of power."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from numpy.typing import ArrayLike

from plotfeed.models.state import Floats

HERE = (0.0, 0.0, 0.0)


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

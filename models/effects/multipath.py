"""Two rays over flat ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.numerics import as_floats
from plotfeed.models.propagation import two_ray_factor
from plotfeed.models.state import Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Multipath:
    """The ground's reflection coefficient, -1 to 1, and how far it lies below the antenna.

    The antenna is taken to radiate and to hear as much along either ray.
    """

    reflection: float
    antenna_height_m: float

    def power_factor(
        self, place_enu_m: Floats, wavelength_m: ArrayLike, from_enu_m: ArrayLike = (0.0, 0.0, 0.0)
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

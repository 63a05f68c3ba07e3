"""Towers that stand in the way of radio waves: strips of no width along the ray."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import fresnel

from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.state import Floats

NEAREST_M = 1.0  # Nearer to a tower than this along the ray, nothing stands before it


@dataclass(frozen=True)
class Pillar:
    """A tower east and north of the sensor, up to its top, so wide, metres."""

    top_enu_m: tuple[float, float, float]
    width_m: float

    @nan_without_warnings
    def power_factor(
        self, place_enu_m: Floats, wavelength_m: ArrayLike, from_enu_m: ArrayLike = (0.0, 0.0, 0.0)
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
        s_low, c_low = fresnel(scale * (beside_m - self.width_m / 2))
        s_high, c_high = fresnel(scale * (beside_m + self.width_m / 2))
        cut = (1 + 1j) / 2 * ((c_high - c_low) - 1j * (s_high - s_low))
        return np.where(is_past, np.abs(1 - cut) ** 2, 1.0)

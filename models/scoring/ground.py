"""Places as a point of the ellipsoid's level and a height: distances as they are at the drone.

A point is (..., 4): ECEF of the place at one level for all, metres, and its height above WGS-84.
Between two such points Euclid's distance of the first three columns is that over the ground where
they are, of all four that in space: east, north and up at the drone, wherever the site is. Over
1 km the Earth's curvature takes 2 cm of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.frames import axes_enu, geodetic_to_ecef
from plotfeed.models.state import Floats

GROUND, SPACE = 3, 4
"""Columns of points by which a distance is over the ground, or in space."""


@dataclass(frozen=True, slots=True)
class Level:
    """The height at which all points are, metres above the ellipsoid: that of the flights."""

    height_m: float

    def points(self, latitude_deg: ArrayLike, longitude_deg: ArrayLike, height_m: Floats) -> Floats:
        """Points of places in degrees and metres above WGS-84; (..., 4)."""
        level = geodetic_to_ecef(latitude_deg, longitude_deg, self.height_m)
        return np.concatenate([level, np.asarray(height_m)[..., None]], axis=-1)


def rates(latitude_deg: Floats, longitude_deg: Floats, velocity_enu_m_s: Floats) -> Floats:
    """Velocities east, north and up (n, 3) as those of points; (n, 4).

    An unknown climb is none; NaN for a velocity over the ground that is not known.
    """
    east, north, _ = np.moveaxis(axes_enu(latitude_deg, longitude_deg), 2, 1)
    level = velocity_enu_m_s[:, :1] * east + velocity_enu_m_s[:, 1:2] * north
    climb = np.nan_to_num(velocity_enu_m_s[:, 2:])
    return np.concatenate([level, climb], axis=-1)


def along_enu(differences: Floats, latitude_deg: Floats, longitude_deg: Floats) -> Floats:
    """Differences of points (n, 4), or of their rates, as east, north, up at places; (n, 3)."""
    east, north, _ = np.moveaxis(axes_enu(latitude_deg, longitude_deg), 2, 1)
    level = differences[:, :3]
    return np.stack(
        [(level * east).sum(axis=1), (level * north).sum(axis=1), differences[:, 3]], axis=-1
    )

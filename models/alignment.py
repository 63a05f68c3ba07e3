"""A sensor that stands askew: the axes along which it measures, and which it takes for true ones.

An error of azimuth and a tilt are one rotation, which joins that from ECEF: it costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.models.state import Floats

UP = np.array([0.0, 0.0, 1.0])


def own_axes(azimuth_offset_deg: float, tilt_deg: float, tilt_azimuth_deg: float) -> Floats:
    """From true east, north and up to the sensor's own, which it takes for them; (3, 3).

    Azimuths read too high by the offset. The sensor's vertical leans by the tilt towards an
    azimuth: what is there reads too high by as much.
    """
    towards = aer_to_enu(tilt_azimuth_deg, 0.0, 1.0)
    right = aer_to_enu(tilt_azimuth_deg + 90.0, 0.0, 1.0)
    leaning_up = aer_to_enu(tilt_azimuth_deg, 90.0 - tilt_deg, 1.0)
    leaning_towards = aer_to_enu(tilt_azimuth_deg, -tilt_deg, 1.0)
    tilt = np.outer(right, right) + np.outer(towards, leaning_towards) + np.outer(UP, leaning_up)
    north = aer_to_enu(azimuth_offset_deg, 0.0, 1.0)
    east = aer_to_enu(azimuth_offset_deg + 90.0, 0.0, 1.0)
    return np.asarray(np.column_stack([east, north, UP]) @ tilt)


@dataclass(frozen=True, kw_only=True)
class SkewFrame(LocalFrame):
    """A local frame whose axes are a sensor's own."""

    azimuth_offset_deg: float = 0.0
    tilt_deg: float = 0.0
    tilt_azimuth_deg: float = 0.0

    @classmethod
    def at(cls, frame: LocalFrame, **skew: float) -> SkewFrame:
        """At the place of another frame."""
        return cls(frame.latitude_deg, frame.longitude_deg, frame.height_m, **skew)

    @cached_property
    def rotation_from_ecef(self) -> Floats:
        """The sensor's own axes as unit vectors in ECEF, one a row; (3, 3)."""
        level = LocalFrame(self.latitude_deg, self.longitude_deg, self.height_m)
        axes = own_axes(self.azimuth_offset_deg, self.tilt_deg, self.tilt_azimuth_deg)
        return np.asarray(axes @ level.rotation_from_ecef)

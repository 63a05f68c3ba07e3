"""Tracks of sensors as all formats of tracks are given them."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from plotfeed.models.state import Floats
from plotfeed.proto.asterix.cat062 import Tracks


@dataclass(frozen=True, kw_only=True)
class ToldTracks(Tracks):
    """Tracks as `Tracks` has them, with what 062 has no room for; NaN for what is not estimated.

    Standard deviations are one sigma, of the position upwards and of the velocity's components.
    """

    sigma_up_m: Floats
    sigma_velocity_east_m_s: Floats
    sigma_velocity_north_m_s: Floats
    sigma_climb_m_s: Floats

    @property
    def speed_m_s(self) -> Floats:
        """Speed over the ground, m/s, (n,)."""
        return np.hypot(self.velocity_east_m_s, self.velocity_north_m_s)

    @property
    def course_deg(self) -> Floats:
        """Clockwise from true north in [0, 360), (n,)."""
        course = np.degrees(np.arctan2(self.velocity_east_m_s, self.velocity_north_m_s)) % 360.0
        return np.where(course == 360.0, 0.0, course)

    @property
    def sigma_level_m(self) -> Floats:
        """The larger one of the deviations east and north, (n,)."""
        return np.maximum(self.sigma_east_m, self.sigma_north_m)

    @property
    def sigma_speed_m_s(self) -> Floats:
        """The larger one of the deviations of the level velocity's components, (n,)."""
        return np.maximum(self.sigma_velocity_east_m_s, self.sigma_velocity_north_m_s)


_DTYPES = {"Ints": np.int64, "Bools": np.bool_, "Floats": np.float64}
NO_TRACKS = ToldTracks(**{f.name: np.zeros(0, _DTYPES[str(f.type)]) for f in fields(ToldTracks)})

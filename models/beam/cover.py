"""Where a sensor looks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plotfeed.models.beam.scan import Sector
from plotfeed.models.frames import wrap_360
from plotfeed.models.state import Bools, Floats


@dataclass(frozen=True, slots=True)
class AzimuthCover:
    """Clockwise from one azimuth to another, degrees from true north; at most the full circle."""

    min_deg: float
    max_deg: float

    @property
    def span_deg(self) -> float:
        """Its width."""
        return min(self.max_deg - self.min_deg, 360.0)

    def holds(self, azimuth_deg: Floats) -> Bools:
        """Whether azimuths lie within; an undefined one does not."""
        if self.span_deg == 360.0:
            return ~np.isnan(azimuth_deg)
        return wrap_360(azimuth_deg - self.min_deg) <= self.span_deg

    def shares_in(self, sector: Sector) -> list[tuple[float, float]]:
        """The pieces of the cover that lie in a sector, as shares of the cover: 0, 1 or 2."""
        if sector.stares:
            return [(0.0, 1.0)]
        start_deg = float(wrap_360(sector.start_deg - self.min_deg))
        end_deg = start_deg + sector.end_deg - sector.start_deg
        pieces = []
        for turn_deg in (0.0, 360.0):
            low_deg = max(start_deg - turn_deg, 0.0)
            high_deg = min(end_deg - turn_deg, self.span_deg)
            if low_deg < high_deg:
                pieces.append((low_deg / self.span_deg, high_deg / self.span_deg))
        return pieces


@dataclass(frozen=True, kw_only=True)
class Volume:
    """What a radar covers: from the blind range to the instrumented one, azimuths, elevations."""

    range_min_m: float
    range_max_m: float
    azimuth_cover: AzimuthCover
    elevation_min_deg: float
    elevation_max_deg: float

    def in_cover(self, range_m: Floats, azimuth_deg: Floats, elevation_deg: Floats) -> Bools:
        """Whether places lie within; one with an undefined angle does not."""
        return (
            (range_m >= self.range_min_m)
            & (range_m > 0)
            & (range_m <= self.range_max_m)
            & self.azimuth_cover.holds(azimuth_deg)
            & (elevation_deg >= self.elevation_min_deg)
            & (elevation_deg <= self.elevation_max_deg)
        )

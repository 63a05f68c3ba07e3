"""Beams of a search, side by side over a cover, and what a beam gains that points elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plotfeed.models.beam import AzimuthCover
from plotfeed.models.detection import cells_across
from plotfeed.models.frames import wrap_180
from plotfeed.models.state import Floats, Ints


@dataclass(frozen=True, kw_only=True)
class BeamGrid:
    """Beams in rows that fill a cover, `spacing` beamwidths apart or a little less."""

    cover: AzimuthCover
    elevation_min_deg: float
    elevation_max_deg: float
    azimuth_beamwidth_deg: float
    elevation_beamwidth_deg: float
    spacing: float

    @property
    def height_deg(self) -> float:
        """Height of the cover, in elevation."""
        return self.elevation_max_deg - self.elevation_min_deg

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Beams in azimuth and in elevation."""
        across = cells_across(self.cover.span_deg, self.spacing * self.azimuth_beamwidth_deg)
        upwards = cells_across(self.height_deg, self.spacing * self.elevation_beamwidth_deg)
        return int(np.ceil(across - 1e-9)), int(np.ceil(upwards - 1e-9))

    @property
    def beams(self) -> int:
        """Number of all beams."""
        return self.shape[0] * self.shape[1]

    @property
    def side_by_side(self) -> float:
        """How many beamwidths the cover holds, in azimuth times elevation."""
        return cells_across(self.cover.span_deg, self.azimuth_beamwidth_deg) * cells_across(
            self.height_deg, self.elevation_beamwidth_deg
        )

    def beam_of(self, azimuth_deg: Floats, elevation_deg: Floats) -> Ints:
        """The beam in whose part of the cover directions are; (n,)."""
        across, upwards = self.shape
        share = np.mod(azimuth_deg - self.cover.min_deg, 360.0) / self.cover.span_deg
        above = (elevation_deg - self.elevation_min_deg) / self.height_deg
        column = np.clip(np.nan_to_num(share * across), 0, across - 1).astype(np.int64)
        row = np.clip(np.nan_to_num(above * upwards), 0, upwards - 1).astype(np.int64)
        return np.asarray(row * across + column)

    def middle_of(self, beam: Ints) -> tuple[Floats, Floats]:
        """Azimuths and elevations of beams; (n,) each."""
        across, upwards = self.shape
        row, column = np.divmod(beam, across)
        azimuth_deg = self.cover.min_deg + (column + 0.5) * (self.cover.span_deg / across)
        return azimuth_deg, self.elevation_min_deg + (row + 0.5) * (self.height_deg / upwards)

    def gain(self, direction: tuple[Floats, Floats], pointed: tuple[Floats, Floats]) -> Floats:
        """Two-way gain of a Gaussian beam that points elsewhere, by azimuths and elevations; (n,).

        24 dB at a beamwidth off. Of errors of U beamwidths along either axis the mean is
        1/(1 + 16 ln 2 U^2).
        """
        level = np.cos(np.radians(direction[1]))
        across = wrap_180(direction[0] - pointed[0]) * level / self.azimuth_beamwidth_deg
        upwards = (direction[1] - pointed[1]) / self.elevation_beamwidth_deg
        return np.asarray(np.exp2(-8 * (across**2 + upwards**2)))

"""The keys that all radars have of what becomes of their echoes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Self

from pydantic import model_validator

from plotfeed.feeds.scene.sensors.antenna_keys import AntennaKeys, BeamCover, StraddlingKeys
from plotfeed.feeds.scene.sensors.sensor_keys import TrackingSensorKeys, VolumeKeys
from plotfeed.models.effects.doppler import Doppler
from plotfeed.models.effects.echo_effects import EchoEffects


class EchoRadarKeys(TrackingSensorKeys, VolumeKeys):
    """A radar, whatever makes its echoes: what a scene may name of what they lose."""

    if TYPE_CHECKING:  # keys of every radar, which stand where each of them has them
        azimuth_beamwidth_deg: float
        elevation_beamwidth_deg: float | None
        doppler: Any

    antenna: AntennaKeys | None = None
    """Without it, the gains are the same over the whole cover."""
    straddling: StraddlingKeys | None = None
    """Without it, nothing is lost between the middles of cells."""

    @model_validator(mode="after")
    def _has_doppler_cells(self) -> Self:
        if self.straddling is not None and self.straddling.doppler and self.doppler is None:
            raise ValueError("straddling.doppler: needs doppler")
        return self

    @model_validator(mode="after")
    def _antenna_is_of_it(self) -> Self:
        if self.antenna is None:
            return self
        if self.scan.rotates and self.antenna.has_azimuths:
            raise ValueError(
                "antenna: azimuth is for radars that stare: a beam that turns meets every drone "
                "in its middle"
            )
        if self.illuminators and self.antenna.transmit is not None:
            raise ValueError("antenna.transmit: this radar transmits nothing")
        return self

    @property
    def shape_loss_db(self) -> float:
        """What the shape of the receiving beam costs at its peak, by the beamwidths alone."""
        return 0.0 if self.antenna is None else self.antenna.peak_loss_db

    def echo_effects(
        self, range_cells_m: Sequence[float], doppler: Doppler | None
    ) -> EchoEffects | None:
        """What becomes of echoes' powers, by the cells of signals; None if nothing is named."""
        if self.antenna is None and self.straddling is None:
            return None
        low_deg, high_deg = self.elevation_min_deg, self.elevation_max_deg
        azimuth = BeamCover(self.azimuth_beamwidth_deg, self.azimuth_min_deg, self.azimuth_max_deg)
        elevation = BeamCover(self.elevation_beamwidth_deg or high_deg - low_deg, low_deg, high_deg)
        straddling = self.straddling
        return EchoEffects(
            antenna=None if self.antenna is None else self.antenna.model(azimuth, elevation),
            straddling=None if straddling is None else straddling.model(range_cells_m, doppler),
        )

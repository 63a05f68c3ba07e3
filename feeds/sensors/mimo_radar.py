"""The keys of a MIMO radar."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from plotfeed.feeds.parts import Decibels, Loss, Place, Positive, Site
from plotfeed.feeds.places import enu_from, frame_at
from plotfeed.feeds.sensors.base import StaringScan
from plotfeed.feeds.sensors.polar_radar import PolarRadarSensor
from plotfeed.models.mimo_radar import MimoRadar, Transmitter


class MimoTransmitterPart(Place):
    """One of the radar's transmitters, and the place of its antenna."""

    power_w: Positive
    """Average."""
    gain_tx_dbi: Decibels | None = None
    """In place of the radar's."""


class MimoRadarSensor(PolarRadarSensor):
    """A radar of several transmitters far apart, and one receiver at the sensor's place.

    It looks everywhere at once. The defaults are the paper's typical values.
    """

    type: Literal["mimo_radar"]
    """Which model."""
    scan: StaringScan
    """How it scans."""
    transmitters: Annotated[
        tuple[MimoTransmitterPart, ...], Field(strict=False, min_length=1, max_length=32)
    ]
    """The radar's own."""
    loss_db: Loss = 1.1
    """Of the system: the paper's 2 dB without the CFAR loss, which is in the detector already."""
    n_reference: Annotated[int, Field(ge=1, le=256)] = 16
    """Reference cells of the CA-CFAR in the signal of each transmitter."""

    def model(self, site: Site, /) -> MimoRadar:
        """The model, with the transmitters as the receiver sees them."""
        return MimoRadar(
            **self._polar(),
            transmitters=tuple(self._transmitter(part, site) for part in self.transmitters),
        )

    def _transmitter(self, part: MimoTransmitterPart, site: Site) -> Transmitter:
        east_m, north_m, up_m = enu_from(frame_at(site, self.position_enu_m), site, part)
        return Transmitter(
            position_enu_m=(float(east_m), float(north_m), float(up_m)),
            power_w=part.power_w,
            gain_dbi=self.gain_tx_dbi if part.gain_tx_dbi is None else part.gain_tx_dbi,
        )

    def warnings(self, site: Site, /) -> list[str]:
        """An integration longer than a scan, and a format coarser than the radar."""
        return [*self._long_integration(), *super().warnings(site)]

    def _long_integration(self) -> list[str]:
        if self.integration_s <= self.scan.period_s:
            return []
        return [
            f"integration_s is {self.integration_s:g}, but a scan lasts "
            f"{self.scan.period_s:g} s: integrate less, or scan slower"
        ]

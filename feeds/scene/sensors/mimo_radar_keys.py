"""The keys of a radar of several transmitters far apart."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from plotfeed.feeds.scene.fields import (
    Decibels,
    Location,
    Loss,
    Positive,
    Site,
    enu_from,
    frame_at,
)
from plotfeed.feeds.scene.sensors.scan_keys import StaringScan
from plotfeed.feeds.scene.sensors.sensor_keys import (
    long_integration,
)
from plotfeed.models.sensors.active_radar import MimoRadar, MimoTransmitter

if TYPE_CHECKING:
    pass
from plotfeed.feeds.scene.sensors.polar_radar_keys import PolarRadarKeys


class MimoTransmitterKeys(Location):
    """One of the radar's transmitters, and the place of its antenna."""

    power_w: Positive
    """Average."""
    gain_tx_dbi: Decibels | None = None
    """In place of the radar's."""


class MimoRadarKeys(PolarRadarKeys):
    """A radar of several transmitters far apart, and one receiver at the sensor's place.

    It looks everywhere at once. The defaults are the paper's typical values.
    """

    label = "MIMO radar"

    type: Literal["mimo_radar"]
    """Which model."""
    scan: StaringScan
    """How it scans."""
    transmitters: Annotated[
        tuple[MimoTransmitterKeys, ...], Field(strict=False, min_length=1, max_length=32)
    ]
    """The radar's own."""
    loss_db: Loss = 1.1
    """Of the system: the paper's 2 dB without the CFAR loss, which is in the detector already."""
    n_reference: Annotated[int, Field(ge=1, le=256)] = 16
    """Reference cells of the CA-CFAR in the signal of each transmitter."""

    def model(self, site: Site, /) -> MimoRadar:
        """The model, with the transmitters as the receiver sees them."""
        model = MimoRadar(
            **self._polar(),
            transmitters=tuple(self._transmitter(part, site) for part in self.transmitters),
        )
        return self.in_the_world(model, site)

    def _transmitter(self, part: MimoTransmitterKeys, site: Site) -> MimoTransmitter:
        east_m, north_m, up_m = enu_from(frame_at(site, self.position_enu_m), site, part)
        return MimoTransmitter(
            position_enu_m=(float(east_m), float(north_m), float(up_m)),
            power_w=part.power_w,
            gain_dbi=self.gain_tx_dbi if part.gain_tx_dbi is None else part.gain_tx_dbi,
        )

    def warnings(self, site: Site, /) -> list[str]:
        """An integration longer than a scan, and a format coarser than the radar."""
        return [*long_integration(self.integration_s, self.scan), *super().warnings(site)]

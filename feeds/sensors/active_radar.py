"""The keys of an active radar."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from plotfeed.feeds.parts import Positive, Site
from plotfeed.feeds.sensors.base import RotatingScan, Scan
from plotfeed.feeds.sensors.polar_radar import PolarRadarSensor
from plotfeed.models.active_radar import ActiveRadar


class ActiveRadarSensor(PolarRadarSensor):
    """A quasi-monostatic active radar. The defaults are the paper's typical values."""

    type: Literal["active_radar"]
    """Which model."""
    scan: Scan
    """How it scans."""
    power_w: Positive
    """Average."""
    receive_beams: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    """Formed side by side in azimuth: they lengthen the time on target of a rotating radar."""

    def model(self, _site: Site, /) -> ActiveRadar:
        """The model; a receive gain that is not given follows from the beamwidths."""
        return ActiveRadar(
            **self._polar(),
            power_w=self.power_w,
            gain_tx_dbi=self.gain_tx_dbi,
        )

    def warnings(self, site: Site, /) -> list[str]:
        """A beam that is too fast for its integration, and a format coarser than the radar."""
        return [*self._short_dwell(), *super().warnings(site)]

    def _short_dwell(self) -> list[str]:
        if not isinstance(self.scan, RotatingScan):
            return []
        beam_deg = min(self.receive_beams * self.azimuth_beamwidth_deg, 360.0)
        on_target_s = self.scan.period_s * beam_deg / 360
        if self.integration_s <= on_target_s:
            return []
        return [
            f"integration_s is {self.integration_s:g}, but the beam is on a target for "
            f"{on_target_s:.3g} s of a turn: integrate less, turn slower, or add receive_beams"
        ]

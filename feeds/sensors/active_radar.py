"""The keys of an active radar."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from plotfeed.feeds.parts import (
    Azimuth,
    Beamwidth,
    Decibels,
    Elevation,
    Frequency,
    Loss,
    NotNegative,
    Positive,
    Probability,
    Resolution,
    Site,
)
from plotfeed.feeds.sensors.base import RotatingScan, Scan, SensorPart
from plotfeed.models.active_radar import ActiveRadar
from plotfeed.models.cover import AzimuthCover
from plotfeed.models.propagation import beam_gain_dbi
from plotfeed.proto.asterix.plots import RHO_LSB_M


class ActiveRadarSensor(SensorPart):
    """A quasi-monostatic active radar. The defaults are the paper's typical values."""

    type: Literal["active_radar"]
    report: Annotated[
        tuple[Literal["asterix-048", "plots"], ...], Field(strict=False, min_length=1)
    ] = ("asterix-048", "plots")
    """asterix-048 brings the service messages of category 034 along for a rotating scan."""
    scan: Scan
    power_w: Positive
    """Average."""
    frequency_hz: Frequency
    gain_tx_dbi: Decibels
    gain_rx_dbi: Decibels | None = None
    """Without it, 41253 times the efficiency over the product of the beamwidths in degrees."""
    antenna_efficiency: Annotated[float, Field(gt=0, le=1)] = 1.0
    integration_s: Positive
    """Coherent."""
    loss_db: Loss = 4.0
    """Of the system; the CFAR loss is in the detector already."""
    noise_figure_db: Loss = 5.0
    pfa: Probability = 1e-6
    """Probability of a false alarm in one resolution cell."""
    n_reference: Annotated[int, Field(ge=1, le=1_000_000)] = 16
    """Reference cells of the CA-CFAR."""
    range_resolution_m: Resolution
    range_min_m: NotNegative = 0.0
    """The blind range."""
    range_max_m: Annotated[float, Field(gt=0, le=470_000)]
    """Instrumented."""
    azimuth_beamwidth_deg: Beamwidth
    elevation_beamwidth_deg: Beamwidth
    receive_beams: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    """Formed side by side in azimuth: they lengthen the time on target of a rotating radar."""
    azimuth_min_deg: Azimuth = -180.0
    azimuth_max_deg: Azimuth = 180.0
    """Cover is clockwise from azimuth_min_deg to azimuth_max_deg, from true north."""
    elevation_min_deg: Elevation
    elevation_max_deg: Elevation
    doppler_cells: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    range_floor_m: NotNegative = 0.0
    azimuth_floor_deg: NotNegative = 0.0
    elevation_floor_deg: NotNegative = 0.0
    """Errors that remain however strong the echo; added in quadrature."""
    measures_elevation: bool = True
    """False for a two-dimensional radar, whose plots have neither elevation nor height."""

    @model_validator(mode="after")
    def _covers_something(self) -> Self:
        if not self.range_min_m < self.range_max_m:
            raise ValueError("range_min_m: must be less than range_max_m")
        if not 0 < self.azimuth_max_deg - self.azimuth_min_deg <= 360:
            raise ValueError("azimuth_max_deg: must be above azimuth_min_deg, by at most 360")
        if not self.elevation_min_deg < self.elevation_max_deg:
            raise ValueError("elevation_min_deg: must be less than elevation_max_deg")
        return self

    def model(self, _site: Site, /) -> ActiveRadar:
        """The model; a receive gain that is not given follows from the beamwidths."""
        gain_rx_dbi = self.gain_rx_dbi
        if gain_rx_dbi is None:
            gain_rx_dbi = float(
                beam_gain_dbi(
                    self.azimuth_beamwidth_deg,
                    self.elevation_beamwidth_deg,
                    self.antenna_efficiency,
                )
            )
        return ActiveRadar(
            power_w=self.power_w,
            frequency_hz=self.frequency_hz,
            gain_tx_dbi=self.gain_tx_dbi,
            gain_rx_dbi=gain_rx_dbi,
            integration_s=self.integration_s,
            loss_db=self.loss_db,
            noise_figure_db=self.noise_figure_db,
            pfa=self.pfa,
            n_reference=self.n_reference,
            range_resolution_m=self.range_resolution_m,
            range_min_m=self.range_min_m,
            range_max_m=self.range_max_m,
            azimuth_beamwidth_deg=self.azimuth_beamwidth_deg,
            elevation_beamwidth_deg=self.elevation_beamwidth_deg,
            azimuth_cover=AzimuthCover(self.azimuth_min_deg, self.azimuth_max_deg),
            elevation_min_deg=self.elevation_min_deg,
            elevation_max_deg=self.elevation_max_deg,
            doppler_cells=self.doppler_cells,
            range_floor_m=self.range_floor_m,
            azimuth_floor_deg=self.azimuth_floor_deg,
            elevation_floor_deg=self.elevation_floor_deg,
            measures_elevation=self.measures_elevation,
        )

    def warnings(self, site: Site, /) -> list[str]:
        """A beam that is too fast for its integration, and a format coarser than the radar."""
        return [*self._short_dwell(), *self._coarse_format(site)]

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

    def _coarse_format(self, site: Site) -> list[str]:
        strongest_snr = 1e6  # 60 dB: what remains there is the floor and the resolution
        best_m = float(self.model(site).sigmas(np.array(strongest_snr))[0])
        added_m = RHO_LSB_M / 12**0.5
        if "asterix-048" not in self.report or added_m <= best_m:
            return []
        return [
            f"asterix-048 counts range in steps of {RHO_LSB_M:.3g} m, an error of {added_m:.2g} m "
            f"beside the radar's own of {best_m:.2g} m for a strong echo"
        ]

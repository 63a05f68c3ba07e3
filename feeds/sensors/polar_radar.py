"""The keys that radars share which measure range, azimuth and elevation."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from plotfeed.feeds.parts import (
    Beamwidth,
    Decibels,
    Frequency,
    Loss,
    NotNegative,
    Positive,
    Probability,
    Resolution,
    Site,
)
from plotfeed.feeds.sensors.base import Scan, VolumePart
from plotfeed.feeds.sensors.effects import (
    MergingPart,
    MultipathPart,
    PulsedDopplerPart,
    multipath_of,
)
from plotfeed.feeds.sensors.tracks import TrackingSensorPart
from plotfeed.models.constants import C_M_S
from plotfeed.models.doppler import Doppler
from plotfeed.models.polar_radar import PolarRadar
from plotfeed.models.propagation import beam_gain_dbi
from plotfeed.proto.asterix.plots import RHO_LSB_M

if TYPE_CHECKING:
    from plotfeed.models.merging import Merging


class PolarRadarSensor(TrackingSensorPart, VolumePart):
    """Everything but what makes the echoes. The defaults are the paper's typical values."""

    report: Annotated[
        tuple[Literal["asterix-015", "asterix-048", "asterix-062", "plots", "sapient"], ...],
        Field(strict=False, min_length=1),
    ] = ()
    """Without it, plots and, for a rotating scan, asterix-048, which brings category 034 along,
    else the finer asterix-015, which brings 025 along; asterix-062 brings 063."""
    scan: Scan
    """How it scans."""
    frequency_hz: Frequency
    """Of the carrier."""
    gain_tx_dbi: Decibels
    """Of the transmitting antenna."""
    gain_rx_dbi: Decibels | None = None
    """Without it, 41253 times the efficiency over the product of the beamwidths in degrees."""
    antenna_efficiency: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Of the receiving antenna: its gain over that of a lossless one."""
    integration_s: Positive
    """Coherent."""
    loss_db: Loss = 4.0
    """Of the system; the CFAR loss is in the detector already."""
    noise_figure_db: Loss = 5.0
    """Of the receiver."""
    pfa: Probability = 1e-6
    """Probability of a false alarm in one resolution cell."""
    n_reference: Annotated[int, Field(ge=1, le=1_000_000)] = 16
    """Reference cells of the CA-CFAR."""
    range_resolution_m: Resolution
    """Width of a range cell."""
    azimuth_beamwidth_deg: Beamwidth
    """Of the receive beam, at 3 dB."""
    elevation_beamwidth_deg: Beamwidth
    """Of the receive beam, at 3 dB."""
    doppler_cells: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    """Cells of velocity for each of range: each can give a false alarm."""
    range_floor_m: NotNegative = 0.0
    """Error that remains however strong the echo; added in quadrature."""
    azimuth_floor_deg: NotNegative = 0.0
    """Error that remains however strong the echo; added in quadrature."""
    elevation_floor_deg: NotNegative = 0.0
    """Errors that remain however strong the echo; added in quadrature."""
    measures_elevation: bool = True
    """False for a two-dimensional radar, whose plots have neither elevation nor height."""
    multipath: MultipathPart | None = None
    """The ground's reflection; without it, space is free."""
    doppler: PulsedDopplerPart | None = None
    """Without it, no range rates."""
    merging: MergingPart | None = None
    """Without it, every drone is seen by itself, however close to others."""

    @classmethod
    def usual_report(cls, keys: dict[str, Any], /) -> tuple[str, ...]:
        """What every tracker reads, where a beam turns; where none does, the finer category."""
        scan = keys.get("scan")
        rotates = isinstance(scan, dict) and scan.get("kind") == "rotating"
        return ("asterix-048" if rotates else "asterix-015", "plots")

    def model(self, site: Site, /) -> PolarRadar:
        """The model that these keys make, at that site."""
        raise NotImplementedError

    def warnings(self, site: Site, /) -> list[str]:
        """Cells without false alarms, and a format coarser than the radar."""
        return [*self._few_cells(), *self._coarse_format(site)]

    def _few_cells(self) -> list[str]:
        """Fewer Doppler cells for false alarms than rates are told apart in."""
        doppler = self._doppler()
        if doppler is None:
            return []
        cells = doppler.spans_m_s[0] / doppler.cells_m_s[0]
        if self.doppler_cells > cells / 2:
            return []
        return [
            f"doppler_cells is {self.doppler_cells}, and the range rates that are told apart make "
            f"{cells:.0f} cells: each could give a false alarm"
        ]

    def _coarse_format(self, site: Site) -> list[str]:
        strongest_snr = 1e6  # 60 dB: what remains there is the floor and the resolution
        best_m = float(self.model(site).sigmas(np.array([strongest_snr]))[0, 0])
        added_m = RHO_LSB_M / 12**0.5
        if "asterix-048" not in self.report or added_m <= best_m:
            return []
        return [
            f"asterix-048 counts range in steps of {RHO_LSB_M:.3g} m, an error of {added_m:.2g} m "
            f"beside the radar's own of {best_m:.2g} m for a strong echo"
        ]

    def _polar(self) -> dict[str, Any]:
        """What the model calls by the same names, its cover and its receive gain."""
        names = {f.name for f in fields(PolarRadar)} & type(self).model_fields.keys()
        return {name: getattr(self, name) for name in names} | {
            "azimuth_cover": self.azimuth_cover,
            "gain_rx_dbi": self._gain_rx_dbi(),
            "measures_run_length": "asterix-048" in self.report,
            "multipath": multipath_of(self.multipath),
            "doppler": self._doppler(),
            "merging": self._merging(),
        }

    def _doppler(self) -> Doppler | None:
        if self.doppler is None:
            return None
        return self.doppler.model([C_M_S / self.frequency_hz], self.integration_s, ways=2)

    def _merging(self) -> Merging | None:
        if self.merging is None:
            return None
        return self.merging.model(
            range_cells_m=[self.range_resolution_m],
            azimuth_deg=self.azimuth_beamwidth_deg,
            elevation_deg=self.elevation_beamwidth_deg if self.measures_elevation else None,
            doppler=self._doppler(),
            period_s=self.scan.period_s,
        )

    def _gain_rx_dbi(self) -> float:
        """Follows from the beamwidths if it is not given."""
        if self.gain_rx_dbi is not None:
            return self.gain_rx_dbi
        return float(
            beam_gain_dbi(
                self.azimuth_beamwidth_deg, self.elevation_beamwidth_deg, self.antenna_efficiency
            )
        )

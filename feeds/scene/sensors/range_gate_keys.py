"""The keys of the technology-agnostic sensor."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from plotfeed.feeds.scene.fields import NotNegative, Positive, Site
from plotfeed.feeds.scene.report_formats import TRACK_FORMATS
from plotfeed.feeds.scene.sensors.scan_keys import StaringScan
from plotfeed.feeds.scene.sensors.sensor_keys import Reports, SensorGeometry, TrackingSensorKeys
from plotfeed.models.sensors.range_gate import RangeGate

# A twentieth of the cell of a radar that sweeps 150 MHz: nothing that finds drones does better.
LEAST_SIGMA_M = 0.05


class RangeGateKeys(TrackingSensorKeys):
    """A range gate and Gaussian noise: what the paper's more accurate models replace."""

    label = "range gate"
    makes = RangeGate
    geometry = SensorGeometry.MONOSTATIC
    sapient_type = "OTHER"
    formats = ("asterix-015", *TRACK_FORMATS, "plots", "sapient")

    type: Literal["range_gate"]
    report: Reports = ()
    """Without it, plots."""
    scan: StaringScan
    range_max_m: Positive
    """Of the gate: beyond it nothing is reported."""
    sigma_m: NotNegative
    """Of the noise on each of east, north and up."""

    def warnings(self, _site: Site, /) -> Iterator[str]:
        """Noise that is none."""
        if self.sigma_m < LEAST_SIGMA_M:
            yield (
                f"sigma_m is {self.sigma_m:g} m, more accurate than sensors are: some metres are "
                "usual"
            )

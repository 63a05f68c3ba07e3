"""What a sensor reads in place of what it finds: fixed errors, and errors that drift."""

from __future__ import annotations

from dataclasses import dataclass

from plotfeed.models.drift import Drift
from plotfeed.models.state import Floats, Ints


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftingReadings:
    """Standard deviations of a drift in range and in azimuth, and its two processes."""

    sigma_range_m: float
    sigma_azimuth_deg: float
    drift: Drift


@dataclass(frozen=True, slots=True, kw_only=True)
class Readings:
    """A range r reads r (1 + scale) + offset, and drifts; an azimuth drifts.

    A fixed error of azimuth is not here: it is in the sensor's own axes.
    """

    range_scale: float = 0.0
    range_offset_m: float = 0.0
    drifting: DriftingReadings | None = None

    def range_m(self, range_m: Floats, t_utc_ns: Ints) -> Floats:
        """Of ranges, or of bistatic ranges, at times; each (n,)."""
        read_m = range_m * (1 + self.range_scale) + self.range_offset_m
        if self.drifting is None or not self.drifting.sigma_range_m:
            return read_m
        return read_m + self.drifting.sigma_range_m * self.drifting.drift.at(t_utc_ns)[:, 0]

    def azimuth_deg(self, azimuth_deg: Floats, t_utc_ns: Ints) -> Floats:
        """Of azimuths at times, not folded; each (n,)."""
        if self.drifting is None or not self.drifting.sigma_azimuth_deg:
            return azimuth_deg
        off = self.drifting.drift.at(t_utc_ns)[:, 1]
        return azimuth_deg + self.drifting.sigma_azimuth_deg * off

"""What every sensor model can do: the verbs that a station needs, whatever the physics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from plotfeed.models.beam.scan import Sector
from plotfeed.models.state import Floats, Looks, Plots, Targets

NO_PLOTS = Plots.of(t_utc_ns=np.zeros(0, np.int64))
NO_LOOKS = Looks.none()


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """What to expect of a sensor's plots of targets, (n,); NaN for what it does not measure.

    `snr` is the mean one, linear, `pd` the probability that the target is reported at all, and the
    sigmas are rms errors over the reports, about what biased readings lead to.
    """

    snr: Floats
    pd: Floats
    sigma_range_m: Floats
    sigma_azimuth_deg: Floats
    sigma_elevation_deg: Floats
    sigma_range_rate_m_s: Floats | None = None


class SensorModel(Protocol):
    """A sensor, frozen: randomness is an argument."""

    @property
    def range_max_m(self) -> float:
        """Nothing further away is ever looked at."""

    @property
    def signal_speed_m_s(self) -> float | None:
        """How fast what it senses travels; None where that takes no time worth modelling."""

    @property
    def measures_range_rate(self) -> bool:
        """Whether it needs to know how fast targets are."""

    @property
    def false_alarms_per_scan(self) -> float:
        """Their mean number."""

    def observe(self, targets: Targets, rng: np.random.Generator) -> tuple[Looks, Plots]:
        """One look at each target: those within cover, and the plots of those detected.

        Heights are left out: they take the sensor's place on Earth.
        """

    def draw_false_alarms(self, sector: Sector, rng: np.random.Generator) -> Plots:
        """The false alarms of one sector of a scan, with the times at which they came."""

    def predict(self, targets: Targets) -> Prediction:
        """What `observe` comes to over many scans, had the targets stayed there; all in cover.

        Rates of range count where velocities are given.
        """

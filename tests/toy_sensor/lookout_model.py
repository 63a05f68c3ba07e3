"""A lookout with a telescope: the first of a toy sensor's two files, its model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plotfeed.models.beam import Sector
from plotfeed.models.frames import enu_to_aer, wrap_360
from plotfeed.models.sensors.sensor_model import NO_PLOTS, Prediction, SensorModel, Targets
from plotfeed.models.state import Looks, Plots


@dataclass(frozen=True, kw_only=True)
class Lookout(SensorModel):
    """Every drone within reach is seen; azimuth and elevation err by `sigma_deg`."""

    sigma_deg: float

    @property
    def false_alarms_per_scan(self) -> float:
        """It has none."""
        return 0.0

    def observe(self, targets: Targets, rng: np.random.Generator) -> tuple[Looks, Plots]:
        """One look at each target within reach, and its direction."""
        geometry = enu_to_aer(targets.position_enu_m)
        seen = np.flatnonzero(geometry[2] <= self.range_max_m)
        n = len(seen)
        looks = targets.looks(
            seen, geometry, snr=np.full(n, np.nan), pd=np.ones(n), detected=np.ones(n, np.bool_)
        )
        errors_deg = self.sigma_deg * rng.standard_normal((2, n))
        azimuth_deg = targets.read_azimuth_deg(looks.azimuth_deg + errors_deg[0], looks.t_utc_ns)
        return looks, Plots.of(
            t_utc_ns=looks.t_utc_ns,
            azimuth_deg=wrap_360(azimuth_deg),
            elevation_deg=looks.elevation_deg + errors_deg[1],
            sigma_azimuth_deg=np.full(n, self.sigma_deg),
            sigma_elevation_deg=np.full(n, self.sigma_deg),
            drone=looks.drone,
            **targets.true_geometry(looks, seen),
        )

    def draw_false_alarms(self, _sector: Sector, _rng: np.random.Generator) -> Plots:
        """None."""
        return NO_PLOTS

    def predict(self, targets: Targets) -> Prediction:
        """Certain within reach, with the same errors everywhere."""
        range_m = np.linalg.norm(targets.position_enu_m, axis=1)
        unknown, sigma_deg = (np.full(len(range_m), x) for x in (np.nan, self.sigma_deg))
        return Prediction(
            snr=unknown,
            pd=np.where(range_m <= self.range_max_m, 1.0, 0.0),
            sigma_range_m=unknown,
            sigma_azimuth_deg=sigma_deg,
            sigma_elevation_deg=sigma_deg,
        )

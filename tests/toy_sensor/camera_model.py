"""A camera: the first of a toy sensor's three files, its model. It measures directions alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plotfeed.models.beam.scan import Sector
from plotfeed.models.frames import enu_to_aer, wrap_360
from plotfeed.models.sensors.sensor_model import NO_PLOTS, Prediction, Targets, true_geometry
from plotfeed.models.state import Looks, Plots


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Every drone within reach is seen; azimuth and elevation err by `sigma_deg`."""

    range_max_m: float
    sigma_deg: float

    signal_speed_m_s = None
    measures_range_rate = False
    false_alarms_per_scan = 0.0

    def observe(self, targets: Targets, rng: np.random.Generator) -> tuple[Looks, Plots]:
        """One look at each target within reach, and its direction."""
        azimuth_deg, elevation_deg, range_m = enu_to_aer(targets.position_enu_m)
        seen = np.flatnonzero(range_m <= self.range_max_m)
        n = len(seen)
        looks = Looks(
            drone=targets.drone[seen],
            channel=np.zeros(n, np.int64),
            t_utc_ns=targets.t_utc_ns[seen],
            range_m=range_m[seen],
            azimuth_deg=azimuth_deg[seen],
            elevation_deg=elevation_deg[seen],
            snr=np.full(n, np.nan),
            pd=np.ones(n),
            detected=np.ones(n, np.bool_),
        )
        errors_deg = self.sigma_deg * rng.standard_normal((2, n))
        return looks, Plots.of(
            t_utc_ns=looks.t_utc_ns,
            azimuth_deg=wrap_360(looks.azimuth_deg + errors_deg[0]),
            elevation_deg=looks.elevation_deg + errors_deg[1],
            sigma_azimuth_deg=np.full(n, self.sigma_deg),
            sigma_elevation_deg=np.full(n, self.sigma_deg),
            drone=looks.drone,
            **true_geometry(looks, targets, seen),
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

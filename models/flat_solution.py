"""A place from a bistatic range and an azimuth: the target is taken to be level with the sensor.

Equations 32 to 35 of the paper, with the transmitter's direction in space. What the sensor states
of its errors is exact to first order; that the target is higher than the sensor is not in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from plotfeed.models import propagation
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.quiet import quiet
from plotfeed.models.state import Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class FlatSolution:
    """Distances in the receiver's horizontal plane, and how they change with what was measured.

    Metres, metres per metre of bistatic range, metres per radian of azimuth; all (...).
    """

    azimuth_deg: Floats
    range_m: Floats
    by_bistatic_range: Floats
    by_azimuth_m: Floats

    @quiet
    def sigma_m(self, sigma_bistatic_range_m: Floats, sigma_azimuth_deg: Floats) -> Floats:
        """Standard deviation of the distance, to first order."""
        return np.hypot(
            self.by_bistatic_range * sigma_bistatic_range_m,
            self.by_azimuth_m * np.radians(sigma_azimuth_deg),
        )

    @quiet
    def covariance_m2(
        self, sigma_bistatic_range_m: Floats, sigma_azimuth_deg: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Of the position: east, north, and east with north (eqs 32, 33)."""
        outwards, rightwards = _directions(self.azimuth_deg)
        by_range = self.by_bistatic_range[..., None] * outwards
        by_azimuth = self.by_azimuth_m[..., None] * outwards + self.range_m[..., None] * rightwards
        along = by_range * np.asarray(sigma_bistatic_range_m)[..., None]
        across = by_azimuth * np.radians(sigma_azimuth_deg)[..., None]
        return (
            along[..., 0] ** 2 + across[..., 0] ** 2,
            along[..., 1] ** 2 + across[..., 1] ** 2,
            along[..., 0] * along[..., 1] + across[..., 0] * across[..., 1],
        )

    @quiet
    def chance_between(
        self, low_m: float, high_m: float, sigma_m: Floats, excess_over_sigma: Floats
    ) -> Floats:
        """Probability that noise leaves a distance between those; Gaussian, to first order.

        0 where the distance is undefined, or not known better than to `high_m`. The last argument
        is the bistatic range over its sigma: noise may leave nothing of it, and so of the distance.
        """
        too_near = np.maximum(ndtr((low_m - self.range_m) / sigma_m), ndtr(-excess_over_sigma))
        within = ndtr((high_m - self.range_m) / sigma_m) - too_near
        return np.where(sigma_m <= high_m, np.maximum(np.nan_to_num(within), 0.0), 0.0)


@quiet
def flat_solution(
    bistatic_range_m: Floats, azimuth_deg: Floats, transmitter_enu_m: Floats
) -> FlatSolution:
    """Where a target in the receiver's horizontal plane would be measured so (eqs 34, 35).

    (...), (...) and (..., 3). The transmitter may be above or below that plane. Undefined for a
    bistatic range of zero or less, which noise makes of targets near the baseline: NaN there.
    """
    outwards, rightwards = _directions(azimuth_deg)
    baseline_m = np.linalg.norm(transmitter_enu_m, axis=-1)
    towards = transmitter_enu_m / baseline_m[..., None]
    angle_rad = 2 * np.arctan2(
        np.linalg.norm(outwards - towards, axis=-1), np.linalg.norm(outwards + towards, axis=-1)
    )
    measured = np.where(bistatic_range_m > 0, bistatic_range_m, np.nan)
    case = (measured, baseline_m, np.degrees(angle_rad))
    by_range, by_angle = propagation.range_from_bistatic_slopes(*case)
    # The angle to the baseline turns with the azimuth, the less the higher the transmitter is.
    sine = np.sin(angle_rad)
    turn = np.where(sine > 0, -np.sum(rightwards * towards, axis=-1) / sine, 0.0)
    return FlatSolution(
        azimuth_deg=np.broadcast_to(azimuth_deg, measured.shape),
        range_m=propagation.range_from_bistatic(*case),
        by_bistatic_range=by_range,
        by_azimuth_m=by_angle * turn,
    )


def _directions(azimuth_deg: Floats) -> tuple[Floats, Floats]:
    """Along a horizontal line of sight, and to the right of it; (...) in, (..., 3) out."""
    return aer_to_enu(azimuth_deg, 0.0, 1.0), aer_to_enu(azimuth_deg + 90.0, 0.0, 1.0)

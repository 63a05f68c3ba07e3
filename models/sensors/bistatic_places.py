"""Where targets are by a bistatic range and an azimuth: in the receiver's plane, or above it.

Where that is on the ground depends on how high the target is, which a sensor without elevation does
not know: it may take heights as normal, with a stated mean and standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from plotfeed.models import propagation
from plotfeed.models.frames import aer_to_enu, distance_m
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.propagation import dot
from plotfeed.models.state import Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class FlatSolution:
    """Distances in the receiver's horizontal plane, and how they change with what was measured.

    Metres, metres per metre of bistatic range, metres per radian of azimuth; all (...). Beside
    them are the lines of sight, and what is to the right of these, (..., 3).
    """

    outwards: Floats
    rightwards: Floats
    range_m: Floats
    by_bistatic_range: Floats
    by_azimuth_m: Floats

    @nan_without_warnings
    def sigma_m(self, sigma_bistatic_range_m: Floats, sigma_azimuth_deg: Floats) -> Floats:
        """Standard deviation of the distance, to first order."""
        return np.hypot(
            self.by_bistatic_range * sigma_bistatic_range_m,
            self.by_azimuth_m * np.radians(sigma_azimuth_deg),
        )

    @nan_without_warnings
    def covariance_m2(
        self, sigma_bistatic_range_m: Floats, sigma_azimuth_deg: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Covariances of the position: east, north, and east with north (eqs 32, 33)."""
        sigma_azimuth = np.radians(sigma_azimuth_deg)
        along, across = [], []  # of east and of north
        for i in range(2):
            outwards, rightwards = self.outwards[..., i], self.rightwards[..., i]
            by_azimuth = self.by_azimuth_m * outwards + self.range_m * rightwards
            along.append(self.by_bistatic_range * outwards * sigma_bistatic_range_m)
            across.append(by_azimuth * sigma_azimuth)
        return (
            along[0] ** 2 + across[0] ** 2,
            along[1] ** 2 + across[1] ** 2,
            along[0] * along[1] + across[0] * across[1],
        )

    @nan_without_warnings
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


@nan_without_warnings
def flat_solution(
    bistatic_range_m: Floats, azimuth_deg: Floats, transmitter_enu_m: Floats
) -> FlatSolution:
    """Where a target in the receiver's horizontal plane would be measured so (eqs 34, 35).

    (...), (...) and (..., 3). The transmitter may be above or below that plane. Undefined for a
    bistatic range of zero or less, which noise makes of targets near the baseline: NaN there.
    """
    outwards = aer_to_enu(azimuth_deg, 0.0, 1.0)
    rightwards = aer_to_enu(azimuth_deg + 90.0, 0.0, 1.0)
    baseline_m = distance_m(transmitter_enu_m)
    towards = transmitter_enu_m / baseline_m[..., None]
    angle_rad = 2 * np.arctan2(distance_m(outwards - towards), distance_m(outwards + towards))
    measured = np.where(bistatic_range_m > 0, bistatic_range_m, np.nan)
    range_m, by_range, by_angle = propagation.range_from_bistatic(
        measured, baseline_m, np.degrees(angle_rad)
    )
    # The angle to the baseline turns with the azimuth, the less the higher the transmitter is.
    sine = np.sin(angle_rad)
    turn = np.where(sine > 0, -dot(rightwards, towards) / sine, 0.0)
    return FlatSolution(
        outwards=outwards,
        rightwards=rightwards,
        range_m=range_m,
        by_bistatic_range=by_range,
        by_azimuth_m=by_angle * turn,
    )


# Gauss and Hermite: exact for polynomials in the height up to the order 13.
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(7)
SHARES = (WEIGHTS / WEIGHTS.sum())[:, None]


@nan_without_warnings
def ground_range_m(
    bistatic_range_m: Floats, azimuth_deg: Floats, transmitter_enu_m: Floats, height_m: Floats
) -> Floats:
    """Distance over the ground of a target so high above the receiver, measured so; (...).

    In the receiver's horizontal plane, (...), (...) and (..., 3) in. NaN where a target of that
    height cannot have that bistatic range. It solves r + |p - t| = e + |t| for p = (d u, h).
    """
    transmitter_east_m, transmitter_north_m, transmitter_up_m = np.moveaxis(
        transmitter_enu_m, -1, 0
    )
    baseline_m = np.sqrt(dot(transmitter_enu_m, transmitter_enu_m))
    outwards = aer_to_enu(azimuth_deg, 0.0, 1.0)
    along_m = transmitter_east_m * outwards[..., 0] + transmitter_north_m * outwards[..., 1]
    total_m = bistatic_range_m + baseline_m
    a_m2 = bistatic_range_m * (bistatic_range_m + 2 * baseline_m) / 2 + height_m * transmitter_up_m
    denominator_m2 = (bistatic_range_m + (baseline_m - along_m)) * (total_m + along_m)
    under_root = a_m2 * a_m2 - height_m * height_m * denominator_m2
    ground_m = (a_m2 * along_m + total_m * np.sqrt(under_root)) / denominator_m2
    is_there = (bistatic_range_m > 0) & (a_m2 > 0) & (ground_m >= 0)
    return np.where(is_there, ground_m, np.nan)


@dataclass(frozen=True, slots=True)
class HeightPrior:
    """Heights of targets above the receiver's horizontal plane, as the sensor expects them: normal.

    Of many sensors they are columns, (n,).
    """

    mean_m: float | Floats
    sigma_m: float | Floats

    @nan_without_warnings
    def ground_range_m(
        self, bistatic_range_m: Floats, azimuth_deg: Floats, transmitter_enu_m: Floats
    ) -> tuple[Floats, Floats]:
        """Mean of the distance over the ground under the prior, and its variance by the height.

        (n,), (n,) and (n, 3) in, (n,) out: of those heights that are possible. NaN if none is.
        """
        height_m = self.mean_m + self.sigma_m * NODES[:, None]
        ground_m = ground_range_m(bistatic_range_m, azimuth_deg, transmitter_enu_m, height_m)
        share = np.where(np.isnan(ground_m), 0.0, SHARES)
        ground_m = np.nan_to_num(ground_m)
        whole = share.sum(axis=0)
        mean_m = (share * ground_m).sum(axis=0) / whole
        variance_m2 = (share * (ground_m - mean_m) ** 2).sum(axis=0) / whole
        return mean_m, variance_m2

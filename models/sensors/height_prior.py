"""What a sensor without elevation makes of heights that it does not know: a prior, integrated over.

A passive radar measures a bistatic range and an azimuth. Where that is on the ground depends on how
high the target is, which is taken as normal with a stated mean and standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plotfeed.models.frames import aer_to_enu
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.propagation import dot
from plotfeed.models.state import Floats

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

"""Measurement errors: what noise leaves of a measurement, floors, and folding over the zenith.

`snr` is the linear signal-to-noise ratio of the very detection, not the mean of a fluctuating
target. No signal gives an infinite sigma, an infinite one gives zero: hence the floors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.frames import wrap_180, wrap_360
from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.state import Floats

RANGE_CONSTANT = 1.63
ANGLE_CONSTANT = 1.6
"""Constant of the angles, for that of eqs 14 and 15, 14 % above the Cramer-Rao bound (Barton)."""


@nan_without_warnings
def noise_share(snr: ArrayLike) -> Floats:
    """What the errors by noise are proportional to, 1/sqrt(2 S); NaN for a negative ratio."""
    return 1.0 / np.sqrt(2 * as_floats(snr))


def sigma_range_m(snr: ArrayLike, resolution_m: ArrayLike) -> Floats:
    """Standard deviation of the range, metres (eq 13); NaN for a negative ratio."""
    return noise_share(snr) * (as_floats(resolution_m) / RANGE_CONSTANT)


def sigma_angle_deg(snr: ArrayLike, beamwidth_deg: ArrayLike) -> Floats:
    """Standard deviation of an angle, degrees, by a beam of that 3 dB width (Barton)."""
    return noise_share(snr) * (as_floats(beamwidth_deg) / ANGLE_CONSTANT)


def sigma_rate_m_s(snr: ArrayLike, resolution_m_s: ArrayLike) -> Floats:
    """Standard deviation of a range rate, m/s, by Doppler cells of that width.

    With the constant of the angles; the Cramer-Rao bound of a steady tone has pi/sqrt 3, 1.81.
    """
    return noise_share(snr) * (as_floats(resolution_m_s) / ANGLE_CONSTANT)


@nan_without_warnings
def with_floor(sigma: ArrayLike, floor: ArrayLike) -> Floats:
    """Noise and an independent error that no signal removes, in quadrature; same unit."""
    if np.ndim(floor) == 0 and floor == 0:
        return as_floats(sigma)
    noise, rest = as_floats(sigma), as_floats(floor)
    return np.sqrt(noise * noise + rest * rest)


@nan_without_warnings
def fold_over_zenith(azimuth_deg: ArrayLike, elevation_deg: ArrayLike) -> tuple[Floats, Floats]:
    """Direction with its elevation folded into +-90 and its azimuth into [0, 360), degrees.

    Noise may carry an elevation past the zenith or the nadir: it comes down on the other side.
    """
    if (np.abs(elevation_deg) <= 90).all():  # as nearly always
        return wrap_360(azimuth_deg), as_floats(elevation_deg)
    elevation = wrap_180(elevation_deg)
    over = np.abs(elevation) > 90
    folded = np.where(over, np.copysign(180.0, elevation) - elevation, elevation)
    azimuth = wrap_360(as_floats(azimuth_deg) + np.where(over, 180.0, 0.0))
    return azimuth, folded

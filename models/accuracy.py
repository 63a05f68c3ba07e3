"""Measurement errors: what noise leaves, floors, folding over the zenith, and covariances.

`snr` is the linear signal-to-noise ratio of the very detection, not the mean of a fluctuating
target. No signal gives an infinite sigma, an infinite one gives zero: hence the floors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.frames import wrap_180, wrap_360
from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.state import Floats, Plots

RANGE_CONSTANT = 1.63
# Of the angles, for that of eqs 14 and 15 (Barton); by a 3 dB width the bound is 1.607.
ANGLE_CONSTANT = 1.6
# Of a steady tone over the whole time, by the cell 1/T: the Cramer-Rao bound, 1.814.
RATE_CONSTANT = float(np.pi / np.sqrt(3))


@nan_without_warnings
def noise_share(snr: ArrayLike) -> Floats:
    """What the errors by noise are proportional to, 1/sqrt(2 S); NaN for a negative ratio."""
    return 1.0 / np.sqrt(2 * as_floats(snr))


def sigma_range_m(snr: ArrayLike, resolution_m: ArrayLike, floor_m: ArrayLike = 0.0) -> Floats:
    """Standard deviation of the range, metres (eq 13), and a floor; NaN for a negative ratio."""
    return with_floor(noise_share(snr) * (as_floats(resolution_m) / RANGE_CONSTANT), floor_m)


def sigma_angle_deg(snr: ArrayLike, beamwidth_deg: ArrayLike, floor_deg: ArrayLike = 0.0) -> Floats:
    """Standard deviation of an angle, degrees, by a beam of that 3 dB width (Barton), and floor."""
    return with_floor(noise_share(snr) * (as_floats(beamwidth_deg) / ANGLE_CONSTANT), floor_deg)


def sigma_rate_m_s(snr: ArrayLike, resolution_m_s: ArrayLike) -> Floats:
    """Standard deviation of a range rate, m/s, by Doppler cells of that width: wavelength/2T.

    Their 3 dB width is 0.886 of that, and by it the constant is that of the angles.
    """
    return noise_share(snr) * (as_floats(resolution_m_s) / RATE_CONSTANT)


@nan_without_warnings
def paired_snr(snr: ArrayLike) -> Floats:
    """Ratio of the product of two channels, each of that ratio a sample: 2 S^2/(1 + 2 S).

    The phase between them, over M samples, errs by 1/sqrt(M times that): 1/sqrt(S M) where signals
    are strong, for both channels have noise, and more where noise meets noise. NaN below zero.
    """
    ratio = as_floats(snr)
    return np.where(ratio >= 0, ratio / (1 + 0.5 / ratio), np.nan)


@nan_without_warnings
def snr_of_pair(paired: ArrayLike) -> Floats:
    """The ratio of either channel of which `paired_snr` is that one."""
    half = as_floats(paired) / 2
    return np.asarray(half + np.sqrt(half * (half + 1)))


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


def stated_covariance_m2(plots: Plots) -> Floats:
    """East, north and up of the sensor; (n, 3, 3). Nothing of a height that is not measured.

    Of a level covariance where the sensor states one, else of range, azimuth and elevation. NaN
    for an error without bounds.
    """
    level_m2 = np.zeros((len(plots), 3, 3))
    level_m2[:, 0, 0] = plots.covariance_east_m2
    level_m2[:, 1, 1] = plots.covariance_north_m2
    level_m2[:, 0, 1] = level_m2[:, 1, 0] = plots.covariance_east_north_m2
    is_polar = np.isnan(plots.covariance_east_m2)[:, None, None]
    covariance_m2 = np.where(is_polar, polar_covariance_m2(plots), level_m2)
    covariance_m2[~np.isfinite(covariance_m2).all(axis=(1, 2))] = np.nan
    return covariance_m2


def polar_covariance_m2(plots: Plots) -> Floats:
    """Covariance to first order in the errors of range and angles, along their directions."""
    azimuth = np.radians(plots.azimuth_deg)
    elevation = np.radians(np.nan_to_num(plots.elevation_deg))
    sin_az, cos_az = np.sin(azimuth), np.cos(azimuth)
    sin_el, cos_el = np.sin(elevation), np.cos(elevation)
    along = np.stack([sin_az * cos_el, cos_az * cos_el, sin_el])
    right = np.stack([cos_az, -sin_az, np.zeros(len(plots))])
    above = np.stack([-sin_az * sin_el, -cos_az * sin_el, cos_el])
    with np.errstate(invalid="ignore"):
        spread_m = np.stack(
            [
                along * plots.sigma_range_m,
                right * plots.range_m * cos_el * np.radians(plots.sigma_azimuth_deg),
                above * plots.range_m * np.radians(np.nan_to_num(plots.sigma_elevation_deg)),
            ]
        )
        covariance_m2: Floats = np.einsum("kin,kjn->nij", spread_m, spread_m)
    return covariance_m2

"""The errors of a position that the sensor states with its plot, as a covariance."""

from __future__ import annotations

import numpy as np

from plotfeed.models.state import Floats, Plots


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
    covariance_m2 = np.where(is_polar, _polar_covariance_m2(plots), level_m2)
    covariance_m2[~np.isfinite(covariance_m2).all(axis=(1, 2))] = np.nan
    return covariance_m2


def _polar_covariance_m2(plots: Plots) -> Floats:
    """To first order in the errors of range and angles, along the directions in which they go."""
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

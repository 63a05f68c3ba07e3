"""Plots on the Earth: latitude, longitude and height, and the errors of these."""

from __future__ import annotations

import numpy as np

from plotfeed.models.constants import WGS84_A_M
from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.models.state import Floats, Plots
from plotfeed.proto.sapient.locations import Positions

MAX_SIGMA_DEG = 180.0


def positions_of(plots: Plots, frame: LocalFrame) -> Positions:
    """NaN for plots without azimuth, elevation or range."""
    enu_m = aer_to_enu(plots.azimuth_deg, plots.elevation_deg, plots.range_m)
    latitude_deg, longitude_deg, height_m = frame.to_geodetic(enu_m)
    east_m, north_m, up_m = _sigmas_enu_m(plots)
    return Positions(
        longitude_deg=longitude_deg,
        latitude_deg=latitude_deg,
        height_m=height_m,
        sigma_longitude_deg=_degrees(east_m, latitude_deg),
        sigma_latitude_deg=_degrees(north_m),
        sigma_height_m=up_m,
    )


def somewhere_near(plots: Plots, frame: LocalFrame, range_max_m: float) -> Positions:
    """Of plots that say neither where nor how far: at the sensor, give or take its range.

    A disc of even probability has a standard deviation of half its radius along each axis.
    """
    n = len(plots)
    sigma_m = np.full(n, range_max_m / 2)
    latitude_deg = np.full(n, frame.latitude_deg)
    return Positions(
        longitude_deg=np.full(n, frame.longitude_deg),
        latitude_deg=latitude_deg,
        height_m=np.full(n, np.nan),
        sigma_longitude_deg=_degrees(sigma_m, latitude_deg),
        sigma_latitude_deg=_degrees(sigma_m),
        sigma_height_m=np.full(n, np.nan),
    )


def _sigmas_enu_m(plots: Plots) -> tuple[Floats, Floats, Floats]:
    """Errors along east, north and up, to first order in those of range and angles.

    Up is the sensor's: at 20 km the target's own is 0.2 degrees away.
    """
    azimuth, elevation = np.radians(plots.azimuth_deg), np.radians(plots.elevation_deg)
    along_m = plots.sigma_range_m
    across_m = plots.range_m * np.cos(elevation) * np.radians(plots.sigma_azimuth_deg)
    upwards_m = plots.range_m * np.radians(plots.sigma_elevation_deg)
    level_m = np.hypot(along_m * np.cos(elevation), upwards_m * np.sin(elevation))
    return (
        np.hypot(level_m * np.sin(azimuth), across_m * np.cos(azimuth)),
        np.hypot(level_m * np.cos(azimuth), across_m * np.sin(azimuth)),
        np.hypot(along_m * np.sin(elevation), upwards_m * np.cos(elevation)),
    )


def _degrees(metres: Floats, latitude_deg: Floats | None = None) -> Floats:
    """Metres along a meridian, or along a parallel, as degrees; an error needs no ellipsoid."""
    share = 1.0 if latitude_deg is None else np.cos(np.radians(latitude_deg))
    with np.errstate(divide="ignore"):
        degrees = np.degrees(metres / (WGS84_A_M * share))
    return np.minimum(degrees, MAX_SIGMA_DEG)

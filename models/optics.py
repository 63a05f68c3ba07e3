"""What a camera resolves: angles a pixel, cycles on a target, and how well a task is done by them.

Cycles are pairs of lines, two pixels each, across the target's size (Johnson 1958).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import expit, ndtr, ndtri

from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.state import Bools, Floats

# The meteorological optical range is where a twentieth of contrast is left (WMO-No. 8).
LN_20 = float(np.log(20.0))


def pixel_angle_rad(field_deg: ArrayLike, pixels: ArrayLike) -> Floats:
    """Angle that a pixel sees in the middle of a flat picture of that whole field of view."""
    return 2 * np.tan(np.radians(field_deg) / 2) / as_floats(pixels)


def field_of_pixels_deg(angle_rad: ArrayLike, pixels: ArrayLike) -> Floats:
    """Field of view of so many pixels of a flat picture; the inverse of `pixel_angle_rad`."""
    return 2 * np.degrees(np.arctan(as_floats(angle_rad) * as_floats(pixels) / 2))


@nan_without_warnings
def cycles_on_target(size_m: ArrayLike, range_m: ArrayLike, angle_rad: ArrayLike) -> Floats:
    """Cycles across a target of that size: half its pixels."""
    return as_floats(size_m) / (2 * as_floats(range_m) * as_floats(angle_rad))


@nan_without_warnings
def task_probability(cycles: ArrayLike, cycles_50: ArrayLike) -> Floats:
    """Probability that a task is done with those cycles, of which `cycles_50` do for one half.

    x^E/(1 + x^E), E = 2.7 + 0.7x, of x = N/N50: the target transfer probability function.
    """
    x = as_floats(cycles) / as_floats(cycles_50)
    return np.asarray(expit((2.7 + 0.7 * x) * np.log(x)))


@nan_without_warnings
def transmission(range_m: ArrayLike, visibility_m: ArrayLike) -> Floats:
    """Share of contrast that the air leaves, by the meteorological optical range (Koschmieder)."""
    return np.exp(-LN_20 * as_floats(range_m) / as_floats(visibility_m))


@nan_without_warnings
def resolved_share(contrast: ArrayLike, threshold: ArrayLike, at_nyquist: ArrayLike) -> Floats:
    """Share of a camera's finest detail that a contrast suffices for, 0 to 1.

    The contrast that is needed rises exponentially with the frequency, from the threshold for
    coarse detail to `at_nyquist` for the finest that pixels can hold.
    """
    decades = np.log(as_floats(at_nyquist) / as_floats(threshold))
    return np.clip(np.log(as_floats(contrast) / as_floats(threshold)) / decades, 0.0, 1.0)


@nan_without_warnings
def hot_spot_pd(ratio: ArrayLike, pfa: ArrayLike) -> Floats:
    """Pd of a spot so many times the noise of its pixel, with that Pfa a pixel."""
    return np.asarray(ndtr(ndtri(as_floats(pfa)) + as_floats(ratio)))


def picture_axes(
    position_enu_m: Floats, pan_deg: ArrayLike, tilt_deg: ArrayLike
) -> tuple[Floats, Floats, Floats]:
    """Places to the right of, above, and along the line of sight of a camera; (n, 3), (n,) each."""
    east_m, north_m, up_m = position_enu_m.T
    pan, tilt = np.radians(pan_deg), np.radians(tilt_deg)
    level_m = east_m * np.sin(pan) + north_m * np.cos(pan)
    right_m = east_m * np.cos(pan) - north_m * np.sin(pan)
    along_m = level_m * np.cos(tilt) + up_m * np.sin(tilt)
    above_m = up_m * np.cos(tilt) - level_m * np.sin(tilt)
    return np.asarray(right_m), np.asarray(above_m), np.asarray(along_m)


def directions_enu(right: Floats, above: Floats, pan_deg: ArrayLike, tilt_deg: ArrayLike) -> Floats:
    """Directions of points of a picture, of which `picture_axes` are those and 1; (n, 3)."""
    pan, tilt = np.radians(pan_deg), np.radians(tilt_deg)
    level = np.cos(tilt) - above * np.sin(tilt)
    east = right * np.cos(pan) + level * np.sin(pan)
    north = level * np.cos(pan) - right * np.sin(pan)
    return np.stack([east, north, np.sin(tilt) + above * np.cos(tilt)], axis=-1)


def in_picture(
    position_enu_m: Floats,
    pan_deg: ArrayLike,
    tilt_deg: ArrayLike,
    horizontal_deg: ArrayLike,
    vertical_deg: ArrayLike,
) -> Bools:
    """Whether places (n, 3) are in a flat picture of those whole fields of view."""
    right_m, above_m, along_m = picture_axes(position_enu_m, pan_deg, tilt_deg)
    half_right, half_above = (np.tan(np.radians(a) / 2) for a in (horizontal_deg, vertical_deg))
    inside = (np.abs(right_m) <= along_m * half_right) & (np.abs(above_m) <= along_m * half_above)
    return np.asarray((along_m > 0) & inside)

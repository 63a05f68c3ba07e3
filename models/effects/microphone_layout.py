"""Microphones in a line, a circle or a rectangle, and how well their phases tell a direction.

The microphones lie level. A plane wave of one wavelength meets the i-th with the phase k w.p_i,
where w is the direction's projection on the plane, cos(elevation) long. By microphones whose ratios
add up to S the Cramer-Rao bound of w has the covariance (2 S k^2 G)^-1, G the mean square of the
places about their centre (Stoica and Nehorai, IEEE Trans. ASSP 37(5), 1989, of one source). So a
plane of them knows elevations badly near the horizon, and a line knows its angle to the wave alone:
not the side that this comes from, nor how high.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from plotfeed.models import accuracy
from plotfeed.models.frames import wrap_360
from plotfeed.models.state import Bools, Floats


@dataclass(frozen=True, kw_only=True)
class MicrophoneLayout:
    """`spacing_m` is between neighbours; `azimuth_deg` where the line, or longer side, points."""

    shape: Literal["line", "circle", "rectangle"]
    microphones: int
    spacing_m: float
    azimuth_deg: float
    wavelength_m: float

    @cached_property
    def places_m(self) -> Floats:
        """East and north of the array's centre; (N, 2)."""
        n, d = self.microphones, self.spacing_m
        if self.shape == "circle":
            angles = 2 * np.pi * np.arange(n) / n
            radius_m = d / (2 * np.sin(np.pi / n))
            along, across = radius_m * np.cos(angles), radius_m * np.sin(angles)
        else:
            rows = 1
            if self.shape == "rectangle":
                rows = max(k for k in range(1, int(n**0.5) + 1) if n % k == 0)
            number = np.arange(n)
            along = (number // rows - (n // rows - 1) / 2) * d
            across = (number % rows - (rows - 1) / 2) * d
        azimuth = np.radians(self.azimuth_deg)
        towards, right = (np.sin(azimuth), np.cos(azimuth)), (np.cos(azimuth), -np.sin(azimuth))
        return np.asarray(np.outer(along, towards) + np.outer(across, right))

    @property
    def is_line(self) -> bool:
        """Whether it tells neither sides nor elevations."""
        return self.shape == "line"

    def sigmas_deg(
        self, azimuth_deg: Floats, elevation_deg: Floats, snr: Floats
    ) -> tuple[Floats, Floats]:
        """Standard deviations of azimuth and elevation there, by the array's ratio; (n,) each.

        To first order, and bounded where that is not enough. Elevations of a line are NaN.
        """
        azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
        if self.is_line:
            spread = self._spread(np.radians(self.azimuth_deg), snr)
            sine2 = 1 - (np.cos(elevation) * np.cos(azimuth - np.radians(self.azimuth_deg))) ** 2
            return _bounded_deg(spread, sine2), np.full(len(snr), np.nan)
        across, along = self._spread(azimuth + np.pi / 2, snr), self._spread(azimuth, snr)
        level = np.cos(elevation)
        sigma_azimuth_deg = np.degrees(across / np.hypot(level, across))
        return sigma_azimuth_deg, _bounded_deg(along, np.sin(elevation) ** 2)

    def measured(
        self,
        azimuth_deg: Floats,
        elevation_deg: Floats,
        snr: Floats,
        in_cover: Callable[[Floats], Bools],
        rng: np.random.Generator,
    ) -> tuple[Floats, Floats]:
        """Directions as measured of sounds from those; (n,) each.

        Of a line they are level, on the side that `in_cover` has; if it has both or none, on any.
        """
        azimuth, level = np.radians(azimuth_deg), np.cos(np.radians(elevation_deg))
        normals = rng.standard_normal((2, len(snr)))
        if self.is_line:
            axis = np.radians(self.azimuth_deg)
            noisy = level * np.cos(azimuth - axis) + normals[0] * self._spread(axis, snr)
            angle_deg = np.degrees(np.arccos(np.clip(noisy, -1.0, 1.0)))
            sides_deg = self.azimuth_deg + np.stack([angle_deg, -angle_deg])
            right, left = in_cover(wrap_360(sides_deg))
            either = rng.random((len(snr),)) < 0.5
            on_the_right = np.where(right == left, either, right)
            return np.where(on_the_right, sides_deg[0], sides_deg[1]), np.zeros(len(snr))
        errors = self._error_shape @ (normals * accuracy.noise_share(snr))
        east, north = level * np.sin(azimuth) + errors[0], level * np.cos(azimuth) + errors[1]
        found_deg = np.degrees(np.arccos(np.minimum(np.hypot(east, north), 1.0)))
        return np.degrees(np.arctan2(east, north)), found_deg

    @cached_property
    def _error_shape(self) -> Floats:
        """What makes errors of w of normals, for 1/sqrt(2 S) of one; (2, 2)."""
        wave_number = 2 * np.pi / self.wavelength_m
        square_m2 = np.asarray(self.places_m.T @ self.places_m / self.microphones)
        return np.asarray(np.linalg.cholesky(np.linalg.inv(wave_number**2 * square_m2)))

    def _spread(self, azimuth: Floats | float, snr: Floats) -> Floats:
        """Standard deviation of w along an azimuth, radians."""
        along = np.stack([np.sin(azimuth), np.cos(azimuth)])
        if self.is_line:
            wave_number = 2 * np.pi / self.wavelength_m
            rms_m = np.sqrt(np.mean((self.places_m @ along) ** 2))
            return np.asarray(accuracy.noise_share(snr) / (wave_number * rms_m))
        shape = self._error_shape.T @ along
        return np.asarray(accuracy.noise_share(snr) * np.hypot(shape[0], shape[1]))


def _bounded_deg(spread: Floats, sine2: Floats) -> Floats:
    """Error of an angle whose cosine has that one; where the sine is lost, its root."""
    return np.asarray(np.degrees(spread / np.sqrt(sine2 + spread)))

"""Two rays over flat ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.propagation import two_ray_factor
from plotfeed.models.state import Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Multipath:
    """The ground's reflection coefficient, -1 to 1, and how far it lies below the antenna.

    The antenna is taken to radiate and to hear as much along either ray.
    """

    reflection: float
    antenna_height_m: float

    def power_factor(
        self, place_enu_m: Floats, wavelength_m: ArrayLike, from_enu_m: ArrayLike = (0.0, 0.0, 0.0)
    ) -> Floats:
        """Factor of power one way between places, (..., 3), east, north and up; (...) out."""
        other_enu_m = np.asarray(from_enu_m, dtype=np.float64)
        offset_m = place_enu_m - other_enu_m
        return two_ray_factor(
            self.antenna_height_m + other_enu_m[..., 2],
            self.antenna_height_m + place_enu_m[..., 2],
            np.hypot(offset_m[..., 0], offset_m[..., 1]),
            wavelength_m,
            self.reflection,
        )


@dataclass(frozen=True, slots=True)
class NoiseLine:
    """A median noise figure, c - d log10(f / MHz), and the frequencies for which it is given."""

    c_db: float
    d_db: float
    min_mhz: float
    max_mhz: float

    @nan_without_warnings
    def median_db(self, frequency_hz: ArrayLike) -> Floats:
        """F_am, dB; NaN outside the line's frequencies."""
        frequency_mhz = np.asarray(frequency_hz, dtype=np.float64) / 1e6
        given = (frequency_mhz >= self.min_mhz) & (frequency_mhz <= self.max_mhz)
        return np.where(given, self.c_db - self.d_db * np.log10(frequency_mhz), np.nan)


# P.372, man-made noise, table of c and d. The range 0.3 to 250 MHz is stated for the first three.
# The quiet rural line falls below galactic noise from 2 MHz on, and ends where that does.
MAN_MADE = {
    "city": NoiseLine(76.8, 27.7, 0.3, 250.0),
    "residential": NoiseLine(72.5, 27.7, 0.3, 250.0),
    "rural": NoiseLine(67.2, 27.7, 0.3, 250.0),
    "quiet-rural": NoiseLine(53.6, 28.6, 0.3, 100.0),
}
GALACTIC = NoiseLine(
    52.0, 23.0, 10.0, 100.0
)  # P.372; below some 10 MHz the ionosphere keeps it out


@nan_without_warnings
def external_noise_db(environment: str, frequency_hz: ArrayLike) -> Floats:
    """F_a, dB: the powers of man-made noise and, where it is given, of galactic noise.

    NaN where P.372 gives no man-made noise for that environment, one of `MAN_MADE`.
    """
    man_made = 10 ** (MAN_MADE[environment].median_db(frequency_hz) / 10)
    galactic = 10 ** (GALACTIC.median_db(frequency_hz) / 10)
    return 10 * np.log10(man_made + np.nan_to_num(galactic))

"""Air that weakens radio waves, rain that sends echoes back, and wind in microphones.

Rain by ITU-R P.838-3, gases by the approximations of ITU-R P.676-10, annex 2, near the ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.effects.echo_effects import EchoPaths
from plotfeed.models.frames import distance_m
from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.state import Floats

LN10_10 = np.log(10) / 10  # Nepers of power in a decibel
# Of a cell's volume R^2 az el dR, what two-way Gaussian beams of those 3 dB widths see.
BEAM_FILLING = np.pi / (8 * np.log(2))
DIELECTRIC = 0.93  # |K|^2 of water at centimetres
NEAREST_M = 1.0
GASES_TO_HZ = 54e9  # Up to here oxygen is by its lines at 60 GHz from one side


class _Sum(NamedTuple):
    """Coefficients of P.838: rows of a, b and c of each bell, then the line's slope and offset."""

    bells: tuple[tuple[float, float, float], ...]
    slope: float
    offset: float

    def at(self, log_ghz: Floats) -> Floats:
        """The sum at logarithms of frequencies."""
        bells = sum(a * np.exp(-(((log_ghz - b) / c) ** 2)) for a, b, c in self.bells)
        return np.asarray(bells + self.slope * log_ghz + self.offset)


# ITU-R P.838-3, tables 1 to 4.
LOG_K = {
    "horizontal": _Sum(
        (
            (-5.33980, -0.10008, 1.13098),
            (-0.35351, 1.26970, 0.45400),
            (-0.23789, 0.86036, 0.15354),
            (-0.94158, 0.64552, 0.16817),
        ),
        -0.18961,
        0.71147,
    ),
    "vertical": _Sum(
        (
            (-3.80595, 0.56934, 0.81061),
            (-3.44965, -0.22911, 0.51059),
            (-0.39902, 0.73042, 0.11899),
            (0.50167, 1.07319, 0.27195),
        ),
        -0.16398,
        0.63297,
    ),
}
ALPHA = {
    "horizontal": _Sum(
        (
            (-0.14318, 1.82442, -0.55187),
            (0.29591, 0.77564, 0.19822),
            (0.32177, 0.63773, 0.13164),
            (-5.37610, -0.96230, 1.47828),
            (16.1721, -3.29980, 3.43990),
        ),
        0.67849,
        -1.95537,
    ),
    "vertical": _Sum(
        (
            (-0.07771, 2.33840, -0.76284),
            (0.56727, 0.95545, 0.54039),
            (-0.20238, 1.14520, 0.26809),
            (-48.2991, 0.791669, 0.116226),
            (48.5833, 0.791459, 0.116479),
        ),
        -0.053739,
        0.83433,
    ),
}


@nan_without_warnings
def rain_coefficients(frequency_hz: ArrayLike, polarisation: str) -> tuple[Floats, Floats]:
    """K and alpha of rain, of a level path; polarisation horizontal, vertical or circular."""
    log_ghz = np.log10(as_floats(frequency_hz) / 1e9)
    if polarisation != "circular":
        return 10 ** LOG_K[polarisation].at(log_ghz), ALPHA[polarisation].at(log_ghz)
    (k_h, a_h), (k_v, a_v) = (rain_coefficients(frequency_hz, p) for p in LOG_K)
    k = (k_h + k_v) / 2
    return k, (k_h * a_h + k_v * a_v) / (2 * k)


@nan_without_warnings
def rain_db_per_km(
    frequency_hz: ArrayLike, rain_mm_h: ArrayLike, polarisation: str = "horizontal"
) -> Floats:
    """Attenuation by rain one way, dB/km; 1 to 1000 GHz."""
    k, alpha = rain_coefficients(frequency_hz, polarisation)
    return np.asarray(k * as_floats(rain_mm_h) ** alpha)


@nan_without_warnings
def gases_db_per_km(frequency_hz: ArrayLike, vapour_g_m3: ArrayLike) -> Floats:
    """Attenuation by oxygen and water vapour one way, dB/km, at 1013 hPa and 15 C; NaN from 54 GHz.

    P.676-10, annex 2, eqs 22a and 23 with r_p = r_t = 1.
    """
    f, vapour = as_floats(frequency_hz) / 1e9, as_floats(vapour_g_m3)
    oxygen = (7.2 / (f**2 + 0.34) + 0.62 / ((54 - f) ** 1.16 + 0.83)) * f**2 * 1e-3
    eta_1, eta_2 = 0.955 + 0.006 * vapour, 0.735 + 0.0353 * vapour

    def side(line_ghz: float) -> Floats:
        return np.asarray(1 + ((f - line_ghz) / (f + line_ghz)) ** 2)

    lines = (
        3.98 * eta_1 / ((f - 22.235) ** 2 + 9.42 * eta_1**2) * side(22)
        + 11.96 * eta_1 / ((f - 183.31) ** 2 + 11.14 * eta_1**2)
        + 0.081 * eta_1 / ((f - 321.226) ** 2 + 6.29 * eta_1**2)
        + 3.66 * eta_1 / ((f - 325.153) ** 2 + 9.22 * eta_1**2)
        + 25.37 * eta_1 / (f - 380) ** 2
        + 17.4 * eta_1 / (f - 448) ** 2
        + 844.6 * eta_1 / (f - 557) ** 2 * side(557)
        + 290 * eta_1 / (f - 752) ** 2 * side(752)
        + 8.3328e4 * eta_2 / (f - 1780) ** 2 * side(1780)
    )
    known = as_floats(frequency_hz) < GASES_TO_HZ
    return np.where(known, oxygen + lines * f**2 * vapour * 1e-4, np.nan)


@nan_without_warnings
def rain_reflectivity_m2_m3(wavelength_m: ArrayLike, rain_mm_h: ArrayLike) -> Floats:
    """Radar cross-section of a cubic metre of rain: Z = 200 R^1.6 (Marshall and Palmer 1948)."""
    z_m3 = 200 * as_floats(rain_mm_h) ** 1.6 * 1e-18
    return np.asarray(np.pi**5 * DIELECTRIC * z_m3 / as_floats(wavelength_m) ** 4)


@nan_without_warnings
def wind_noise_db(wind_m_s: ArrayLike, frequency_hz: ArrayLike, screen_m: ArrayLike) -> Floats:
    """Level in a third of an octave of wind at a microphone behind a screen, dB re 20 uPa.

    40 lg V - 23 lg(f D/V) + 15 (Strasberg 1988), given for f D/V from 0.1 to 5, and beyond in line;
    -inf without wind.
    """
    wind = as_floats(wind_m_s)
    strouhal = as_floats(frequency_hz) * as_floats(screen_m) / wind
    return np.where(wind > 0, 40 * np.log10(wind) - 23 * np.log10(strouhal) + 15, -np.inf)


@dataclass(frozen=True)
class Air:
    """Attenuation one way, dB/km, the same everywhere, of each signal."""

    db_per_km: tuple[float, ...]

    def power_factor(self, paths: EchoPaths) -> Floats:
        """What is left of echoes on both of their ways; (n, K)."""
        back_m = distance_m(paths.place_enu_m)
        if paths.transmitters_enu_m is None:
            ways_m = np.repeat(2 * back_m[:, None], len(self.db_per_km), axis=1)
        else:
            out_m = [distance_m(paths.place_enu_m - each) for each in paths.transmitters_enu_m]
            ways_m = np.stack(out_m, axis=-1) + back_m[:, None]
        return np.asarray(np.exp(-LN10_10 * ways_m / 1000 * np.array(self.db_per_km)))


@dataclass(frozen=True, kw_only=True)
class RainEcho:
    """What rain in a cell sends back, over noise at 1 m, as if no filter helped; in air like that.

    Its power goes with the volume of the cell, as R^-2 where that of a target goes as R^-4.
    """

    over_noise_at_1_m: float
    db_per_km: float

    @classmethod
    def of(
        cls,
        snr_of_unit: float,
        reflectivity_m2_m3: float,
        beams_rad2: float,
        cell_m: float,
        db_per_km: float,
    ) -> RainEcho:
        """The echo in a cell of those beams and depth, by the ratio of 1 m2 at 1 m."""
        volume_at_1_m = BEAM_FILLING * beams_rad2 * cell_m
        return cls(
            over_noise_at_1_m=snr_of_unit * reflectivity_m2_m3 * volume_at_1_m, db_per_km=db_per_km
        )

    def power_factor(self, paths: EchoPaths) -> Floats:
        """What is left of ratios, to noise and rain; (n, 1)."""
        range_m = np.maximum(distance_m(paths.place_enu_m), NEAREST_M)
        lost = np.exp(-LN10_10 * 2 * self.db_per_km * range_m / 1000)
        return np.asarray(1 / (1 + self.over_noise_at_1_m * lost / range_m**2))[:, None]

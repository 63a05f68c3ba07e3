"""What arrives of what is sent: radar equation, bistatic geometry, passive radar, radio, sound.

Gains, losses and levels are in dB, a loss or an attenuation positive unless it says otherwise;
powers in watts; ratios without `_db` linear. Zero distance gives an infinite power, not an error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.frames import distance_m
from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.state import Floats

C_M_S = 299_792_458.0  # m/s, exact (SI)
BOLTZMANN_J_K = 1.380649e-23  # J/K, exact (SI)
T0_K = 290.0  # K, the temperature at which noise figures are stated (IEEE)

# Effective over true radius of the Earth, of average air (ITU-R P.834).
USUAL_K = 4 / 3
NEAREST_M = 1.0  # Echoes, made for the far field, are not taken closer to an antenna than this
# What spreading both ways and the aperture of a target's echo divide by, beside the ways.
SPREAD = (4 * np.pi) ** 3
DIPOLE_GAIN_DBI = 2.15  # What effective radiated power is stated over: a half-wave dipole


@nan_without_warnings
def beam_gain_dbi(
    azimuth_beamwidth_deg: ArrayLike,
    elevation_beamwidth_deg: ArrayLike,
    efficiency: ArrayLike = 1.0,
) -> Floats:
    """Gain of a beam of these 3 dB widths; the sphere has 41253 square degrees (eqs 2, 3, 19)."""
    beam_deg2 = as_floats(azimuth_beamwidth_deg) * as_floats(elevation_beamwidth_deg)
    return 10 * np.log10(41253.0 * as_floats(efficiency) / beam_deg2)


@nan_without_warnings
def noise_density_w_hz(noise_figure_db: ArrayLike) -> Floats:
    """Thermal noise power in one hertz, watts (eq 5)."""
    return BOLTZMANN_J_K * T0_K * _ratio(noise_figure_db)


@nan_without_warnings
def radiated_w(power_w: ArrayLike, gains_db: ArrayLike) -> Floats:
    """Power with all gains; these less all losses."""
    return as_floats(power_w) * _ratio(gains_db)


@nan_without_warnings
def radar_snr(  # noqa: PLR0917 - the order of eq 1, fixed for callers
    power_w: ArrayLike,
    gain_tx_dbi: ArrayLike,
    gain_rx_dbi: ArrayLike,
    wavelength_m: ArrayLike,
    rcs_m2: ArrayLike,
    integration_s: ArrayLike,
    range_tx_m: ArrayLike,
    range_rx_m: ArrayLike,
    loss_db: ArrayLike,
    noise_figure_db: ArrayLike,
) -> Floats:
    """Mean signal-to-noise ratio, linear, after coherent integration (eqs 1, 17).

    `power_w` is the mean transmitted power; monostatic radars give the same range twice.
    """
    gains_db = as_floats(gain_tx_dbi) + as_floats(gain_rx_dbi) - as_floats(loss_db)
    aperture_m4 = as_floats(wavelength_m) ** 2 * as_floats(rcs_m2)
    spread_m4 = SPREAD * (as_floats(range_tx_m) * as_floats(range_rx_m)) ** 2
    echo_w = radiated_w(power_w, gains_db) * aperture_m4 / spread_m4
    return echo_w * as_floats(integration_s) / noise_density_w_hz(noise_figure_db)


@nan_without_warnings
def two_ray_factor(
    antenna_height_m: ArrayLike,
    target_height_m: ArrayLike,
    ground_range_m: ArrayLike,
    wavelength_m: ArrayLike,
    reflection: ArrayLike,
) -> Floats:
    """Power over flat ground beside that of free space, one way: F^2 = |1 + rho e^(j phi)|^2.

    `reflection`, rho, is real, from -1 to 1; phi is 2 pi over the wavelength times the detour of
    the reflected ray, 4 h1 h2/(d1 + d2). Heights are above the ground, and none is below it. An
    echo has the factor of its way out times that of its way back.
    """
    antenna, target = (np.maximum(as_floats(h), 0.0) for h in (antenna_height_m, target_height_m))
    ground = as_floats(ground_range_m)
    path_m = np.hypot(ground, antenna - target) + np.hypot(ground, antenna + target)
    product = antenna * target
    detour = np.where(product > 0, 4 * product / path_m, 0.0)  # a difference of roots loses digits
    half_phase = np.pi * detour / as_floats(wavelength_m)
    rho = as_floats(reflection)
    # Sums of squares alone: at grazing 1 + rho^2 + 2 rho cos phi would be a difference of ones.
    wave = np.where(rho < 0, np.sin(half_phase), np.cos(half_phase))
    return as_floats((1 - np.abs(rho)) ** 2 + 4 * np.abs(rho) * wave**2)


@nan_without_warnings
def bistatic_range(target_enu_m: ArrayLike, transmitter_enu_m: ArrayLike) -> Floats:
    """Path transmitter-target-receiver less the baseline, metres; (..., 3) in, (...) out.

    The receiver is the origin (eq 32). Accurate down to the baseline itself, where the plain
    sum loses every digit.
    """
    target, transmitter = as_floats(target_enu_m), as_floats(transmitter_enu_m)
    range_tx, range_rx = distance_m(target - transmitter), distance_m(target)
    baseline = distance_m(transmitter)
    sides = np.maximum(range_rx + baseline, np.finfo(np.float64).tiny)
    surplus = dot(target - transmitter, target + transmitter) / sides  # range_rx - baseline
    # Law of cosines, with range_rx baseline (1 - cos beta) from the cross product ahead.
    along, across = dot(target, transmitter), _length_of_cross(target, transmitter)
    sides_product = range_rx * baseline
    versine = np.where(along > 0, across**2 / (sides_product + along), sides_product - along)
    return np.where(surplus >= 0, range_tx + surplus, 2 * versine / (range_tx - surplus))


@nan_without_warnings
def range_from_bistatic(
    bistatic_range_m: ArrayLike, baseline_m: ArrayLike, angle_deg: ArrayLike
) -> tuple[Floats, Floats, Floats]:
    """Distance from the receiver, metres, of a bistatic range and the angle to the baseline.

    With its change with the bistatic range, and with the angle, metres/radian, by which errors of
    the measured pair are multiplied; infinite on the baseline. The angle is that at the receiver
    between target and transmitter, in space (eqs 33 to 35, right form). The distance is NaN on the
    baseline between the two, where every point has bistatic range 0.
    """
    excess, baseline = as_floats(bistatic_range_m), as_floats(baseline_m)
    half_rad = np.radians(as_floats(angle_deg)) / 2
    half_sine = np.sin(half_rad)
    depth = baseline * (2 * half_sine**2)  # the versed sine, 1 - cos, without the cancellation
    within = excess + depth
    divisor = 2 * within**2
    both_ways = excess * (excess + 2 * baseline)
    by_range = (excess**2 + 2 * depth * (excess + baseline)) / divisor
    by_angle = -both_ways * baseline * (2 * half_sine * np.cos(half_rad)) / divisor
    singular = (excess == 0) & (depth == 0)
    return (
        both_ways / (2 * within),
        np.where(singular, np.inf, by_range),
        np.where(singular, -np.inf, by_angle),
    )


@nan_without_warnings
def direct_signal_power_w(
    *,
    erp_w: ArrayLike,
    gain_rx_dbi: ArrayLike,
    sidelobe_db: ArrayLike,
    cancellation_db: ArrayLike,
    wavelength_m: ArrayLike,
    baseline_m: ArrayLike,
) -> Floats:
    """What is left of the broadcast itself (eqs 28, 29); side lobe and cancellation negative dB."""
    gains_db = DIPOLE_GAIN_DBI + as_floats(gain_rx_dbi) + as_floats(sidelobe_db)
    spread = (as_floats(wavelength_m) / (4 * np.pi * as_floats(baseline_m))) ** 2
    return as_floats(erp_w) * _ratio(gains_db + as_floats(cancellation_db)) * spread


@nan_without_warnings
def passive_noise_power_w(
    bandwidth_hz: ArrayLike,
    external_noise_db: ArrayLike,
    line_loss_db: ArrayLike = 0.5,
    antenna_loss_db: ArrayLike = 0.5,
    noise_figure_db: ArrayLike = 4.0,
) -> Floats:
    """Radio noise before the correlator (eqs 30, 31): external (ITU-R P.372) and the receiver's."""
    receiver_db = as_floats(line_loss_db) + as_floats(antenna_loss_db) + as_floats(noise_figure_db)
    factor = _ratio(external_noise_db) - 1 + _ratio(receiver_db)
    return BOLTZMANN_J_K * T0_K * as_floats(bandwidth_hz) * factor


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
        frequency_mhz = as_floats(frequency_hz) / 1e6
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
# P.372; below some 10 MHz the ionosphere keeps it out.
GALACTIC = NoiseLine(52.0, 23.0, 10.0, 100.0)


@nan_without_warnings
def external_noise_db(environment: str, frequency_hz: ArrayLike) -> Floats:
    """F_a, dB: the powers of man-made noise and, where it is given, of galactic noise.

    NaN where P.372 gives no man-made noise for that environment, one of `MAN_MADE`.
    """
    man_made = 10 ** (MAN_MADE[environment].median_db(frequency_hz) / 10)
    galactic = 10 ** (GALACTIC.median_db(frequency_hz) / 10)
    return 10 * np.log10(man_made + np.nan_to_num(galactic))


@nan_without_warnings
def correlated_snr(
    target_w: ArrayLike, disturbance_w: ArrayLike, time_bandwidth: ArrayLike
) -> Floats:
    """Signal-to-noise ratio after the correlator (eq 25): the echo disturbs itself, so BT caps it.

    `disturbance_w` sums clutter, direct signal and noise before the correlator.
    """
    return as_floats(time_bandwidth) / (1 + as_floats(disturbance_w) / as_floats(target_w))


@nan_without_warnings
def path_loss_db(
    range_m: ArrayLike,
    wavelength_m: ArrayLike,
    exponent: ArrayLike = 2.0,
    reference_m: ArrayLike = 1.0,
) -> Floats:
    """Loss between isotropic antennas: free space up to the reference distance (Friis).

    From there on log-distance, power falling with that exponent of distance; 2 is free space.
    Never a gain: nearer than a wavelength over 4 pi there is no far field.
    """
    distance, reference = as_floats(range_m), as_floats(reference_m)
    free_m = np.minimum(distance, reference)
    free_space_db = 20 * np.log10(4 * np.pi * free_m / as_floats(wavelength_m))
    beyond_db = 10 * as_floats(exponent) * np.log10(np.maximum(distance / reference, 1.0))
    return np.maximum(free_space_db + beyond_db, 0.0)


@nan_without_warnings
def speed_of_sound_m_s(temperature_c: ArrayLike) -> Floats:
    """Speed of sound in air (ISO 9613-1:1993, annex A)."""
    return as_floats(343.2 * np.sqrt((as_floats(temperature_c) + 273.15) / 293.15))


@nan_without_warnings
def sound_absorption_db_per_m(
    frequency_hz: ArrayLike,
    temperature_c: ArrayLike,
    humidity_pct: ArrayLike,
    pressure_kpa: ArrayLike,
) -> Floats:
    """Absorption of a pure tone by air, dB per metre (ISO 9613-1:1993); humidity is relative."""
    frequency = as_floats(frequency_hz)
    kelvin = as_floats(temperature_c) + 273.15
    warmth = kelvin / 293.15  # T/T0
    pressure = as_floats(pressure_kpa) / 101.325  # pa/pr
    saturation = 10 ** (-6.8346 * (273.16 / kelvin) ** 1.261 + 4.6151)  # annex B, B.2 and B.3
    h = as_floats(humidity_pct) * saturation / pressure  # molar concentration, %; B.1
    oxygen_hz = pressure * (24 + 4.04e4 * h * (0.02 + h) / (0.391 + h))  # eq 3
    nitrogen_shift = np.exp(-4.170 * (warmth ** (-1 / 3) - 1))
    nitrogen_hz = pressure / np.sqrt(warmth) * (9 + 280 * h * nitrogen_shift)  # eq 4
    classical = 1.84e-11 / pressure * np.sqrt(warmth)
    oxygen = 0.01275 * np.exp(-2239.1 / kelvin) / (oxygen_hz + frequency**2 / oxygen_hz)
    nitrogen = 0.1068 * np.exp(-3352.0 / kelvin) / (nitrogen_hz + frequency**2 / nitrogen_hz)
    return 8.686 * frequency**2 * (classical + warmth**-2.5 * (oxygen + nitrogen))  # eq 5


@nan_without_warnings
def sound_divergence_db(range_m: ArrayLike) -> Floats:
    """Spreading over the sphere, from the sound *power* level (eq 40; ISO 9613-2, 7.1)."""
    return 20 * np.log10(as_floats(range_m)) + 11


@nan_without_warnings
def ground_attenuation_db(mean_height_m: ArrayLike, range_m: ArrayLike) -> Floats:
    """Attenuation by the ground, never negative (eq 42; ISO 9613-2, 7.3.2).

    `mean_height_m` is the mean height of the path above the ground, `range_m` its slant length.
    """
    distance = as_floats(range_m)
    lift = 2 * as_floats(mean_height_m) / distance * (17 + 300 / distance)
    return np.maximum(4.8 - lift, 0.0)


@nan_without_warnings
def sound_level_db(
    power_level_db: ArrayLike, directivity_db: ArrayLike, attenuation_db: ArrayLike
) -> Floats:
    """Sound pressure level at the receiver (eq 37 in dB throughout; ISO 9613-2, eq 3)."""
    return as_floats(power_level_db) + as_floats(directivity_db) - as_floats(attenuation_db)


def _ratio(level_db: ArrayLike) -> Floats:
    return 10 ** (as_floats(level_db) / 10)


def dot(a: Floats, b: Floats) -> Floats:
    """Scalar products of vectors; (..., 3) in, (...) out."""
    return as_floats(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def _length_of_cross(a: Floats, b: Floats) -> Floats:
    x = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    y = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    z = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return as_floats(np.sqrt(x * x + y * y + z * z))

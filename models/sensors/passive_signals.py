"""The signals of a passive radar, channel by channel: equations 24 to 31 in right form.

External noise is that of ITU-R P.372.
"""

from __future__ import annotations

from abc import ABC
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models import accuracy, propagation
from plotfeed.models.beam import Volume
from plotfeed.models.detection import cells_across
from plotfeed.models.fluctuation import FluctuatingCfar
from plotfeed.models.frames import aer_to_enu, distance_m
from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.propagation import C_M_S, NEAREST_M, SPREAD
from plotfeed.models.sensors.polar_radar import EchoRadar
from plotfeed.models.sensors.sensor_model import sensor_property
from plotfeed.models.state import Floats

_AZIMUTHS = 3600  # How many the share of false alarms that have a place is averaged over


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Illuminator:
    """A transmitter of opportunity, east, north and up of the receiver.

    `external_noise_db` is what the receiver's antenna collects at its frequency, over k T0 B, and
    `range_floor_m` the error of bistatic ranges that no echo of its signal is too strong for.
    """

    erp_w: float
    frequency_hz: float
    bandwidth_hz: float
    position_enu_m: tuple[float, float, float]
    external_noise_db: float
    range_floor_m: float


@dataclass(frozen=True, kw_only=True)
class PassiveSignals(Volume, EchoRadar, ABC):
    """What the equations need. Side-lobe and cancellation levels are negative, losses positive."""

    transmitters: tuple[Illuminator, ...]
    azimuth_beamwidth_deg: float
    integration_s: float
    loss_db: float
    sidelobe_db: float
    cancellation_db: float
    line_loss_db: float
    antenna_loss_db: float
    receiver_noise_figure_db: float
    pfa: float
    n_reference: int
    doppler_cells: int
    azimuth_floor_deg: float

    @sensor_property
    def n_channels(self) -> int:
        """A channel a transmitter."""
        return len(self.transmitters)

    @property
    def other_ends_enu_m(self) -> Floats:
        """Where its transmitters are; (channels, 3)."""
        return self.positions_enu_m

    @sensor_property
    def positions_enu_m(self) -> Floats:
        """Places of the transmitters; (channels, 3)."""
        return np.array([t.position_enu_m for t in self.transmitters], dtype=np.float64)

    @sensor_property
    def range_resolution_m(self) -> Floats:
        """Resolution in bistatic range: c/B, not c/2B, for it sums two ways; (channels,)."""
        return C_M_S / self._each("bandwidth_hz")

    @sensor_property
    def range_floors_m(self) -> Floats:
        """Errors of bistatic range that remain; (channels,)."""
        return self._each("range_floor_m")

    @cached_property
    def resolution_cells(self) -> tuple[float, ...]:
        """Bistatic range cells x azimuth beams x Doppler cells, by channel (eq 9, right form)."""
        beams = cells_across(self.azimuth_cover.span_deg, self.azimuth_beamwidth_deg)
        range_cells = [cells_across(self.range_max_m, m) for m in self.range_resolution_m.tolist()]
        return tuple(n * beams * self.doppler_cells for n in range_cells)

    @property
    def false_alarms_per_scan(self) -> float:
        """Mean number of false plots: what the detectors let through (eq 9) and has a place."""
        return float(self.pfa * np.array(self.alarm_cells) @ self.placed_shares)

    @property
    def alarm_pfa(self) -> float:
        """Probability of a false alarm of a cell in a scan."""
        return self.pfa

    @property
    def alarm_cells(self) -> tuple[float, ...]:
        """Cells that give its false alarms, by channel: those of more, if it is degraded so."""
        return tuple(cells * self.false_alarm_factor for cells in self.resolution_cells)

    @cached_property
    def placed_shares(self) -> Floats:
        """The share of false alarms whose solution lies within range, by channel; (channels,).

        At each azimuth those up to the bistatic range of a point at the end of the range.
        """
        share = (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS
        azimuth_deg = self.azimuth_cover.min_deg + share * self.azimuth_cover.span_deg
        ends_m = np.array([self.range_min_m, self.range_max_m])
        points_enu_m = aer_to_enu(azimuth_deg[:, None, None], 0.0, ends_m)
        excess_m = propagation.bistatic_range(points_enu_m, self.positions_enu_m[:, None])
        low_m, high_m = np.minimum(excess_m, self.range_max_m).mean(axis=0).T
        return np.asarray((high_m - low_m) / self.range_max_m)

    @sensor_property
    def disturbance_w(self) -> Floats:
        """What is left of the broadcasts, and radio noise (eqs 28 to 31); (channels,)."""
        direct_w = propagation.direct_signal_power_w(
            erp_w=self._each("erp_w"),
            gain_rx_dbi=self.gain_rx_dbi,
            sidelobe_db=self.sidelobe_db,
            cancellation_db=self.cancellation_db,
            wavelength_m=self.wavelengths_m,
            baseline_m=np.linalg.norm(self.positions_enu_m, axis=-1),
        )
        if not self.is_in_free_space:
            direct_w *= self.way_factor(self.positions_enu_m, self.wavelengths_m)
        noise_w = propagation.passive_noise_power_w(
            self._each("bandwidth_hz"),
            self._each("external_noise_db"),
            self.line_loss_db,
            self.antenna_loss_db,
            self.receiver_noise_figure_db,
        )
        return direct_w + noise_w

    @property
    def receiver_noise_w_hz(self) -> Floats:
        """Density of all that disturbs a channel, watts in a hertz; (channels,)."""
        return np.asarray(self.disturbance_w / self._each("bandwidth_hz"))

    def target_power_w(self, position_enu_m: Floats, rcs_m2: Floats) -> Floats:
        """Mean echo of each target by each channel (eq 24); (n, 3), (n,) in, (n, channels) out."""
        range_rx_m = np.maximum(distance_m(position_enu_m), NEAREST_M)
        powers_w = np.empty((len(position_enu_m), self.n_channels))
        for k in range(self.n_channels):
            place_enu_m, wavelength_m = self.positions_enu_m[k].T, self.wavelengths_m[k]
            range_tx_m = np.maximum(distance_m(position_enu_m - place_enu_m), NEAREST_M)
            way_m2 = range_tx_m * range_rx_m
            aperture_m4 = wavelength_m * wavelength_m * rcs_m2
            power_w = self._radiated_w[k] * aperture_m4 / (SPREAD * (way_m2 * way_m2))
            if not self.is_in_free_space:
                power_w *= self.way_factor(position_enu_m, wavelength_m)
                power_w *= self.way_factor(position_enu_m, wavelength_m, place_enu_m)
            powers_w[:, k] = power_w
        return powers_w

    @sensor_property
    def _radiated_w(self) -> Floats:
        """ERP over isotropic, with the receiver's gain, less the loss (eqs 24, 26); (channels,)."""
        gains_db = propagation.DIPOLE_GAIN_DBI + as_floats(self.gain_rx_dbi) - self.loss_db
        return propagation.radiated_w(self._each("erp_w"), gains_db)

    @property
    def cfar(self) -> FluctuatingCfar:
        """The detector of each channel."""
        return FluctuatingCfar(self.pfa, 1, self.n_reference)

    def mean_snr(self, target_w: Floats) -> Floats:
        """Signal-to-noise ratio before fluctuation, linear (eq 25); (n, channels) in and out."""
        return propagation.correlated_snr(target_w, self.disturbance_w.T, self.time_bandwidth.T)

    def pd(self, snr: Floats, order: Floats | None = None) -> Floats:
        """Probability of detection (eqs 6, 7), by how targets fluctuate where they state it."""
        return self.cfar.pd(snr, order)

    def inverse_detected(self, snr: Floats, order: Floats | None = None) -> Floats:
        """Mean of 1/x over detections of power x; (...)."""
        return self.cfar.inverse_detected(snr, order)

    def sigmas(
        self, snr: Floats, range_resolution_m: Floats, range_floor_m: Floats
    ) -> tuple[Floats, Floats]:
        """Standard deviations of bistatic range and azimuth at a detection's own SNR."""
        return (
            accuracy.sigma_range_m(snr, range_resolution_m, range_floor_m),
            accuracy.sigma_angle_deg(snr, self.azimuth_beamwidth_deg, self.azimuth_floor_deg),
        )

    @sensor_property
    def wavelengths_m(self) -> Floats:
        """Wavelengths by channel."""
        return C_M_S / self._each("frequency_hz")

    @sensor_property
    def time_bandwidth(self) -> Floats:
        """Products of integration time and bandwidth, by channel."""
        return self.integration_s * self._each("bandwidth_hz")

    def _each(self, name: str) -> Floats:
        """A property of the transmitters; (channels,)."""
        return np.array([getattr(t, name) for t in self.transmitters], dtype=np.float64)

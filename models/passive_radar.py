"""The passive radar: section 3.2 of the paper, equations 24 to 36 in right form.

It lives on broadcasts. Each transmitter gives a channel of its own: a look, a detection, a plot.
Measured are the bistatic range, transmitter-target-receiver less the baseline, and the azimuth;
the elevation is not, so the sensor places its plots in its own horizontal plane, and errs by that.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.models import accuracy, detection, false_alarms, propagation
from plotfeed.models.constants import C_M_S
from plotfeed.models.cover import Volume
from plotfeed.models.flat_solution import flat_solution
from plotfeed.models.frames import aer_to_enu, enu_to_aer, wrap_360
from plotfeed.models.scan import Sector, beam_times_ns
from plotfeed.models.sensor import NO_PLOTS, Prediction
from plotfeed.models.state import Floats, Ints, Looks, Plots, Targets

_AZIMUTHS = 3600
"""Over which the share of false alarms that have a place is averaged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Transmitter:
    """A transmitter of opportunity, east, north and up of the receiver.

    `external_noise_db` is what the receiver's antenna collects at its frequency, over k T0 B.
    """

    erp_w: float
    frequency_hz: float
    bandwidth_hz: float
    position_enu_m: tuple[float, float, float]
    external_noise_db: float


@dataclass(frozen=True, kw_only=True)
class PassiveRadar(Volume):
    """What the equations need. Side-lobe and cancellation levels are negative, losses positive."""

    transmitters: tuple[Transmitter, ...]
    gain_rx_dbi: float
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
    bistatic_range_floor_m: float
    azimuth_floor_deg: float

    @cached_property
    def positions_enu_m(self) -> Floats:
        """Of the transmitters; (channels, 3)."""
        return np.array([t.position_enu_m for t in self.transmitters], dtype=np.float64)

    @cached_property
    def range_resolution_m(self) -> Floats:
        """Of the bistatic range: c/B, not c/2B, for it is a sum of two ways; (channels,)."""
        return C_M_S / self._each("bandwidth_hz")

    @cached_property
    def resolution_cells(self) -> tuple[int, ...]:
        """Bistatic range cells x azimuth beams x Doppler cells, by channel (eq 9, right form)."""
        beams = max(round(self.azimuth_cover.span_deg / self.azimuth_beamwidth_deg), 1)
        range_cells = [max(round(self.range_max_m / m), 1) for m in self.range_resolution_m]
        return tuple(n * beams * self.doppler_cells for n in range_cells)

    @property
    def signal_speed_m_s(self) -> None:
        """Light takes no time worth modelling."""
        return

    @property
    def false_alarms_per_scan(self) -> float:
        """Mean number of false plots: what the detectors let through (eq 9) and has a place."""
        return float(self.pfa * np.array(self.resolution_cells) @ self.placed_shares)

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

    @cached_property
    def disturbance_w(self) -> Floats:
        """What is left of the broadcasts, and radio noise (eqs 28 to 31); (channels,)."""
        direct_w = propagation.direct_signal_power_w(
            erp_w=self._each("erp_w"),
            gain_rx_dbi=self.gain_rx_dbi,
            sidelobe_db=self.sidelobe_db,
            cancellation_db=self.cancellation_db,
            wavelength_m=C_M_S / self._each("frequency_hz"),
            baseline_m=np.linalg.norm(self.positions_enu_m, axis=-1),
        )
        noise_w = propagation.passive_noise_power_w(
            self._each("bandwidth_hz"),
            self._each("external_noise_db"),
            self.line_loss_db,
            self.antenna_loss_db,
            self.receiver_noise_figure_db,
        )
        return direct_w + noise_w

    def target_power_w(self, position_enu_m: Floats, rcs_m2: Floats) -> Floats:
        """Mean echo of each target by each channel (eq 24); (n, 3), (n,) in, (n, channels) out."""
        offset_m = position_enu_m[:, None] - self.positions_enu_m
        return propagation.passive_target_power_w(
            erp_w=self._each("erp_w"),
            gain_rx_dbi=self.gain_rx_dbi,
            wavelength_m=C_M_S / self._each("frequency_hz"),
            rcs_m2=rcs_m2[:, None],
            range_tx_m=np.maximum(np.linalg.norm(offset_m, axis=-1), propagation.NEAREST_M),
            range_rx_m=np.maximum(np.linalg.norm(position_enu_m, axis=-1), propagation.NEAREST_M)[
                :, None
            ],
            loss_db=self.loss_db,
        )

    def mean_snr(self, target_w: Floats) -> Floats:
        """Signal-to-noise ratio before fluctuation, linear (eq 25); (n, channels) in and out."""
        return propagation.correlated_snr(target_w, self.disturbance_w, self._time_bandwidth)

    def pd(self, snr: Floats) -> Floats:
        """Probability of detection (eqs 6, 7)."""
        return detection.pd_cfar_swerling1(snr, self.pfa, self.n_reference)

    def sigmas(self, snr: Floats, range_resolution_m: Floats) -> tuple[Floats, Floats]:
        """Standard deviations of bistatic range and azimuth at a detection's own SNR."""
        return (
            accuracy.with_floor(
                accuracy.sigma_range_m(snr, range_resolution_m), self.bistatic_range_floor_m
            ),
            accuracy.with_floor(
                accuracy.sigma_angle_deg(snr, self.azimuth_beamwidth_deg), self.azimuth_floor_deg
            ),
        )

    def observe(self, targets: Targets, rng: np.random.Generator) -> tuple[Looks, Plots]:
        """One look by each channel at each target within cover, and the plots of those detected.

        A detection without a solution within range, near the baseline above all, is no plot.
        """
        azimuth_deg, elevation_deg, range_m = enu_to_aer(targets.position_enu_m)
        covered = np.flatnonzero(self.in_cover(range_m, azimuth_deg, elevation_deg))
        target_w = self.target_power_w(targets.position_enu_m[covered], targets.rcs_m2(covered))
        snr = self.mean_snr(target_w).ravel()
        pd = self.pd(snr)
        row = np.repeat(covered, len(self.transmitters))
        looks = Looks(
            drone=targets.drone[row],
            channel=np.tile(np.arange(len(self.transmitters)), len(covered)),
            t_utc_ns=targets.t_utc_ns[row],
            range_m=range_m[row],
            azimuth_deg=azimuth_deg[row],
            elevation_deg=elevation_deg[row],
            snr=snr,
            pd=pd,
            detected=detection.draw_hits(pd, rng),  # eq 8
        )
        if not looks.detected.any():
            return looks, NO_PLOTS
        hit = looks.detected
        return looks, self._measure(looks.rows(hit), targets, row[hit], target_w.ravel()[hit], rng)

    def _measure(
        self,
        hits: Looks,
        targets: Targets,
        row: Ints,
        target_w: Floats,
        rng: np.random.Generator,
    ) -> Plots:
        """Noise on the measured pair by the SNR of each very detection, then the inversion."""
        snr, _ = detection.draw_detected_snr_swerling1(hits.snr, self.pfa, self.n_reference, rng)
        sigmas = self.sigmas(snr, self.range_resolution_m[hits.channel])
        true = enu_to_aer(targets.true_position_enu_m[row])
        excess_m = propagation.bistatic_range(
            targets.position_enu_m[row], self.positions_enu_m[hits.channel]
        )
        return self._plots(
            snr,
            target_w,
            t_utc_ns=hits.t_utc_ns,
            channel=hits.channel,
            bistatic_range_m=excess_m + accuracy.gaussian(sigmas[0], rng),
            azimuth_deg=wrap_360(hits.azimuth_deg + accuracy.gaussian(sigmas[1], rng)),
            drone=hits.drone,
            true_azimuth_deg=true[0],
            true_elevation_deg=true[1],
            true_range_m=true[2],
        )

    def predict(self, targets: Targets) -> Prediction:
        """Pd of a plot by any of the channels; the rest for the channel with the highest.

        A detection becomes a plot if noise leaves it a solution within range, which to first order
        is Gaussian. The errors are about the mean of the flat solution, which is biased.
        """
        position_enu_m = targets.position_enu_m
        target_w = self.target_power_w(position_enu_m, targets.rcs_m2(np.arange(len(targets))))
        snr = self.mean_snr(target_w)
        # Error variances go as one over the detection's own power.
        effective_snr = 1.0 / detection.inverse_detected_snr(snr, self.pfa, self.n_reference)
        sigma_excess_m, sigma_azimuth_deg = self.sigmas(effective_snr, self.range_resolution_m)
        excess_m = propagation.bistatic_range(position_enu_m[:, None], self.positions_enu_m)
        azimuth_deg = enu_to_aer(position_enu_m)[0][:, None]
        flat = flat_solution(excess_m, azimuth_deg, self.positions_enu_m)
        sigma_range_m = flat.sigma_m(sigma_excess_m, sigma_azimuth_deg)
        placed = flat.chance_between(
            self.range_min_m, self.range_max_m, sigma_range_m, excess_m / sigma_excess_m
        )
        pd = self.pd(snr) * placed
        best = np.argmax(np.nan_to_num(pd), axis=1)[:, None]

        def of_best(column: Floats) -> Floats:
            return np.take_along_axis(column, best, axis=1)[:, 0]

        return Prediction(
            snr=of_best(snr),
            pd=1.0 - np.prod(1.0 - pd, axis=1),
            sigma_range_m=of_best(np.where(placed > 0, sigma_range_m, np.nan)),
            sigma_azimuth_deg=of_best(sigma_azimuth_deg),
            sigma_elevation_deg=np.full(len(targets), np.nan),
        )

    def draw_false_alarms(self, sector: Sector, rng: np.random.Generator) -> Plots:
        """The false alarms of one sector: binomial over each channel's cells, uniform in them.

        Uniform in bistatic range, up to the instrumented range, and in azimuth (eq 10, right
        form). `placed_shares` of them have a solution within range; the others are no plots.
        """
        found = [
            false_alarms.draw_azimuths(cells, self.pfa, self.azimuth_cover, sector, rng)
            for cells in self.resolution_cells
        ]
        azimuth_deg = np.concatenate(found)
        n = len(azimuth_deg)
        if not n:
            return NO_PLOTS
        snr, _ = detection.draw_detected_snr_swerling1(np.zeros(n), self.pfa, self.n_reference, rng)
        return self._plots(
            snr,
            np.zeros(n),
            t_utc_ns=beam_times_ns(sector, azimuth_deg),
            channel=np.repeat(np.arange(len(found)), [len(a) for a in found]),
            bistatic_range_m=false_alarms.draw_uniform(0.0, self.range_max_m, n, rng),
            azimuth_deg=azimuth_deg,
        )

    def _plots(self, snr: Floats, target_w: Floats, **columns: NDArray[Any]) -> Plots:
        """What the sensor makes of its measurements: places, stated errors, amplitudes.

        A place is stated where it is within range and its error is not beyond all range, which is
        what becomes of it near the baseline. `snr` is over the channel's noise, in which the mean
        echo has its own part (eq 25).
        """
        channel = columns["channel"]
        sigmas = self.sigmas(snr, self.range_resolution_m[channel])
        flat = flat_solution(
            columns["bistatic_range_m"], columns["azimuth_deg"], self.positions_enu_m[channel]
        )
        east_m2, north_m2, east_north_m2 = flat.covariance_m2(*sigmas)
        noise_w = (self.disturbance_w[channel] + target_w) / self._time_bandwidth[channel]
        plots = Plots.of(
            snr=snr,
            amplitude_dbm=10 * np.log10(snr * noise_w) + 30,
            range_m=flat.range_m,
            sigma_range_m=flat.sigma_m(*sigmas),
            sigma_bistatic_range_m=sigmas[0],
            sigma_azimuth_deg=sigmas[1],
            covariance_east_m2=east_m2,
            covariance_north_m2=north_m2,
            covariance_east_north_m2=east_north_m2,
            **columns,
        )
        within = (plots.range_m >= self.range_min_m) & (plots.range_m <= self.range_max_m)
        return plots.rows(within & (plots.range_m > 0) & (plots.sigma_range_m <= self.range_max_m))

    @cached_property
    def _time_bandwidth(self) -> Floats:
        """By channel."""
        return self.integration_s * self._each("bandwidth_hz")

    def _each(self, name: str) -> Floats:
        """A property of the transmitters; (channels,)."""
        return np.array([getattr(t, name) for t in self.transmitters], dtype=np.float64)

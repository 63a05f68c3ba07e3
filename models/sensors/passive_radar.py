"""The passive radar: section 3.2 of the paper, equations 24 to 36 in right form.

It lives on broadcasts. Each transmitter gives a channel of its own: a look, a detection, a plot.
Measured are the bistatic range, transmitter-target-receiver less the baseline, and the azimuth;
the elevation is not. So the sensor places its plots by what heights it expects (`HeightPrior`), or
without that in its own horizontal plane, and then errs by more than it states.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.models import accuracy, propagation
from plotfeed.models.beam import Sector, Volume, beam_times_ns, draw_azimuths
from plotfeed.models.chance import of_rows
from plotfeed.models.detection import cells_across
from plotfeed.models.effects.doppler import range_rate_m_s
from plotfeed.models.effects.echo_effects import EchoPaths
from plotfeed.models.fluctuation import FluctuatingCfar
from plotfeed.models.frames import aer_to_enu, enu_to_aer, wrap_360
from plotfeed.models.numerics import as_floats
from plotfeed.models.propagation import C_M_S
from plotfeed.models.sensors.bistatic_places import FlatSolution, HeightPrior, flat_solution
from plotfeed.models.sensors.polar_radar import FarTransmitters, Hits
from plotfeed.models.sensors.sensor_model import (
    EVERY_ROW,
    NO_PLOTS,
    Prediction,
    Targets,
    sensor_property,
)
from plotfeed.models.state import Floats, Ints, Looks, Plots

_AZIMUTHS = 3600  # How many the share of false alarms that have a place is averaged over


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
class PassiveRadar(Volume, FarTransmitters):
    """What the equations need. Side-lobe and cancellation levels are negative, losses positive.

    Without heights, targets are taken to be level.
    """

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
    expected_height_m: float = 0.0
    sigma_height_m: float = 0.0

    @sensor_property
    def n_channels(self) -> int:
        """A channel a transmitter."""
        return len(self.transmitters)

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
        signals = self._radiated_w, self.wavelengths_m, self.positions_enu_m
        return self._echoes(position_enu_m, rcs_m2, *signals)

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
        return self.cfar.pd(snr[..., None], order)

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

    def _odds(self, powers: Floats, channel: Ints, order: Floats | None) -> tuple[Floats, Floats]:
        disturbance_w, time_bandwidth = (
            self.of_channel(name, channel) for name in ("disturbance_w", "time_bandwidth")
        )
        snr = propagation.correlated_snr(powers, disturbance_w, time_bandwidth)
        return snr, self.pd(snr, order)

    def look_powers_w(self, targets: Targets, rows: Ints | slice = EVERY_ROW) -> Floats:
        """Mean echoes of those rows of targets, the model's own, by each channel."""
        place_enu_m = targets.true_position_enu_m[rows]
        target_w = self.target_power_w(place_enu_m, targets.rcs_m2(rows))
        return self._with_effects(target_w, targets, rows)

    def _echo_paths(self, targets: Targets, rows: Ints | slice) -> EchoPaths:
        azimuth_deg, elevation_deg, _ = enu_to_aer(targets.position_enu_m[rows])
        place_enu_m = targets.true_position_enu_m[rows]
        from_enu_m = self.transmitters_enu_m
        excess_m = [propagation.bistatic_range(place_enu_m, each_m) for each_m in from_enu_m]
        rates_m_s = None
        if self.doppler is not None and targets.velocity_enu_m_s is not None:
            velocity = targets.velocity_enu_m_s[rows]
            own_m_s = range_rate_m_s(place_enu_m, velocity)
            rates = [own_m_s + range_rate_m_s(place_enu_m, velocity, m) for m in from_enu_m]
            rates_m_s = np.stack(rates, axis=-1)
        return EchoPaths(
            azimuth_deg=azimuth_deg,
            elevation_deg=elevation_deg,
            place_enu_m=place_enu_m,
            transmitters_enu_m=from_enu_m,
            measured_m=np.stack(excess_m, axis=-1),
            rates_m_s=rates_m_s,
        )

    def observe(self, targets: Targets, rng: np.random.Generator) -> tuple[Looks, Plots]:
        """Look by each channel at each target within cover, and plot those detected.

        A detection without a solution within range, near the baseline above all, is no plot.
        """
        geometry = azimuth_deg, elevation_deg, range_m = enu_to_aer(targets.position_enu_m)
        covered = np.flatnonzero(self.in_cover(range_m, azimuth_deg, elevation_deg))
        target_w = self.rows(covered).look_powers_w(targets, covered)
        rows = np.repeat(covered, self.n_channels)
        return self.rows(rows)._looks_and_plots(
            targets,
            rows,
            geometry,
            of_rows(rng, rows),
            target_w.ravel(),
            np.tile(np.arange(self.n_channels), len(covered)),
            self.orders(targets, rows),
        )

    def _with_range(self, looks: Looks, targets: Targets, *rows: Ints | slice) -> Looks:
        """Looks with bistatic ranges by their channels."""
        place_enu_m = targets.true_places_enu_m(*rows)
        transmitter_enu_m = self.of_channel("positions_enu_m", looks.channel)
        return looks.but(range_m=propagation.bistatic_range(place_enu_m, transmitter_enu_m))

    def _range_rates(self, targets: Targets, rows: Ints | slice, channel: Ints) -> Floats | None:
        """How fast bistatic ranges grow, if Doppler is modelled and velocities are known; (n,)."""
        if self.doppler is None or targets.velocity_enu_m_s is None:
            return None
        place, velocity = targets.true_position_enu_m[rows], targets.velocity_enu_m_s[rows]
        transmitter_enu_m = self.of_channel("positions_enu_m", channel)
        from_transmitter = range_rate_m_s(place, velocity, transmitter_enu_m)
        return range_rate_m_s(place, velocity) + from_transmitter

    def measured(self, hits: Hits, targets: Targets) -> Plots:
        """Noise on the measured pair by the SNR of each very detection, then the inversion."""
        echoes, columns, rng = hits.echoes, hits.columns, hits.rng
        snr, _ = self.cfar.draw_detected(echoes.snr[:, None], hits.order, rng)
        sigmas = self.sigmas(
            snr,
            self.of_channel("range_resolution_m", echoes.channel),
            self.of_channel("range_floors_m", echoes.channel),
        )
        excess_m = targets.read_range_m(echoes.range_m, echoes.t_utc_ns)
        azimuth_deg = targets.read_azimuth_deg(echoes.azimuth_deg, echoes.t_utc_ns)
        errors = [s * rng.standard_normal(s.shape) * self.error_factor for s in sigmas]
        columns["bistatic_range_m"] = excess_m + errors[0]
        columns["azimuth_deg"] = wrap_360(azimuth_deg + errors[1])
        if self.doppler is not None and "range_rate_m_s" in columns:
            columns |= self.doppler.measured(
                columns["range_rate_m_s"], snr, echoes.channel, rng, self.error_factor
            )
        return self._plots(
            snr,
            sigmas,
            hits.powers,
            t_utc_ns=echoes.t_utc_ns,
            channel=echoes.channel,
            **echoes.whose(),
            **columns,
        )

    def sigmas_at(self, snr: Floats, channel: Ints) -> Mapping[str, Floats]:
        """Standard deviations that follow from detections' own ratios, linear, by the columns."""
        sigmas = self.sigmas(snr, self.range_resolution_m[channel], self.range_floors_m[channel])
        found = {"sigma_bistatic_range_m": sigmas[0], "sigma_azimuth_deg": sigmas[1]}
        if self.doppler is not None:
            found["sigma_range_rate_m_s"] = self.doppler.sigma_m_s(snr, channel)
        return found

    def predict(self, targets: Targets) -> Prediction:
        """Pd of a plot by any of the channels; the rest for the channel with the highest.

        A detection becomes a plot if noise leaves it a solution within range, which to first order
        is Gaussian. The errors are about the mean of the flat solution, which is biased.
        """
        position_enu_m = targets.true_position_enu_m
        target_w = self.look_powers_w(targets)
        snr = self.mean_snr(target_w)
        order = self.orders(targets)
        order = None if order is None else np.repeat(order, snr.shape[1]).reshape(snr.shape)
        # Error variances go as one over the detection's own power.
        effective_snr = 1.0 / self.cfar.inverse_detected(snr[..., None], order)
        sigma_excess_m, sigma_azimuth_deg = (
            sigma * self.error_factor
            for sigma in self.sigmas(effective_snr, self.range_resolution_m, self.range_floors_m)
        )
        excess_m = propagation.bistatic_range(position_enu_m[:, None], self.positions_enu_m)
        azimuth_deg = enu_to_aer(targets.position_enu_m)[0][:, None]
        flat = flat_solution(excess_m, azimuth_deg, self.positions_enu_m)
        sigma_range_m = flat.sigma_m(sigma_excess_m, sigma_azimuth_deg)
        placed = flat.chance_between(
            self.range_min_m, self.range_max_m, sigma_range_m, excess_m / sigma_excess_m
        )
        pd, sigma_rate_m_s = self.pd(snr, order) * placed * self.pd_factor, None
        if self.doppler is not None:
            channel = np.broadcast_to(np.arange(snr.shape[1]), snr.shape)
            sigma_rate_m_s = self.doppler.sigma_m_s(effective_snr, channel) * self.error_factor
            pd = pd * self._share_passed(targets)
        best = np.argmax(np.nan_to_num(pd), axis=1)[:, None]

        def of_best(column: Floats) -> Floats:
            return np.take_along_axis(column, best, axis=1)[:, 0]

        return Prediction(
            snr=of_best(snr),
            pd=1.0 - np.prod(1.0 - pd, axis=1),
            sigma_range_m=of_best(np.where(placed > 0, sigma_range_m, np.nan)),
            sigma_azimuth_deg=of_best(sigma_azimuth_deg),
            sigma_elevation_deg=np.full(len(targets), np.nan),
            sigma_range_rate_m_s=None if sigma_rate_m_s is None else of_best(sigma_rate_m_s),
        )

    def _share_passed(self, targets: Targets) -> Floats:
        """Share of each channel's Pd, by range rates where velocities are known; (n, channels)."""
        channels = len(self.transmitters)
        row, channel = np.divmod(np.arange(len(targets) * channels), channels)
        rate_m_s = self._range_rates(targets, row, channel)
        if self.doppler is None or rate_m_s is None:
            return np.ones((len(targets), channels))
        return self.doppler.share_passed(rate_m_s, channel).reshape(-1, channels)

    def draw_false_snr(self, n: int, rng: np.random.Generator) -> Floats:
        """Ratios of cells of noise that were detected; (n,)."""
        return self.cfar.draw_detected(np.zeros((n, 1)), None, rng)[0]

    def draw_false_alarms(self, sector: Sector, rng: np.random.Generator) -> Plots:
        """The false alarms of one sector: binomial over each channel's cells, uniform in them.

        Uniform in bistatic range, up to the instrumented range, and in azimuth (eq 10, right
        form). `placed_shares` of them have a solution within range; the others are no plots.
        """
        found = [
            draw_azimuths(cells, self.pfa, self.azimuth_cover, sector, rng)
            for cells in self.alarm_cells
        ]
        azimuth_deg = np.concatenate(found)
        n = len(azimuth_deg)
        if not n:
            return NO_PLOTS
        snr = self.draw_false_snr(n, rng)
        channel = np.repeat(np.arange(len(found)), [len(a) for a in found])
        columns = {}
        if self.doppler is not None:
            columns = self.doppler.of_false_alarms(snr, channel, rng)
        return self._plots(
            snr,
            self.sigmas(snr, self.range_resolution_m[channel], self.range_floors_m[channel]),
            np.zeros(n),
            t_utc_ns=beam_times_ns(sector, azimuth_deg),
            channel=channel,
            bistatic_range_m=rng.uniform(0.0, self.range_max_m, n),
            azimuth_deg=azimuth_deg,
            **columns,
        )

    def _plots(
        self, snr: Floats, sigmas: tuple[Floats, Floats], target_w: Floats, **columns: NDArray[Any]
    ) -> Plots:
        """What the sensor makes of its measurements: places, stated errors, amplitudes.

        A place is stated where the level solution is within range and its error by noise is not
        beyond all range, which is what becomes of it near the baseline. `snr` is over the channel's
        noise, in which the mean echo has its own part (eq 25).
        """
        channel = columns["channel"]
        disturbance_w, time_bandwidth, transmitter_enu_m = (
            self.of_channel(name, channel)
            for name in ("disturbance_w", "time_bandwidth", "positions_enu_m")
        )
        flat = flat_solution(columns["bistatic_range_m"], columns["azimuth_deg"], transmitter_enu_m)
        east_m2, north_m2, east_north_m2 = flat.covariance_m2(*sigmas)
        noise_w = (disturbance_w + target_w) / time_bandwidth
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
        within &= (plots.range_m > 0) & (plots.sigma_range_m <= self.range_max_m)
        if np.any(self.expected_height_m) or np.any(self.sigma_height_m):
            plots = self._at_expected_heights(plots, flat, transmitter_enu_m)
        return plots.rows(within)

    def _at_expected_heights(
        self, plots: Plots, flat: FlatSolution, transmitter_enu_m: Floats
    ) -> Plots:
        """Plots over the ground at the mean of what their heights make of it, which may vary.

        One that is nearer than any height expected stays in the plane, give or take its range.
        """
        prior = HeightPrior(self.expected_height_m, self.sigma_height_m)
        range_m, variance_m2 = prior.ground_range_m(
            plots.bistatic_range_m, plots.azimuth_deg, transmitter_enu_m
        )
        nowhere = np.isnan(range_m)
        range_m = np.where(nowhere, plots.range_m, range_m)
        variance_m2 = np.where(nowhere, plots.range_m * plots.range_m, variance_m2)
        east, north = flat.outwards[..., 0], flat.outwards[..., 1]
        return plots.but(
            range_m=range_m,
            sigma_range_m=np.sqrt(plots.sigma_range_m * plots.sigma_range_m + variance_m2),
            covariance_east_m2=plots.covariance_east_m2 + variance_m2 * east * east,
            covariance_north_m2=plots.covariance_north_m2 + variance_m2 * north * north,
            covariance_east_north_m2=plots.covariance_east_north_m2 + variance_m2 * east * north,
        )

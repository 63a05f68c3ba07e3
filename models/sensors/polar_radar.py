"""What radars that measure range, azimuth and elevation share, whatever makes their echoes.

Thermal noise alone, a CFAR detector, and measurement errors that follow the signal-to-noise ratio
of the very detection: section 3.1.1 of the paper, equations 4, 5 and 9 to 15 in right form.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from plotfeed.models import accuracy, detection, propagation
from plotfeed.models.beam import Volume
from plotfeed.models.chance import of_rows
from plotfeed.models.detection import cells_across
from plotfeed.models.fluctuation import FluctuatingCfar, mean_over_signals
from plotfeed.models.frames import distance_m, enu_to_aer
from plotfeed.models.propagation import C_M_S, NEAREST_M, SPREAD
from plotfeed.models.sensors.sensor_model import (
    EVERY_ROW,
    NO_PLOTS,
    CellSensor,
    Prediction,
    RadioSensor,
    Targets,
    mean_prediction,
    sensor_property,
)
from plotfeed.models.state import UNDECIDED, Floats, Ints, Looks, Plots, rows_where

if TYPE_CHECKING:
    from plotfeed.models.effects.classification import Confusion
    from plotfeed.models.effects.doppler import Doppler
    from plotfeed.models.effects.echo_effects import EchoEffects, EchoPaths
    from plotfeed.models.effects.merging import Merging
    from plotfeed.models.effects.pulse_intervals import PulseIntervals
    from plotfeed.models.effects.surroundings import OnTheWay


# What radars share, whatever they measure of echoes: the way from looks to plots.
# Columns of looks from which plots are made.
MEASURED_OF = (
    *("drone", "channel", "t_utc_ns", "range_m", "azimuth_deg", "elevation_deg", "snr"),
    "sensor",
)


@dataclass(frozen=True, slots=True)
class Hits:
    """Echoes that were detected: of each a look's columns, its powers, and columns of its plot.

    `order` is that by which each target fluctuates, if any states it.
    """

    echoes: Looks
    powers: Floats
    columns: dict[str, NDArray[Any]]
    rng: np.random.Generator
    order: Floats | None = None


@dataclass(frozen=True, kw_only=True)
class EchoRadar(RadioSensor, ABC):
    """A radar, of which what is None is not modelled. The powers of its looks are (n, ...)."""

    gain_rx_dbi: float
    doppler: Doppler | None = None
    merging: Merging | None = None
    echo_effects: EchoEffects | None = None

    alike: ClassVar[frozenset[str]] = frozenset(
        {"pfa", "surroundings", "multipath", "doppler", "merging", "echo_effects"}
    )

    @property
    def measures_range_rate(self) -> bool:
        """Whether its Doppler cells are modelled."""
        return self.doppler is not None

    def with_jammers_behind(self, way: OnTheWay) -> Self:
        """The radar with what an obstruction leaves of its jammers."""
        if self.echo_effects is None:
            return self
        from plotfeed.models.effects.jamming import Jamming, behind

        met = tuple(
            replace(effect, jammers=behind(effect.jammers, way))
            if isinstance(effect, Jamming)
            else effect
            for effect in self.echo_effects.in_the_world
        )
        return replace(self, echo_effects=replace(self.echo_effects, in_the_world=met))

    @property
    def usual_order(self) -> float:
        """Order by which a target fluctuates that states nothing: by one look, Swerling 1."""
        return 1.0

    @property
    def n_looks(self) -> int:
        """Looks whose powers are summed, a signal each."""
        return 1

    def orders(self, targets: Targets, rows: Ints | slice = EVERY_ROW) -> Floats | None:
        """Orders by which those rows of targets fluctuate, (n,); None if none states anything."""
        echoes = targets.signatures.echoes
        if echoes is None:
            return None
        found: Floats = echoes.orders(targets.drone[rows], self.usual_order, self.n_looks)
        return found

    def _with_effects(self, powers: Floats, targets: Targets, rows: Ints | slice) -> Floats:
        """Mean powers of echoes, or their ratios, (n, K), as the effects leave them."""
        echoes = targets.signatures.echoes
        if self.echo_effects is None and echoes is None:
            return powers
        paths = self._echo_paths(targets, rows)
        if self.echo_effects is not None:
            powers = powers * self.echo_effects.power_factor(paths)
        if echoes is not None and echoes.has_aspects and targets.velocity_enu_m_s is not None:
            powers = powers * echoes.rcs_factor(
                targets.drone[rows],
                paths.place_enu_m,
                targets.velocity_enu_m_s[rows],
                paths.transmitters_enu_m,
            )
        return powers

    @property
    def transmitters_enu_m(self) -> Sequence[Floats] | None:
        """Places of the transmitters of its signals, each (3,) or (n, 3); None for its own."""
        return None

    def _echo_paths(self, targets: Targets, rows: Ints | slice) -> EchoPaths:
        """How echoes of those rows of targets, the model's own, come to it."""
        azimuth_deg, elevation_deg, range_m = enu_to_aer(targets.position_enu_m[rows])
        rate_m_s = self._range_rates(targets, rows, np.zeros(len(range_m), np.int64))
        from plotfeed.models.effects.echo_effects import EchoPaths

        return EchoPaths(
            azimuth_deg=azimuth_deg,
            elevation_deg=elevation_deg,
            place_enu_m=targets.true_position_enu_m[rows],
            transmitters_enu_m=self.transmitters_enu_m,
            measured_m=range_m[:, None],
            rates_m_s=None if rate_m_s is None else rate_m_s[:, None],
        )

    def _range_rates(self, targets: Targets, rows: Ints | slice, _channel: Ints) -> Floats | None:
        """How fast what it measures of ranges grows, if that is modelled and known; (n,)."""
        if self.doppler is None or targets.velocity_enu_m_s is None:
            return None
        from plotfeed.models.effects.doppler import range_rate_m_s

        return range_rate_m_s(targets.true_position_enu_m[rows], targets.velocity_enu_m_s[rows])

    def _with_range(self, looks: Looks, _targets: Targets, *_rows: Ints | slice) -> Looks:
        """Looks with the ranges that it measures; of these rows of targets, of them these."""
        return looks

    @abstractmethod
    def pd(self, snrs: Floats, order: Floats | None = None) -> Floats:
        """Probability of detection of looks of those ratios, by how their targets fluctuate."""

    def _odds(self, powers: Floats, _channel: Ints, order: Floats | None) -> tuple[Floats, Floats]:
        """Mean signal-to-noise ratio and Pd of echoes; (n, ...) and (n,) in, each (n,) out."""
        return mean_over_signals(powers), self.pd(powers, order)

    @abstractmethod
    def measured(self, hits: Hits, targets: Targets) -> Plots:
        """The plots of echoes, at least one, of which ranges are what it measures."""

    def _looks_and_plots(  # noqa: PLR0917
        self,
        targets: Targets,
        rows: Ints | slice,
        geometry: tuple[Floats, Floats, Floats],
        rng: np.random.Generator,
        powers: Floats,
        channel: Ints,
        order: Floats | None,
    ) -> tuple[Looks, Plots]:
        """Looks at those rows of targets, the model's own, and the plots of those detected.

        Looks whose echoes merge share odds and outcome.
        """
        snr, pd = self._odds(powers, channel, order)
        undecided = UNDECIDED[: len(pd)]
        looks = targets.looks(rows, geometry, snr=snr, pd=pd, detected=undecided, channel=channel)
        rate_m_s = self._range_rates(targets, rows, channel)
        model, groups = self, None
        of_looks: Ints | slice = EVERY_ROW
        if self.merging is not None:
            echoes, seen_m_s = self._with_range(looks, targets, rows), rate_m_s
            if self.doppler is not None and rate_m_s is not None:
                seen_m_s = self.doppler.folded(rate_m_s, channel)
            groups = self.merging.merged_groups(echoes, rng.random((len(looks),)), seen_m_s)
        if groups is not None:
            columns = targets.true_geometry(looks, rows) | _of_rates(rate_m_s)
            echoes, columns = groups.echoes(echoes, columns)
            rate_m_s, channel = columns.get("range_rate_m_s"), echoes.channel
            of_looks, leader = groups.group, groups.leader
            model, rng, powers = self.rows(leader), of_rows(rng, leader), groups.total(powers)
            order = None if order is None else order[leader]
            snr, pd = model._odds(powers, channel, order)
            echoes = echoes.but(snr=snr)
        pd = pd * model.pd_factor
        if model.doppler is not None and rate_m_s is not None:
            pd = pd * model.doppler.share_passed(rate_m_s, channel)
        detected = detection.draw_hits(pd, rng)  # eq 8
        looks = looks.but(pd=pd[of_looks], detected=detected[of_looks])
        if not detected.any():
            return looks, NO_PLOTS
        which = rows_where(detected)
        of_hits = model.rows(which)
        if groups is not None:
            echoes = echoes.rows(detected)
            columns = {name: column[which] for name, column in columns.items()}
        else:
            echoes = looks.picked(which, MEASURED_OF)
            columns = targets.true_geometry(echoes, rows, which)
            columns |= _of_rates(None if rate_m_s is None else rate_m_s[which])
            echoes = of_hits._with_range(echoes, targets, rows, which)
        of_which = None if order is None else order[which]
        hits = Hits(echoes, powers[which], columns, of_rows(rng, which), of_which)
        return looks, of_hits.measured(hits, targets)


def _of_rates(rate_m_s: Floats | None) -> dict[str, NDArray[Any]]:
    """Columns of plots of echoes that recede so fast, if that is known."""
    if rate_m_s is None:
        return {}
    return {"range_rate_m_s": rate_m_s, "true_range_rate_m_s": rate_m_s}


@dataclass(frozen=True, kw_only=True)
class FarTransmitters(EchoRadar, ABC):
    """A radar whose transmitters, a signal each, stand elsewhere than its receiver."""

    transmitters: tuple[Any, ...]

    @sensor_property
    def positions_enu_m(self) -> Floats:
        """Places of the transmitters; (K, 3)."""
        return np.array([t.position_enu_m for t in self.transmitters], np.float64)

    @property
    def other_ends_enu_m(self) -> Floats:
        """Where its transmitters are; (K, 3)."""
        return self.positions_enu_m

    @property
    def transmitters_enu_m(self) -> list[Floats]:
        """Places of its transmitters, each (3,), or (n, 3) of several radars."""
        return [place_m.T for place_m in self.positions_enu_m]

    def _echoes(  # noqa: PLR0917
        self,
        position_enu_m: Floats,
        rcs_m2: Floats,
        radiated_w: Floats,
        wavelengths_m: Sequence[float] | Floats,
        places_enu_m: Floats,
        integration_s: float = 1.0,
        noise_w_hz: float = 1.0,
    ) -> Floats:
        """Mean echoes of targets by transmitters elsewhere, watts or over noise (eqs 17, 21, 24).

        (n, 3) and (n,) in, (n, K) out, of K signals: what each radiates with all gains, (K,), and
        from where, (K, 3).
        """
        range_rx_m = np.maximum(distance_m(position_enu_m), NEAREST_M)
        echoes = np.empty((len(position_enu_m), len(radiated_w)))
        for k, (wavelength_m, place_m) in enumerate(zip(wavelengths_m, places_enu_m, strict=True)):
            place_enu_m = place_m.T
            range_tx_m = np.maximum(distance_m(position_enu_m - place_enu_m), NEAREST_M)
            way_m2 = range_tx_m * range_rx_m
            aperture_m4 = wavelength_m * wavelength_m * rcs_m2
            echo_w = radiated_w[k] * aperture_m4 / (SPREAD * (way_m2 * way_m2))
            echo = echo_w * integration_s / noise_w_hz
            if not self.is_in_free_space:
                echo *= self.way_factor(position_enu_m, wavelength_m)
                echo *= self.way_factor(position_enu_m, wavelength_m, place_enu_m)
            echoes[:, k] = echo
        return echoes


@dataclass(frozen=True, kw_only=True)
class PolarRadar(Volume, EchoRadar, CellSensor, ABC):
    """What the equations need. Beamwidths are those of the receive beam, at 3 dB.

    A radar looks at a target by one or more signals at once, K of them; range is from the receiver.
    Where pulses are modelled, it does so in N intervals: ratios are (n, N K). Run lengths are not
    modelled where nobody asks for them.
    """

    frequency_hz: float
    integration_s: float
    loss_db: float
    noise_figure_db: float
    n_reference: int
    range_resolution_m: float
    azimuth_beamwidth_deg: float
    elevation_beamwidth_deg: float
    doppler_cells: int
    range_floor_m: float
    azimuth_floor_deg: float
    elevation_floor_deg: float
    measures_elevation: bool
    measures_run_length: bool = True
    intervals: PulseIntervals | None = None
    classifier: Confusion | None = None

    alike: ClassVar[frozenset[str]] = EchoRadar.alike | {"intervals", "classifier"}

    @abstractmethod
    def signal_snrs(self, position_enu_m: Floats, rcs_m2: Floats) -> Floats:
        """Mean signal-to-noise ratios of each signal, linear; (n, 3) and (n,) in, (n, K) out."""

    @property
    def _cfar(self) -> FluctuatingCfar:
        """The detector of an interval, of the reference samples of all signals together."""
        return FluctuatingCfar(
            self.pfa, self.n_looks, self.n_reference * self.n_looks, self.usual_order
        )

    @property
    def n_signals(self) -> int:
        """Signals of a look, those of all intervals."""
        return self.n_looks * (1 if self.intervals is None else self.intervals.count)

    def pd(self, snrs: Floats, order: Floats | None = None) -> Floats:
        """Probability that the look detects, or that enough of its intervals do."""
        if self.intervals is None:
            return self._cfar.pd(snrs, order)
        from plotfeed.models.effects.pulse_intervals import at_least

        return at_least(self._pd_each(snrs, order), self.intervals.needed)

    def draw_detected(
        self, snrs: Floats, rng: np.random.Generator, order: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """Powers a signal of detections, and thresholds; of several intervals, of the first."""
        if self.intervals is not None:
            from plotfeed.models.effects.pulse_intervals import chosen, first_successes

            first = first_successes(self._pd_each(snrs, order), self.intervals.needed)
            which = chosen(first, rng.random((len(snrs),)))
            by_interval = self._by_interval(snrs)
            snrs = np.take_along_axis(by_interval, which[:, None, None], axis=1)[:, 0]
        power, threshold = self._cfar.draw_detected(snrs, order, rng)
        return power / self.n_looks, threshold / self.n_looks

    def inverse_detected(self, snrs: Floats, order: Floats | None = None) -> Floats:
        """Mean of 1/x over detections of power x; of several intervals, of the first."""
        if self.intervals is None:
            return self.n_looks * self._cfar.inverse_detected(snrs, order)
        from plotfeed.models.effects.pulse_intervals import first_successes

        first = first_successes(self._pd_each(snrs, order), self.intervals.needed)
        by_interval = self._by_interval(snrs)
        columns = [
            self.n_looks * self._cfar.inverse_detected(by_interval[:, i], order)
            for i in range(self.intervals.count)
        ]
        return np.asarray((first * np.stack(columns, axis=-1)).sum(axis=1))

    def _by_interval(self, snrs: Floats) -> Floats:
        """Ratios by interval and signal; (n, N, K)."""
        return snrs.reshape(len(snrs), snrs.shape[1] // self.n_looks, self.n_looks)

    def _pd_each(self, snrs: Floats, order: Floats | None) -> Floats:
        """Probability of detection of each interval; (n, N)."""
        each = snrs.reshape(-1, self.n_looks)
        count = snrs.shape[1] // self.n_looks
        orders = None if order is None else np.repeat(order, count)
        return self._cfar.pd(each, orders).reshape(-1, count)

    @property
    def furthest_told_m(self) -> float:
        """The end of the ranges in plots: where they fold, if that is within cover."""
        folds_at_m = None if self.intervals is None else self.intervals.folds_at_m
        return self.range_max_m if folds_at_m is None else min(folds_at_m, self.range_max_m)

    @property
    def alarm_pfa(self) -> float:
        """Probability of a false alarm of a cell in a scan."""
        if self.intervals is None:
            return self.pfa
        return self.intervals.false_alarm_probability(self.pfa)

    @property
    def measures_range_rate(self) -> bool:
        """Whether Doppler cells or filters of pulses are modelled."""
        by_filters = self.intervals is not None and self.intervals.filters_rates
        return by_filters or super().measures_range_rate

    @property
    def shows_sidelobes(self) -> bool:
        """Whether it reports what comes by its side lobes."""
        effects = self.echo_effects
        antenna = None if effects is None else effects.antenna
        return antenna is not None and antenna.shows_sidelobes

    def mean_place(
        self, azimuth_deg: Floats, elevation_deg: Floats, range_m: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Places with ranges as they fold; (n,) each."""
        if self.intervals is not None:
            range_m = self.intervals.folded_m(range_m)
        return azimuth_deg, elevation_deg, range_m

    @cached_property
    def resolution_cells(self) -> float:
        """Range cells x azimuth beams x elevation beams x Doppler cells (eq 9, right form)."""
        elevation_span_deg = self.elevation_max_deg - self.elevation_min_deg
        return (
            cells_across(self.furthest_told_m - self.range_min_m, self.range_resolution_m)
            * cells_across(self.azimuth_cover.span_deg, self.azimuth_beamwidth_deg)
            * cells_across(elevation_span_deg, self.elevation_beamwidth_deg)
            * self.doppler_cells
        )

    @sensor_property
    def noise_dbm(self) -> float:
        """Noise power of the receiver, in the bandwidth of a range cell, c/2D (eqs 5, 21).

        The amplitude of a plot is its SNR above this: what the integration gains is counted in.
        """
        density_w_hz = propagation.noise_density_w_hz(self.noise_figure_db)
        bandwidth_hz = C_M_S / (2 * self.range_resolution_m)
        return float(10 * np.log10(density_w_hz * bandwidth_hz) + 30)

    @property
    def receiver_noise_w_hz(self) -> Floats:
        """Density of thermal noise (eq 5), the same in all signals; (1,)."""
        return np.array([float(propagation.noise_density_w_hz(self.noise_figure_db))])

    def sigmas(self, snr: Floats) -> Floats:
        """Standard deviations of range, azimuth and elevation, rows, at a detection's own SNR.

        (n,) in, (3, n) out: eqs 13 to 15, and floors in quadrature.
        """
        widths, floors = self._widths_and_floors
        return accuracy.with_floor(accuracy.noise_share(snr) * widths, floors)

    def sigmas_at(self, snr: Floats, channel: Ints) -> Mapping[str, Floats]:
        """Standard deviations that follow from detections' own ratios, linear, by the columns."""
        range_m, azimuth_deg, elevation_deg = self.sigmas(snr)
        found = {"sigma_range_m": range_m, "sigma_azimuth_deg": azimuth_deg}
        if self.measures_elevation:
            found["sigma_elevation_deg"] = elevation_deg
        if self.doppler is not None:
            found["sigma_range_rate_m_s"] = self.doppler.sigma_m_s(snr, channel)
        return found

    @sensor_property
    def _widths_and_floors(self) -> tuple[Floats, Floats]:
        """What noise leaves of range, azimuth and elevation, and the floors that stay; (3, 1)."""
        widths = [
            accuracy.sigma_range_m(0.5, self.range_resolution_m),
            accuracy.sigma_angle_deg(0.5, self.azimuth_beamwidth_deg),
            accuracy.sigma_angle_deg(0.5, self.elevation_beamwidth_deg),
        ]
        floors = [self.range_floor_m, self.azimuth_floor_deg, self.elevation_floor_deg]
        return np.array(widths)[:, None], np.array(floors)[:, None]

    def look_snrs(self, targets: Targets, rows: Ints | slice = EVERY_ROW) -> Floats:
        """Mean ratios of each signal's echo of those rows of targets, the model's own; (n, K)."""
        snrs = self.signal_snrs(targets.true_position_enu_m[rows], targets.rcs_m2(rows))
        snrs = self._with_effects(snrs, targets, rows)
        if self.intervals is None:
            return snrs
        place_enu_m, rate_m_s = targets.true_position_enu_m[rows], None
        if targets.velocity_enu_m_s is not None:
            from plotfeed.models.effects.doppler import range_rate_m_s

            rate_m_s = range_rate_m_s(place_enu_m, targets.velocity_enu_m_s[rows])
        range_m, t_utc_ns = distance_m(place_enu_m), targets.t_utc_ns[rows]
        left = self.intervals.power_factor(range_m, rate_m_s, t_utc_ns)
        every = left[:, :, None] * snrs[:, None]
        return np.asarray(every.reshape(len(snrs), left.shape[1] * snrs.shape[1]))

    def look_strengths(self, targets: Targets, rows: Ints | slice) -> tuple[Floats, Floats | None]:
        """Ratios of those rows of targets, (n, K), and orders by which they fluctuate, (n,).

        Given how strong the targets are then, where that stays for a while.
        """
        snrs, order = self.look_snrs(targets, rows), self.orders(targets, rows)
        if targets.strengths is None:
            return snrs, order
        return targets.strengths.applied(snrs, order, targets.drone[rows], targets.t_utc_ns[rows])

    def observe(self, targets: Targets, rng: np.random.Generator) -> tuple[Looks, Plots]:
        """Look once at each target within cover, and plot those detected.

        Heights are left out: they take the sensor's place on Earth.
        """
        geometry = azimuth_deg, elevation_deg, range_m = enu_to_aer(targets.position_enu_m)
        covered = rows_where(self.in_cover(range_m, azimuth_deg, elevation_deg))
        of_covered = self.rows(covered)
        snrs, order = of_covered.look_strengths(targets, covered)
        channel = np.zeros(len(snrs), np.int64)
        return of_covered._looks_and_plots(
            targets, covered, geometry, of_rows(rng, covered), snrs, channel, order
        )

    def predict(self, targets: Targets) -> Prediction:
        """Closed forms; over all places of the intervals in a beam that passes."""
        if self.intervals is None or self.intervals.beam is None:
            return self._predicted(targets)
        everywhere = np.zeros(len(targets), np.int64)
        return mean_prediction(
            [
                self._predicted(replace(targets, t_utc_ns=everywhere + phase_ns))
                for phase_ns in self.intervals.phases_ns
            ]
        )

    def _predicted(self, targets: Targets) -> Prediction:
        """Closed forms at the targets' mean signal-to-noise ratios."""
        snrs, order = self.look_snrs(targets), self.orders(targets)
        pd, sigma_rate_m_s = self.pd(snrs, order) * self.pd_factor, None
        # Error variances go as one over the detection's own power.
        effective_snr = 1.0 / self.inverse_detected(snrs, order)
        sigmas = self.sigmas(effective_snr) * self.error_factor
        sigma_range_m, sigma_azimuth_deg, sigma_elevation_deg = sigmas
        if self.doppler is not None:
            channel = np.zeros(len(snrs), np.int64)
            sigma_rate_m_s = self.doppler.sigma_m_s(effective_snr, channel) * self.error_factor
            rate_m_s = self._range_rates(targets, EVERY_ROW, channel)
            if rate_m_s is not None:
                pd = pd * self.doppler.share_passed(rate_m_s, channel)
        return Prediction(
            snr=mean_over_signals(snrs),
            pd=pd,
            sigma_range_m=sigma_range_m,
            sigma_azimuth_deg=sigma_azimuth_deg,
            sigma_elevation_deg=(
                sigma_elevation_deg if self.measures_elevation else np.full(len(snrs), np.nan)
            ),
            sigma_range_rate_m_s=sigma_rate_m_s,
        )

    def measured(self, hits: Hits, targets: Targets) -> Plots:
        """Geometry as sensed plus errors (eqs 13 to 15) by the SNR of each very detection."""
        echoes, columns, rng = hits.echoes, hits.columns, hits.rng
        snr, threshold = self.draw_detected(hits.powers, rng, hits.order)
        sigmas = self.sigmas(snr)
        errors = rng.standard_normal((3, len(echoes))) * sigmas * self.error_factor
        range_m = targets.read_range_m(echoes.range_m, echoes.t_utc_ns)
        azimuth_deg = targets.read_azimuth_deg(echoes.azimuth_deg, echoes.t_utc_ns)
        azimuth_deg, elevation_deg = accuracy.fold_over_zenith(
            azimuth_deg + errors[1], echoes.elevation_deg + errors[2]
        )
        if self.doppler is not None and "range_rate_m_s" in columns:
            columns |= self.doppler.measured(
                columns["range_rate_m_s"], snr, echoes.channel, rng, self.error_factor
            )
        columns |= targets.claims_of(echoes, self.classifier, rng)
        found_m = range_m + errors[0]
        plots = self._plots(
            snr,
            threshold,
            sigmas,
            t_utc_ns=echoes.t_utc_ns,
            range_m=found_m if self.intervals is None else self.intervals.folded_m(found_m),
            azimuth_deg=azimuth_deg,
            elevation_deg=elevation_deg,
            **echoes.whose(),
            **columns,
        )
        inside = (plots.range_m >= self.range_min_m) & (plots.range_m <= self.range_max_m)
        return plots.rows(inside & (plots.range_m > 0))

    def false_plots(self, t_utc_ns: Ints, azimuth_deg: Floats, rng: np.random.Generator) -> Plots:
        """Uniform in range and elevation (eqs 10 to 12; elevation is drawn, not height)."""
        n = len(azimuth_deg)
        snr, threshold = self.draw_detected(np.zeros((n, self.n_signals)), rng)
        columns: dict[str, NDArray[Any]] = {}
        if self.doppler is not None:
            columns |= self.doppler.of_false_alarms(snr, np.zeros(n, np.int64), rng)
        columns |= self.false_claims(n, rng)
        return self._plots(
            snr,
            threshold,
            self.sigmas(snr),
            t_utc_ns=t_utc_ns,
            range_m=rng.uniform(self.range_min_m, self.furthest_told_m, n),
            azimuth_deg=azimuth_deg,
            elevation_deg=rng.uniform(self.elevation_min_deg, self.elevation_max_deg, n),
            **columns,
        )

    def _plots(
        self, snr: Floats, threshold: Floats, sigmas: Floats, **columns: NDArray[Any]
    ) -> Plots:
        """Plots with what follows from a detection's power alone: amplitude, run length, sigmas.

        The run length is the width over which a Gaussian receive beam keeps the echo above the
        threshold: the transmit beam is taken as the wider one.
        """
        if self.measures_elevation:
            columns["sigma_elevation_deg"] = sigmas[2]
        else:
            del columns["elevation_deg"]
        if self.measures_run_length:
            width = np.sqrt(np.log2(snr / threshold))
            columns["run_length_deg"] = self.azimuth_beamwidth_deg * width
        return Plots.of(
            snr=snr,
            amplitude_dbm=self.noise_dbm + 10 * np.log10(snr),
            sigma_range_m=sigmas[0],
            sigma_azimuth_deg=sigmas[1],
            **columns,
        )

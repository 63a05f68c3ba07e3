"""The RF sensor: it detects what drones emit, finds its direction, and reads it if it can.

Free-space or log-distance propagation, an energy detector, emissions in bursts and hops, and an
interferometer. Every emitter of a drone is looked at, detected and reported by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from plotfeed.models import accuracy, detection, propagation
from plotfeed.models.chance import of_rows
from plotfeed.models.detection import cells_across
from plotfeed.models.effects.jamming import BandNoise, behind
from plotfeed.models.frames import enu_to_aer, wrap_360
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.propagation import C_M_S
from plotfeed.models.sensors.sensor_model import (
    NO_PLOTS,
    CellSensor,
    Prediction,
    RadioSensor,
    Targets,
    sensor_property,
)
from plotfeed.models.state import Bools, Floats, Ints, Looks, Plots, Texts, endless
from plotfeed.models.truth import Emissions, EmitterTable

if TYPE_CHECKING:
    from plotfeed.models.effects.classification import Confusion
    from plotfeed.models.effects.surroundings import City, OnTheWay


@dataclass(frozen=True, kw_only=True)
class RfDirectionFinder(RadioSensor, CellSensor):
    """A receiver that tells where emissions come from and what they are.

    `channel_bandwidth_hz` is that in which energy is summed and noise with it, and
    `instantaneous_bandwidth_hz` how much of the band is received at once. A `path_loss_exponent`
    of 2 is free space. `azimuth_beams` are cells for false alarms: the cover over a beam. Without
    `multipath` there is no ground. Jammers are those whose noise is in emissions' channels. A kind
    that is among `decodes` gives its identity. Without `elevation_baseline_m` there is no
    elevation, and without a classifier none that errs.
    """

    frequency_min_hz: float
    frequency_max_hz: float
    instantaneous_bandwidth_hz: float
    channel_bandwidth_hz: float
    integration_s: float
    gain_rx_dbi: float
    loss_db: float
    noise_figure_db: float
    path_loss_exponent: float
    path_loss_reference_m: float
    duty_cycle: float
    bursts_per_dwell: int
    azimuth_beams: float
    measures_azimuth: bool
    baseline_m: float
    azimuth_floor_deg: float
    classifies: bool
    decodes: frozenset[str]
    elevation_baseline_m: float | None = None
    elevation_floor_deg: float = 0.0
    classifier: Confusion | None = None
    jammers: tuple[BandNoise, ...] = ()
    city: City | None = None

    alike: ClassVar[frozenset[str]] = frozenset(
        {
            *("pfa", "channel_bandwidth_hz", "integration_s", "surroundings", "multipath"),
            *("classifier", "jammers", "city"),
        }
    )

    def with_jammers_behind(self, way: OnTheWay) -> Self:
        """The receiver with what an obstruction leaves of its jammers."""
        return replace(self, jammers=behind(self.jammers, way))

    @cached_property
    def samples(self) -> int:
        """How many independent ones the detector sums: bandwidth times time."""
        return max(round(self.channel_bandwidth_hz * self.integration_s), 1)

    @property
    def draws_by_pair(self) -> bool:
        """Whether houses hide some drones."""
        return self.city is not None

    @property
    def receiver_noise_w_hz(self) -> Floats:
        """Density of the receiver's noise, watts in a hertz; (1,)."""
        return np.array([float(propagation.noise_density_w_hz(self.noise_figure_db))])

    @sensor_property
    def noise_dbm(self) -> float:
        """Noise power in one channel: -174 dBm in one hertz, and the noise figure."""
        density_w_hz = propagation.noise_density_w_hz(self.noise_figure_db)
        return float(10 * np.log10(density_w_hz * self.channel_bandwidth_hz) + 30)

    @cached_property
    def resolution_cells(self) -> float:
        """Channels that are received at once, each in every beam."""
        channels = cells_across(self.instantaneous_bandwidth_hz, self.channel_bandwidth_hz)
        return channels * self.azimuth_beams

    @nan_without_warnings
    def width_in_band_hz(self, frequency_hz: Floats, bandwidth_hz: Floats) -> Floats:
        """How much of emissions lies in the sensor's band; negative for those beside it."""
        low_hz = np.maximum(frequency_hz - bandwidth_hz / 2, self.frequency_min_hz)
        high_hz = np.minimum(frequency_hz + bandwidth_hz / 2, self.frequency_max_hz)
        return high_hz - low_hz

    @nan_without_warnings
    def share_in_band(self, frequency_hz: Floats, bandwidth_hz: Floats) -> Floats:
        """The share of emissions' power that lies in the sensor's band; a carrier's is 0 or 1."""
        width_hz = self.width_in_band_hz(frequency_hz, bandwidth_hz)
        carrier = np.where(width_hz >= 0, 1.0, 0.0)
        return np.where(bandwidth_hz > 0, np.clip(width_hz / bandwidth_hz, 0.0, 1.0), carrier)

    def in_band(self, emitted: Emissions) -> Emissions:
        """Emissions of targets, of which the share is received that lies in the band."""
        of_sources = self.rows(emitted.target)
        share = of_sources.share_in_band(emitted.frequency_hz, emitted.bandwidth_hz)
        return emitted.but(share=share)

    @nan_without_warnings
    def intercept_probability(self, frequency_hz: Floats, bandwidth_hz: Floats) -> Floats:
        """Probability that a burst or more falls into the dwell, where it is tuned: 1 - (1-p)^n.

        p is the duty cycle times the share of the hops in the band that are received at once.
        """
        width_hz = np.maximum(self.width_in_band_hz(frequency_hz, bandwidth_hz), 0.0)
        tuned = np.minimum(self.instantaneous_bandwidth_hz / width_hz, 1.0)
        log_missed = self.bursts_per_dwell * np.log1p(-self.duty_cycle * tuned)
        return np.asarray(-np.expm1(log_missed))

    @nan_without_warnings
    def mean_snr(self, emissions: Emissions, range_m: Floats) -> Floats:
        """Signal-to-noise ratio of one sample, linear, of emissions at those ranges; (n,)."""
        loss_db = self.loss_db + propagation.path_loss_db(
            range_m,
            C_M_S / emissions.frequency_hz,
            self.path_loss_exponent,
            self.path_loss_reference_m,
        )
        received_dbm = emissions.eirp_dbm + self.gain_rx_dbi - loss_db
        return emissions.share * 10 ** ((received_dbm - self.noise_dbm) / 10)

    def received_snr(self, emissions: Emissions, targets: Targets, range_m: Floats) -> Floats:
        """Ratios of emissions over the ground, if it is modelled; ranges are the targets'."""
        source = emissions.target
        snr = self.mean_snr(emissions, range_m[source])
        if not self.is_in_free_space:
            wavelength_m = C_M_S / emissions.frequency_hz
            snr *= self.way_factor(targets.true_position_enu_m[source], wavelength_m)
        if self.city is not None:
            elevation_deg = enu_to_aer(targets.true_position_enu_m)[1]
            snr *= self.city.power_factor(elevation_deg, targets.pair_draws)[source]
        if self.jammers:
            noise = sum(jammer.over_noise_at(emissions.frequency_hz) for jammer in self.jammers)
            snr /= 1 + noise
        return snr

    def pd(self, emissions: Emissions, snr: Floats) -> Floats:
        """Probability that an emission comes, is listened to and crosses the threshold; (n,)."""
        intercepted = self.intercept_probability(emissions.frequency_hz, emissions.bandwidth_hz)
        crossed = detection.pd_noncoherent_swerling2(snr, self.pfa, self.samples)
        return np.where(emissions.share > 0, intercepted * crossed, 0.0)

    @nan_without_warnings
    def sigma_azimuth_deg(self, frequency_hz: Floats, snr: Floats) -> Floats:
        """Standard deviation of an interferometer's azimuth, with the floor.

        Noise of the phase between two channels over the electrical length of the baseline.
        """
        cosine = self._sigma_cosine(frequency_hz, snr, self.baseline_m)
        return accuracy.with_floor(np.degrees(cosine), self.azimuth_floor_deg)

    @nan_without_warnings
    def sigma_elevation_deg(
        self, frequency_hz: Floats, snr: Floats, elevation_deg: Floats
    ) -> Floats:
        """Standard deviation of an elevation by antennas above each other; NaN if there are none.

        Its sine is what they measure, so that it errs more the higher it is, up to a radian.
        """
        if self.elevation_baseline_m is None:
            return np.full(len(snr), np.nan)
        sine = self._sigma_cosine(frequency_hz, snr, self.elevation_baseline_m)
        level = np.cos(np.radians(elevation_deg))
        return accuracy.with_floor(
            np.degrees(sine / np.hypot(level, sine)), self.elevation_floor_deg
        )

    def _sigma_cosine(self, frequency_hz: Floats, snr: Floats, baseline_m: float) -> Floats:
        """Noise of the phase between two antennas over the electrical length between them."""
        phase_rad = 1 / np.sqrt(accuracy.paired_snr(snr) * self.samples)
        return np.asarray(C_M_S / frequency_hz * phase_rad / (2 * np.pi * baseline_m))

    def effective_snr(self, snr: Floats) -> Floats:
        """The ratio by which azimuths err as much as those of all detections do, rms; (n,)."""
        inverse = detection.inverse_paired_snr(snr, self.pfa, self.samples)
        return accuracy.snr_of_pair(1 / inverse)

    def in_cover(self, range_m: Floats, azimuth_deg: Floats) -> Bools:
        """Near enough and within cover; straight above only if no direction is sought."""
        omnidirectional = not self.measures_azimuth and self.azimuth_cover.span_deg >= 360
        inside = self.azimuth_cover.holds(azimuth_deg) | omnidirectional
        return (range_m > 0) & (range_m <= self.range_max_m) & inside

    def observe(self, targets: Targets, rng: np.random.Generator) -> tuple[Looks, Plots]:
        """Look once at each emitter of each target within cover and within the band."""
        geometry = azimuth_deg, _, range_m = enu_to_aer(targets.position_enu_m)
        table = EmitterTable.of(targets.signatures.emitters)
        emissions = self.in_band(table.emissions(targets.drone))
        covered = self.in_cover(range_m, azimuth_deg)[emissions.target]
        emissions = emissions.rows((emissions.share > 0) & covered)
        mine, rng = self.rows(emissions.target), of_rows(rng, emissions.target)
        snr = mine.received_snr(emissions, targets, range_m)
        pd = mine.pd(emissions, snr) * mine.pd_factor
        detected = detection.draw_hits(pd, rng)
        looks = targets.looks(
            emissions.target, geometry, snr=snr, pd=pd, detected=detected, channel=emissions.channel
        )
        if not detected.any():
            return looks, NO_PLOTS
        hits, emitted, rng = looks.rows(detected), emissions.rows(detected), of_rows(rng, detected)
        plots = mine.rows(detected)._measure(hits, emitted, targets, rng)
        told = self._read(table, emitted)
        if self.classifier is not None:
            drawn = None if targets.claims is None else targets.claims.of(hits)
            kind, probability = self.classifier.claimed(table.kinds(emitted), rng, drawn)
            was_read = told["kind"] != ""
            told["kind"] = np.where(was_read, told["kind"], kind)
            told["kind_probability"] = np.where(was_read, 1.0, probability)
        return looks, plots.but(**told)

    def _read(self, table: EmitterTable, emissions: Emissions) -> dict[str, Texts]:
        """What plots of those emissions say of them beside their measurements."""
        kinds = table.kinds(emissions)
        nothing = endless("", np.object_)[: len(kinds)]
        if not self.decodes:
            return {"kind": kinds if self.classifies else nothing, "identity": nothing}
        read = np.array([kind in self.decodes for kind in kinds.tolist()], np.bool_)
        return {
            "kind": kinds if self.classifies else np.where(read, kinds, ""),
            "identity": np.where(read, table.identities(emissions), ""),
        }

    def stated_sigmas(self, snr: float) -> dict[str, float]:
        """The error of bearings, if it finds any, in the middle of its band."""
        if not self.measures_azimuth:
            return {}
        middle_hz = np.array([(self.frequency_min_hz + self.frequency_max_hz) / 2])
        at = middle_hz, np.array([snr])
        stated = {"sigma_azimuth_deg": float(self.sigma_azimuth_deg(*at)[0])}
        if self.elevation_baseline_m is not None:
            level = self.sigma_elevation_deg(*at, np.zeros(1))
            stated["sigma_elevation_deg"] = float(level[0])
        return stated

    def predict(self, targets: Targets) -> Prediction:
        """Pd of a report by any emitter, SNR of the strongest, rms azimuth error over all reports.

        NaN for targets that do not emit.
        """
        table = EmitterTable.of(targets.signatures.emitters)
        emissions = self.in_band(table.emissions(targets.drone))
        source = emissions.target
        _, elevation_deg, range_m = enu_to_aer(targets.position_enu_m)
        snr = self.received_snr(emissions, targets, range_m)
        pd = np.nan_to_num(self.pd(emissions, snr)) * self.pd_factor
        miss = np.ones(len(targets))
        np.multiply.at(miss, source, 1 - pd)
        strongest = np.full(len(targets), np.nan)
        np.fmax.at(strongest, source, snr)
        sigmas = [np.full(len(pd), np.nan)] * 2
        if self.measures_azimuth:
            of_hits = emissions.frequency_hz, self.effective_snr(snr)
            sigmas = [
                self.sigma_azimuth_deg(*of_hits),
                self.sigma_elevation_deg(*of_hits, elevation_deg[source]),
            ]
        azimuth_deg, elevation_deg = (
            self._rms_deg(emissions, sigma, pd, len(targets)) for sigma in sigmas
        )
        return Prediction(
            snr=strongest,
            pd=1 - miss,
            sigma_range_m=np.full(len(targets), np.nan),
            sigma_azimuth_deg=azimuth_deg,
            sigma_elevation_deg=elevation_deg,
        )

    @nan_without_warnings
    def _rms_deg(
        self, emissions: Emissions, sigma_deg: Floats, pd: Floats, n_targets: int
    ) -> Floats:
        """Rms over the reports of each target, by the emitters' shares of them; (n_targets,)."""
        reported = pd > 0
        rows, weights = emissions.target[reported], pd[reported]
        squares_deg2 = np.bincount(rows, weights * sigma_deg[reported] ** 2, n_targets)
        mean_deg2 = squares_deg2 / np.bincount(rows, weights, n_targets)
        return np.sqrt(mean_deg2) * self.error_factor

    def _measure(
        self, hits: Looks, emissions: Emissions, targets: Targets, rng: np.random.Generator
    ) -> Plots:
        """Directions with errors by the SNR that each very detection shows."""
        snr = self._draw_estimated_snr(hits.snr, rng)
        errors = rng.standard_normal((len(hits),)) * self.error_factor
        azimuth_deg = targets.read_azimuth_deg(hits.azimuth_deg, hits.t_utc_ns)
        azimuth_deg = azimuth_deg + errors * self.sigma_azimuth_deg(emissions.frequency_hz, snr)
        elevation_deg = hits.elevation_deg
        if self.elevation_baseline_m is not None:
            sigma_deg = self.sigma_elevation_deg(emissions.frequency_hz, snr, elevation_deg)
            lifted_deg = sigma_deg * self.error_factor * rng.standard_normal((len(hits),))
            azimuth_deg, elevation_deg = accuracy.fold_over_zenith(
                azimuth_deg, elevation_deg + lifted_deg
            )
        return self._plots(
            snr,
            emissions.frequency_hz,
            azimuth_deg,
            elevation_deg,
            t_utc_ns=hits.t_utc_ns,
            channel=hits.channel,
            **hits.whose(),
            **targets.true_geometry(hits, emissions.target),
        )

    def false_plots(self, t_utc_ns: Ints, azimuth_deg: Floats, rng: np.random.Generator) -> Plots:
        """Uniform over the band and, where that is measured, from horizon to zenith."""
        n = len(azimuth_deg)
        frequency_hz = rng.uniform(self.frequency_min_hz, self.frequency_max_hz, n)
        snr = self._draw_estimated_snr(np.zeros(n), rng)
        elevation_deg = np.zeros(n)
        if self.elevation_baseline_m is not None:
            elevation_deg = rng.uniform(0.0, 90.0, n)
        claims = self.false_claims(n, rng)
        return self._plots(
            snr, frequency_hz, azimuth_deg, elevation_deg, t_utc_ns=t_utc_ns, **claims
        )

    def _draw_estimated_snr(self, snr: Floats, rng: np.random.Generator) -> Floats:
        """The SNR that the energy of each detection shows."""
        detected = detection.draw_detected_energy(snr, self.pfa, self.samples, rng)
        return detection.estimated_snr(detected, self.samples)

    def _plots(
        self,
        snr: Floats,
        frequency_hz: Floats,
        azimuth_deg: Floats,
        elevation_deg: Floats,
        **columns: NDArray[Any],
    ) -> Plots:
        """Plots with the received power, and with the direction if the sensor finds it."""
        if self.measures_azimuth:
            columns["azimuth_deg"] = wrap_360(azimuth_deg)
            columns["sigma_azimuth_deg"] = self.sigma_azimuth_deg(frequency_hz, snr)
        if self.elevation_baseline_m is not None:
            columns["elevation_deg"] = elevation_deg
            sigma_deg = self.sigma_elevation_deg(frequency_hz, snr, elevation_deg)
            columns["sigma_elevation_deg"] = sigma_deg
        return Plots.of(snr=snr, amplitude_dbm=self.noise_dbm + 10 * np.log10(snr), **columns)

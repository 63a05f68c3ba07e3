"""Microphone arrays: section 3.3 of the paper, equations 37 to 44 in right form.

Sound levels in decibels throughout (ISO 9613-2), a logistic probability of detection, bearings
alone. A drone is heard where it was when the sound left it: at v across the line of sight its
bearing lags by v over the speed of sound, at any distance.

Two arrays triangulate: where their bearings cross there is a plot. Each hears a drone where it was
when the sound left it for that array, so that bearings to one that moves cross beside it. Every
bearing of one crosses every bearing of the other: with several drones there are crossings where
there is none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from plotfeed.models import accuracy, detection, propagation
from plotfeed.models.beam import Sector
from plotfeed.models.chance import of_rows
from plotfeed.models.detection import cells_across
from plotfeed.models.effects.surroundings import SeenFrom, Surroundings
from plotfeed.models.frames import enu_to_aer
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.sensors.sensor_model import (
    NO_PLOTS,
    CellSensor,
    JointSensor,
    Prediction,
    Targets,
)
from plotfeed.models.state import FALSE_ALARM, NS, Bools, Floats, Ints, Looks, Plots

if TYPE_CHECKING:
    from plotfeed.models.effects.classification import Confusion
    from plotfeed.models.effects.microphone_layout import MicrophoneLayout


MAX_ELEVATION_DEG = 90.0
REFERENCE_DISTANCE_M = 1.0


@dataclass(frozen=True, kw_only=True)
class MicrophoneArray(CellSensor):
    """What the equations need; levels in dB re 20 uPa, of the band in which the array listens.

    Without a beamwidth in elevation it measures none. `kind` is what it takes every sound for, ""
    if it does not classify. With a layout, errors of directions are those of its geometry, and
    beams are cells for false alarms alone.
    """

    frequency_hz: float
    directivity_db: float
    absorption_db_per_m: float
    barrier_db: float
    misc_db: float
    array_gain_db: float
    noise_db: float
    sensitivity_db: float
    slope_per_db: float
    height_above_ground_m: float
    sound_speed_m_s: float
    azimuth_beamwidth_deg: float
    elevation_beamwidth_deg: float | None
    azimuth_floor_deg: float
    elevation_floor_deg: float
    kind: str
    layout: MicrophoneLayout | None = None
    classifier: Confusion | None = None

    alike: ClassVar[frozenset[str]] = frozenset({"layout", "classifier", "surroundings"})

    @property
    def errs_as_stated(self) -> bool:
        """Not where a layout's errors are other than normal: near the horizon, and by sides."""
        return self.layout is None

    @property
    def signal_speed_m_s(self) -> float:
        """Speed of sound."""
        return self.sound_speed_m_s

    @cached_property
    def resolution_cells(self) -> float:
        """Beams in azimuth x beams from horizon to zenith, if any: no cells of range (eq 9)."""
        azimuth_beams = cells_across(self.azimuth_cover.span_deg, self.azimuth_beamwidth_deg)
        if self.elevation_beamwidth_deg is None:
            return azimuth_beams
        return azimuth_beams * cells_across(MAX_ELEVATION_DEG, self.elevation_beamwidth_deg)

    @nan_without_warnings
    def level_db(self, power_level_db: Floats, position_enu_m: Floats) -> Floats:
        """Sound pressure level at the array, (n,), of sources at those places (n, 3) (eqs 37, 39).

        The ground is flat, `height_above_ground_m` below the array. No source is nearer than the
        metre from which spreading is counted (ISO 9613-2, 7.1).
        """
        range_m = np.maximum(enu_to_aer(position_enu_m)[2], REFERENCE_DISTANCE_M)
        source_height_m = np.maximum(position_enu_m[:, 2] + self.height_above_ground_m, 0.0)
        mean_height_m = (source_height_m + self.height_above_ground_m) / 2
        attenuation_db = (
            propagation.sound_divergence_db(range_m)  # eq 40
            + self.absorption_db_per_m * range_m  # eq 41
            + propagation.ground_attenuation_db(mean_height_m, range_m)  # eq 42
            + self.barrier_db
            + self.misc_db
        )
        if self.surroundings is not None:
            wavelength_m = self.sound_speed_m_s / self.frequency_hz
            factor = self.surroundings.power_factor(position_enu_m, wavelength_m)
            attenuation_db = attenuation_db - 10 * np.log10(factor)
        return propagation.sound_level_db(power_level_db, self.directivity_db, attenuation_db)

    def snr_db(self, power_level_db: Floats, position_enu_m: Floats) -> Floats:
        """Signal-to-noise ratio behind the array, dB (eq 38); NaN for what makes no known sound."""
        return self.level_db(power_level_db, position_enu_m) + self.array_gain_db - self.noise_db

    def pd(self, snr_db: Floats) -> Floats:
        """Probability of detection (eq 43)."""
        return detection.pd_logistic(snr_db, self.sensitivity_db, self.slope_per_db)

    def sigma_azimuth_deg(self, snr: Floats) -> Floats:
        """Standard deviation of the azimuth, about the direction from which the sound comes."""
        return accuracy.sigma_angle_deg(snr, self.azimuth_beamwidth_deg, self.azimuth_floor_deg)

    def sigma_elevation_deg(self, snr: Floats) -> Floats:
        """Standard deviation of the elevation; NaN if the array measures none."""
        if self.elevation_beamwidth_deg is None:
            return np.full(len(snr), np.nan)
        return accuracy.sigma_angle_deg(snr, self.elevation_beamwidth_deg, self.elevation_floor_deg)

    def in_cover(self, range_m: Floats, azimuth_deg: Floats) -> Bools:
        """Near enough and within cover; a sound from straight above has no azimuth."""
        return (range_m > 0) & (range_m <= self.range_max_m) & self.azimuth_cover.holds(azimuth_deg)

    def observe(self, targets: Targets, rng: np.random.Generator) -> tuple[Looks, Plots]:
        """Look once at each target whose sound is known and within reach."""
        geometry = azimuth_deg, _, range_m = enu_to_aer(targets.position_enu_m)
        power_level_db = targets.sound_power_db()
        audible = np.flatnonzero(self.in_cover(range_m, azimuth_deg) & ~np.isnan(power_level_db))
        of_audible, rng = self.rows(audible), of_rows(rng, audible)
        snr_db = of_audible.snr_db(power_level_db[audible], targets.sensed_enu_m[audible])
        pd, snr = of_audible.pd(snr_db) * of_audible.pd_factor, 10 ** (snr_db / 10)
        detected = detection.draw_hits(pd, rng)  # eq 44
        looks = targets.looks(audible, geometry, snr=snr, pd=pd, detected=detected)
        if not detected.any():
            return looks, NO_PLOTS
        hits, rng = looks.rows(detected), of_rows(rng, detected)
        return looks, of_audible.rows(detected)._measure(hits, targets, audible[detected], rng)

    def stated_sigmas(self, snr: float) -> dict[str, float]:
        """Errors of the bearing, by the SNR; of a layout, amidst the cover and 45 degrees high."""
        of_one = np.array([snr])
        middle_deg = self.azimuth_cover.min_deg + self.azimuth_cover.span_deg / 2
        sigmas = self.sigmas_towards(
            of_one, np.array([middle_deg]), np.array([MAX_ELEVATION_DEG / 2])
        )
        stated = {"sigma_azimuth_deg": float(sigmas[0][0])}
        if self.elevation_beamwidth_deg is not None:
            stated["sigma_elevation_deg"] = float(sigmas[1][0])
        return stated

    def predict(self, targets: Targets) -> Prediction:
        """Closed forms; the sigmas are about the direction from which the sound comes."""
        power_level_db = targets.sound_power_db()
        snr_db = self.snr_db(power_level_db, targets.sensed_enu_m)
        snr = 10 ** (snr_db / 10)
        azimuth_deg, elevation_deg, _ = enu_to_aer(targets.position_enu_m)
        sigma_azimuth_deg, sigma_elevation_deg = self.sigmas_towards(
            snr, azimuth_deg, elevation_deg
        )
        return Prediction(
            snr=snr,
            pd=np.nan_to_num(self.pd(snr_db), nan=0.0) * self.pd_factor,
            sigma_range_m=np.full(len(snr), np.nan),
            sigma_azimuth_deg=sigma_azimuth_deg * self.error_factor,
            sigma_elevation_deg=sigma_elevation_deg * self.error_factor,
        )

    def sigmas_towards(
        self, snr: Floats, azimuth_deg: Floats, elevation_deg: Floats
    ) -> tuple[Floats, Floats]:
        """Standard deviations of azimuth and elevation in those directions; (n,) each."""
        if self.layout is None:
            return self.sigma_azimuth_deg(snr), self.sigma_elevation_deg(snr)
        noise_deg = self.layout.sigmas_deg(azimuth_deg, elevation_deg, snr)
        sigma_elevation_deg = np.full(len(snr), np.nan)
        if self.elevation_beamwidth_deg is not None:
            sigma_elevation_deg = accuracy.with_floor(noise_deg[1], self.elevation_floor_deg)
        return accuracy.with_floor(noise_deg[0], self.azimuth_floor_deg), sigma_elevation_deg

    def _measure(
        self, hits: Looks, targets: Targets, rows: Ints, rng: np.random.Generator
    ) -> Plots:
        """Where the sound comes from plus errors; beside it, privately, where the drone is now."""
        errors = rng.standard_normal((2, len(hits))) * self.error_factor
        azimuth_deg = targets.read_azimuth_deg(hits.azimuth_deg, hits.t_utc_ns)
        elevation_deg = hits.elevation_deg
        if self.layout is None:
            errors *= np.stack(
                [self.sigma_azimuth_deg(hits.snr), self.sigma_elevation_deg(hits.snr)]
            )
        else:
            ratio = hits.snr / self.error_factor**2
            azimuth_deg, elevation_deg = self.layout.measured(
                azimuth_deg, elevation_deg, ratio, self.azimuth_cover.holds, rng
            )
            errors[0] *= self.azimuth_floor_deg
            errors[1] *= self.elevation_floor_deg
        azimuth_deg, elevation_deg = accuracy.fold_over_zenith(
            azimuth_deg + errors[0], elevation_deg + np.nan_to_num(errors[1])
        )
        return self._plots(
            hits.snr,
            t_utc_ns=hits.t_utc_ns,
            azimuth_deg=azimuth_deg,
            elevation_deg=elevation_deg,
            **targets.claims_of(hits, self.classifier, rng),
            **hits.whose(),
            **targets.true_geometry(hits, rows),
        )

    def false_plots(self, t_utc_ns: Ints, azimuth_deg: Floats, rng: np.random.Generator) -> Plots:
        """Uniform in elevation, from horizon to zenith.

        Their levels lie over the sensitivity by what the tail of the logistic law leaves there: an
        exponential of mean 1/slope, in dB.
        """
        n = len(azimuth_deg)
        snr_db = self.sensitivity_db + rng.standard_exponential(n) / self.slope_per_db
        elevation_deg = rng.uniform(0.0, MAX_ELEVATION_DEG, n)
        return self._plots(
            10 ** (snr_db / 10),
            t_utc_ns=t_utc_ns,
            azimuth_deg=azimuth_deg,
            elevation_deg=elevation_deg,
            **self.false_claims(n, rng),
        )

    def _plots(self, snr: Floats, **columns: NDArray[Any]) -> Plots:
        """Plots with what follows of level and direction, and without what is not measured."""
        sigma_azimuth_deg, sigma_elevation_deg = self.sigmas_towards(
            snr, columns["azimuth_deg"], columns["elevation_deg"]
        )
        if self.elevation_beamwidth_deg is None:
            del columns["elevation_deg"]
        return Plots.of(
            snr=snr,
            sigma_azimuth_deg=sigma_azimuth_deg,
            sigma_elevation_deg=sigma_elevation_deg,
            **{"kind": np.full(len(snr), self.kind, np.object_)} | columns,
        )


MOST_BEARINGS = 300  # Of an array in a scan, that are crossed with those of the other: the loudest


@dataclass(frozen=True, slots=True)
class Crossing:
    """Where two bearings meet on the ground, as seen from the first array; (...) each.

    Distances from both arrays, NaN where bearings do not meet ahead of both, and the covariance of
    the place, east and north.
    """

    range_m: Floats
    other_range_m: Floats
    sigma_range_m: Floats
    east_m2: Floats
    north_m2: Floats
    east_north_m2: Floats


@nan_without_warnings
def crossing(
    first_deg: Floats,
    second_deg: Floats,
    baseline_enu_m: tuple[float, float, float],
    sigma_first_deg: Floats,
    sigma_second_deg: Floats,
) -> Crossing:
    """Where bearings from the origin and from `baseline_enu_m` cross, and its covariance.

    By the sine of their difference, which keeps its digits where they are nearly parallel. An error
    of one bearing moves the crossing along the other: near the baseline without bounds.
    """
    first, second = np.radians(first_deg), np.radians(second_deg)
    sine = np.sin(np.radians(first_deg - second_deg))
    east_m, north_m, _ = baseline_enu_m
    range_m = (east_m * np.cos(second) - north_m * np.sin(second)) / sine
    other_m = (east_m * np.cos(first) - north_m * np.sin(first)) / sine
    along_second = range_m * np.radians(sigma_first_deg) / sine
    along_first = other_m * np.radians(sigma_second_deg) / sine
    ahead = (range_m > 0) & (other_m > 0)
    cos = np.cos(first - second)
    return Crossing(
        range_m=np.where(ahead, range_m, np.nan),
        other_range_m=np.where(ahead, other_m, np.nan),
        sigma_range_m=np.hypot(along_second * cos, along_first),
        east_m2=(along_second * np.sin(second)) ** 2 + (along_first * np.sin(first)) ** 2,
        north_m2=(along_second * np.cos(second)) ** 2 + (along_first * np.cos(first)) ** 2,
        east_north_m2=along_second**2 * np.sin(second) * np.cos(second)
        + along_first**2 * np.sin(first) * np.cos(first),
    )


@dataclass(frozen=True, kw_only=True)
class AcousticPair(JointSensor):
    """Two arrays alike, the first at the sensor's place, the second off it by `baseline_enu_m`.

    Places are those on the ground, unless the arrays measure elevations.
    """

    array: MicrophoneArray
    baseline_enu_m: tuple[float, float, float]

    @property
    def signal_speed_m_s(self) -> float:
        """Speed of sound."""
        return self.array.sound_speed_m_s

    @property
    def claims_held_ns(self) -> int:
        """How long what the arrays call a drone stays."""
        return self.array.claims_held_ns

    @property
    def false_alarms_per_scan(self) -> float:
        """Mean number of plots of bearings that no sound caused, in both arrays; without ghosts."""
        return self.array.false_alarms_per_scan**2

    def heard_by_second(self, targets: Targets) -> Targets:
        """Targets where they were when their sound left them for the second array, seen from it.

        They fly straight, as from where the first array hears them to where they are now.
        """
        place_m = targets.true_position_enu_m - np.array(self.baseline_enu_m)
        if targets.emitted_utc_ns is None:
            own_m = targets.along_own_axes(place_m)
            return replace(targets, position_enu_m=own_m, true_position_enu_m=place_m)
        travelled_s = (targets.t_utc_ns - targets.emitted_utc_ns)[:, None] / NS
        moved_m = targets.true_position_enu_m - targets.sensed_enu_m
        velocity_m_s = np.divide(
            moved_m, travelled_s, out=np.zeros_like(moved_m), where=travelled_s > 0
        )
        speed2 = self.array.sound_speed_m_s**2 - (velocity_m_s**2).sum(axis=1)
        closing = (place_m * velocity_m_s).sum(axis=1)
        root = np.sqrt(closing**2 + speed2 * (place_m**2).sum(axis=1))
        delay_s = (root - closing) / speed2
        return replace(
            targets,
            position_enu_m=targets.along_own_axes(place_m - velocity_m_s * delay_s[:, None]),
            true_position_enu_m=place_m,
        )

    @cached_property
    def _arrays(self) -> tuple[MicrophoneArray, MicrophoneArray]:
        """Both, each among the surroundings as it meets them."""
        met = self.surroundings
        if met is None:
            return self.array, self.array
        elsewhere = Surroundings((SeenFrom(met, self.baseline_enu_m),))
        return (replace(self.array, surroundings=met), replace(self.array, surroundings=elsewhere))

    @property
    def other_ends_enu_m(self) -> Floats:
        """Where the second array stands."""
        return np.array([self.baseline_enu_m])

    def observe_scan(
        self, targets: Targets, sector: Sector, rng: np.random.Generator
    ) -> tuple[Looks, Plots]:
        """Looks that count for both arrays, and where all of their bearings cross."""
        looks, bearings = [], []
        heard = targets, self.heard_by_second(targets)
        for array, each in zip(self._arrays, heard, strict=True):
            seen, plots = array.observe(each, rng)
            alarms = array.draw_false_alarms(sector, rng)
            looks.append(seen)
            found = Plots.joined([plots, alarms])
            if len(found) > MOST_BEARINGS:
                found = found.rows(np.sort(np.argsort(-found.snr)[:MOST_BEARINGS]))
            bearings.append(found)
        _, of_first, of_second = np.intersect1d(
            looks[0].drone, looks[1].drone, assume_unique=True, return_indices=True
        )
        order = np.argsort(of_first)
        mine, theirs = looks[0].rows(of_first[order]), looks[1].rows(of_second[order])
        both = mine.but(pd=mine.pd * theirs.pd, detected=mine.detected & theirs.detected)
        return both, self._crossed(*bearings)

    def _crossed(self, first: Plots, second: Plots) -> Plots:
        """Plots where bearings of both cross within range, known better than that."""
        i, j = (index.ravel() for index in np.indices((len(first), len(second))))
        one, other = first.rows(i), second.rows(j)
        met = crossing(
            one.azimuth_deg,
            other.azimuth_deg,
            self.baseline_enu_m,
            one.sigma_azimuth_deg,
            other.sigma_azimuth_deg,
        )
        within = (met.range_m <= self.range_max_m) & (met.other_range_m <= self.range_max_m)
        within &= met.sigma_range_m <= self.range_max_m
        same = (one.drone == other.drone) & (one.drone != FALSE_ALARM)
        columns: dict[str, NDArray[Any]] = {
            name: np.where(same, getattr(one, name), np.nan)
            for name in ("true_range_m", "true_azimuth_deg", "true_elevation_deg")
        }
        for name in ("kind", "kind_probability"):
            if one.measures(name):
                columns[name] = getattr(one, name)
        plots = Plots.of(
            t_utc_ns=one.t_utc_ns,
            range_m=met.range_m,
            azimuth_deg=one.azimuth_deg,
            snr=np.minimum(one.snr, other.snr),
            sigma_range_m=met.sigma_range_m,
            sigma_azimuth_deg=one.sigma_azimuth_deg,
            covariance_east_m2=met.east_m2,
            covariance_north_m2=met.north_m2,
            covariance_east_north_m2=met.east_north_m2,
            drone=np.where(same, one.drone, FALSE_ALARM),
            **columns,
        )
        if self.array.elevation_beamwidth_deg is not None:
            plots = self._lifted(plots, one, other, met)
        return plots.rows(within)

    def _lifted(self, plots: Plots, one: Plots, other: Plots, met: Crossing) -> Plots:
        """Plots at heights that both elevations give, each by its weight."""
        ranges_m = np.stack([met.range_m, met.other_range_m])
        elevations = np.radians(np.stack([one.elevation_deg, other.elevation_deg]))
        sigmas = np.radians(np.stack([one.sigma_elevation_deg, other.sigma_elevation_deg]))
        heights_m = ranges_m * np.tan(elevations) + np.array([[0.0], [self.baseline_enu_m[2]]])
        weights = (np.cos(elevations) ** 2 / (ranges_m * sigmas)) ** 2
        total = weights.sum(axis=0)
        height_m = (weights * heights_m).sum(axis=0) / total
        level = np.cos(np.arctan2(height_m, met.range_m))
        return plots.but(
            range_m=np.hypot(met.range_m, height_m),
            elevation_deg=np.degrees(np.arctan2(height_m, met.range_m)),
            sigma_elevation_deg=np.degrees(level**2 / met.range_m / np.sqrt(total)),
        )

    def predict(self, targets: Targets) -> Prediction:
        """Both hear it, by closed forms; errors to first order, of a drone that stays there."""
        other = self.heard_by_second(targets)
        first, second = self._arrays
        mine, theirs = first.predict(targets), second.predict(other)
        met = crossing(
            enu_to_aer(targets.position_enu_m)[0],
            enu_to_aer(other.position_enu_m)[0],
            self.baseline_enu_m,
            mine.sigma_azimuth_deg,
            theirs.sigma_azimuth_deg,
        )
        known = met.sigma_range_m <= self.range_max_m
        return Prediction(
            snr=np.minimum(mine.snr, theirs.snr),
            pd=np.where(known, mine.pd * theirs.pd, 0.0),
            sigma_range_m=np.where(known, met.sigma_range_m, np.nan),
            sigma_azimuth_deg=mine.sigma_azimuth_deg,
            sigma_elevation_deg=mine.sigma_elevation_deg,
        )

    def stated_sigmas(self, snr: float) -> dict[str, float]:
        """Errors of the bearing; that of the range goes with the place."""
        return self.array.stated_sigmas(snr)

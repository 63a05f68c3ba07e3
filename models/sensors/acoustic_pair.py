"""Two microphone arrays that triangulate: where their bearings cross there is a plot.

Each hears a drone where it was when the sound left it for that array, so that bearings to one that
moves cross beside it. Every bearing of one crosses every bearing of the other: with several drones
there are crossings where there is none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.beam import Sector
from plotfeed.models.effects.surroundings import SeenFrom, Surroundings
from plotfeed.models.frames import enu_to_aer
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.sensors.acoustic import MicrophoneArray
from plotfeed.models.sensors.sensor_model import JointSensor, Prediction, Targets
from plotfeed.models.state import FALSE_ALARM, NS, Floats, Looks, Plots

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

"""Passive and MIMO radars of several receivers: places by all pairs of transmitter and receiver.

Each pair detects by itself: a sum of ranges and, by the receiver's beam, a direction. Which of them
are of one target nobody knows: sets that fit to a place are plots (`models.joined_sets`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from plotfeed.models import accuracy
from plotfeed.models.beam import Sector, Volume, draw_azimuths
from plotfeed.models.effects.pulse_intervals import at_least
from plotfeed.models.effects.surroundings import SeenFrom, Surroundings
from plotfeed.models.fluctuation import FluctuatingCfar
from plotfeed.models.frames import distance_m, enu_to_aer
from plotfeed.models.joined_sets import (
    OUTSIDE,
    Detections,
    JoinedSets,
    SetFinder,
    Sightings,
    covariance,
    linearised,
    range_sums_m,
)
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.sensors.active_radar import MimoRadar
from plotfeed.models.sensors.passive_radar import PassiveRadar
from plotfeed.models.sensors.sensor_model import (
    EVERY_ROW,
    NO_PLOTS,
    JointSensor,
    Prediction,
    Targets,
)
from plotfeed.models.state import FALSE_ALARM, Bools, Floats, Ints, Looks, Plots


@dataclass(frozen=True, kw_only=True)
class Receiver:
    """One of the receivers: its signals, whose transmitters are seen from it, and its place."""

    signals: PassiveRadar | MimoRadar
    place_enu_m: tuple[float, float, float]

    def snrs(self, targets: Targets, rows: Ints | slice) -> Floats:
        """Mean ratios of each transmitter's echoes of those rows of targets; (n, K)."""
        place_m = targets.true_position_enu_m[rows] - np.array(self.place_enu_m)
        rcs_m2, echoes = targets.rcs_m2(rows), targets.signatures.echoes
        of_sides: float | Floats = 1.0
        if echoes is not None and echoes.has_aspects and targets.velocity_enu_m_s is not None:
            velocity_m_s = targets.velocity_enu_m_s[rows]
            from_m = list(self.signals.positions_enu_m)
            of_sides = echoes.rcs_factor(targets.drone[rows], place_m, velocity_m_s, from_m)
        if isinstance(self.signals, MimoRadar):
            return np.asarray(self.signals.signal_snrs(place_m, rcs_m2) * of_sides)
        return self.signals.mean_snr(self.signals.target_power_w(place_m, rcs_m2) * of_sides)

    @cached_property
    def cells_m(self) -> tuple[Floats, Floats]:
        """Widths of cells of the sum of ranges, and errors that remain; (K,) each."""
        signals, n = self.signals, len(self.signals.transmitters)
        if isinstance(signals, MimoRadar):  # whose own is of the distance, half of the sum
            return np.full(n, 2 * signals.range_resolution_m), np.full(n, 2 * signals.range_floor_m)
        return signals.range_resolution_m, signals.range_floors_m

    @cached_property
    def alarm_cells(self) -> tuple[float, ...]:
        """Cells that can alarm, by transmitter."""
        if isinstance(self.signals, MimoRadar):
            return (self.signals.alarm_cells,) * len(self.signals.transmitters)
        return self.signals.alarm_cells


@dataclass(frozen=True, kw_only=True)
class MultistaticRadar(Volume, JointSensor):
    """Receivers, the first at the sensor's place, and heights that it expects of targets.

    A place takes detections of `fewest_pairs`, at least three.
    """

    receivers: tuple[Receiver, ...]
    expected_height_m: float
    sigma_height_m: float
    fewest_pairs: int

    is_radio: ClassVar[bool] = True

    @cached_property
    def stations(self) -> tuple[Receiver, ...]:
        """Receivers, each among the surroundings as it meets them."""
        met = self.surroundings
        if met is None:
            return self.receivers
        found = []
        for each in self.receivers:
            seen = Surroundings((SeenFrom(met, each.place_enu_m),))
            found.append(replace(each, signals=replace(each.signals, surroundings=seen)))
        return tuple(found)

    @property
    def other_ends_enu_m(self) -> Floats:
        """Places of the other receivers, and of the transmitters."""
        here = np.array([each.place_enu_m for each in self.receivers])
        return np.concatenate([here[1:], self.receivers[0].signals.positions_enu_m])

    @cached_property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Receiver and transmitter of each channel."""
        return tuple(
            (m, k)
            for m, each in enumerate(self.receivers)
            for k in range(len(each.signals.transmitters))
        )

    @cached_property
    def stations_m(self) -> tuple[Floats, Floats]:
        """Transmitters and receivers of each pair, seen from the sensor; (p, 3) each."""
        receivers = np.array([self.receivers[m].place_enu_m for m, _ in self.pairs])
        transmitters = np.array(
            [self.receivers[m].signals.positions_enu_m[k] for m, k in self.pairs]
        )
        return receivers + transmitters, receivers

    @property
    def false_alarms_per_scan(self) -> float:
        """Mean number of sets of false alarms alone, next to none; ghosts come on top."""
        rate = self.receivers[0].signals.pfa * max(max(r.alarm_cells) for r in self.receivers)
        return float(min(rate, 1.0) ** self.fewest_pairs)

    def observe_scan(
        self, targets: Targets, sector: Sector, rng: np.random.Generator
    ) -> tuple[Looks, Plots]:
        """Looks by each pair at each target, and plots of sets of detections that fit."""
        geometry = azimuth_deg, elevation_deg, range_m = enu_to_aer(targets.position_enu_m)
        rows = np.flatnonzero(self.in_cover(range_m, azimuth_deg, elevation_deg))
        place_m = targets.true_position_enu_m[rows]
        snrs, pds = self.odds(targets, rows)
        hit = rng.random(snrs.shape) < pds
        n = len(self.pairs)
        looks = targets.looks(
            np.repeat(rows, n),
            geometry,
            snr=snrs.ravel(),
            pd=pds.ravel(),
            detected=hit.ravel(),
            channel=np.tile(np.arange(n), len(rows)),
        )
        whose = targets.drone[rows], self.orders(targets, rows)
        found = self._detected(place_m, whose, (snrs, hit), sector, rng)
        joined = self._finder.joined(found)
        if joined is None:
            return looks, NO_PLOTS
        return looks, self._with_truth(self._plots(joined, sector.end_ns), targets)

    @cached_property
    def _finder(self) -> SetFinder:
        transmitters_m, receivers_m = self.stations_m
        return SetFinder(
            transmitters_m=transmitters_m,
            receivers_m=receivers_m,
            height_m=self.expected_height_m,
            sigma_height_m=self.sigma_height_m,
            fewest_pairs=self.fewest_pairs,
            covers=self._covers,
        )

    def _covers(self, place_m: Floats) -> Bools:
        azimuth_deg, elevation_deg, range_m = enu_to_aer(place_m)
        return self.in_cover(range_m, azimuth_deg, elevation_deg)

    def odds(self, targets: Targets, rows: Ints | slice = EVERY_ROW) -> tuple[Floats, Floats]:
        """Mean ratios and Pd of those rows of targets by pair; (n, p) each."""
        snrs = np.concatenate([each.snrs(targets, rows) for each in self.stations], axis=1)
        order = self.orders(targets, rows)
        if order is not None:
            order = np.broadcast_to(order[:, None], snrs.shape)
        return snrs, self._cfar.pd(snrs[..., None], order) * self.receivers[0].signals.pd_factor

    @staticmethod
    def orders(targets: Targets, rows: Ints | slice = EVERY_ROW) -> Floats | None:
        """Orders by which those rows of targets fluctuate, (n,); None if none states anything."""
        echoes = targets.signatures.echoes
        return None if echoes is None else echoes.orders(targets.drone[rows], 1.0, 1)

    @property
    def _cfar(self) -> FluctuatingCfar:
        """The detector of each pair: receivers are alike."""
        signals = self.receivers[0].signals
        return FluctuatingCfar(signals.pfa, 1, signals.n_reference)

    def _detected(
        self,
        place_m: Floats,
        whose: tuple[Ints, Floats | None],
        outcomes: tuple[Floats, Bools],
        sector: Sector,
        rng: np.random.Generator,
    ) -> list[Detections]:
        """Detections of each pair, false alarms among them; those of a pair at once."""
        found, (snrs, hit), (drone, order) = [], outcomes, whose
        sums_m = range_sums_m(place_m, *self.stations_m)
        baselines_m = np.linalg.norm(self.stations_m[0] - self.stations_m[1], axis=-1)
        for p, (m, k) in enumerate(self.pairs):
            each = self.receivers[m]
            signals = each.signals
            mine = np.flatnonzero(hit[:, p])
            azimuth_deg, elevation_deg, _ = enu_to_aer(place_m[mine] - np.array(each.place_enu_m))
            alarms_deg = draw_azimuths(
                each.alarm_cells[k], signals.pfa, signals.azimuth_cover, sector, rng
            )
            a = len(alarms_deg)
            low_deg, high_deg = signals.elevation_min_deg, signals.elevation_max_deg
            true_m = np.append(
                sums_m[mine, p], baselines_m[p] + rng.uniform(0.0, signals.range_max_m, a)
            )
            azimuth_deg = np.append(azimuth_deg, alarms_deg)
            elevation_deg = np.append(elevation_deg, rng.uniform(low_deg, high_deg, a))
            mean = np.append(snrs[mine, p], np.zeros(a))
            orders = None if order is None else np.append(order[mine], np.ones(a))
            snr, _ = self._cfar.draw_detected(mean[:, None], orders, rng)
            sigmas = self._sigmas(each, k, snr)
            errors = rng.standard_normal((3, len(snr))) * signals.error_factor * sigmas
            found.append(
                Detections(
                    measured=(np.array([true_m, azimuth_deg, elevation_deg]) + errors).T,
                    sigmas=sigmas.T,
                    snr=snr,
                    drone=np.append(drone[mine], np.full(a, FALSE_ALARM)),
                )
            )
        return found

    @staticmethod
    def _sigmas(receiver: Receiver, k: int, snr: Floats) -> Floats:
        """Standard deviations of sum, azimuth and elevation, NaN where not measured; (3, n)."""
        signals = receiver.signals
        width_m, floor_m = (cells[k] for cells in receiver.cells_m)
        sigma_m, of_angle = accuracy.sigma_range_m(snr, width_m, floor_m), accuracy.sigma_angle_deg
        azimuth_deg = of_angle(snr, signals.azimuth_beamwidth_deg, signals.azimuth_floor_deg)
        elevation_deg = np.full(len(snr), np.nan)
        if isinstance(signals, MimoRadar) and signals.measures_elevation:
            width_deg, floor_deg = signals.elevation_beamwidth_deg, signals.elevation_floor_deg
            elevation_deg = of_angle(snr, width_deg, floor_deg)
        return np.array([sigma_m, azimuth_deg, elevation_deg])

    def _plots(self, joined: JoinedSets, end_ns: int) -> Plots:
        """Plots in space, with errors along range and directions to first order."""
        place_m, covariance_m2 = joined.fit.place_m, joined.fit.covariance_m2
        azimuth_deg, elevation_deg, range_m = enu_to_aer(place_m)
        sigma_m, azimuth_sigma_deg, elevation_sigma_deg = _polar_sigmas(place_m, covariance_m2)
        return Plots.of(
            t_utc_ns=np.full(len(range_m), end_ns, np.int64),
            range_m=range_m,
            azimuth_deg=azimuth_deg,
            elevation_deg=elevation_deg,
            snr=joined.snr,
            sigma_range_m=sigma_m,
            sigma_azimuth_deg=azimuth_sigma_deg,
            sigma_elevation_deg=elevation_sigma_deg,
            covariance_east_m2=covariance_m2[:, 0, 0],
            covariance_north_m2=covariance_m2[:, 1, 1],
            covariance_east_north_m2=covariance_m2[:, 0, 1],
            drone=joined.drone,
        ).rows(self._covers(place_m))

    def _with_truth(self, plots: Plots, targets: Targets) -> Plots:
        """Plots with where their drones truly are."""
        if not len(plots):
            return plots
        order = np.argsort(targets.drone)
        at = np.searchsorted(targets.drone[order], plots.drone).clip(max=max(len(order) - 1, 0))
        there_m = targets.true_position_enu_m[order]
        true = enu_to_aer(there_m[at] if len(order) else np.full((len(plots), 3), np.nan))
        ghost = plots.drone == FALSE_ALARM
        names = ("true_azimuth_deg", "true_elevation_deg", "true_range_m")
        columns = {n: np.where(ghost, np.nan, v) for n, v in zip(names, true, strict=True)}
        return plots.but(**columns)

    def predict(self, targets: Targets) -> Prediction:
        """Probability that enough pairs detect; errors by all, each weighed as it detects."""
        place_m, order = targets.true_position_enu_m, self.orders(targets)
        snrs, pds = self.odds(targets)
        found = []
        for p, (m, k) in enumerate(self.pairs):
            signals = self.receivers[m].signals
            inverse = self._cfar.inverse_detected(snrs[:, p, None], order)
            with np.errstate(divide="ignore"):
                weight = np.sqrt(1 / np.maximum(pds[:, p], 1e-12)) * signals.error_factor
            found.append((self._sigmas(self.receivers[m], k, 1 / inverse) * weight).T)
        sigmas = np.stack(found, axis=1)
        measured = np.zeros_like(sigmas)
        measured[..., 2] = 0 * sigmas[..., 2]  # NaN where elevations are not measured
        seen = Sightings(
            transmitters_m=self.stations_m[0],
            receivers_m=self.stations_m[1],
            measured=measured,
            sigmas=sigmas,
            height_m=self.expected_height_m,
            sigma_height_m=self.sigma_height_m,
        )
        jacobian, _ = linearised(place_m, seen)
        errors = _polar_sigmas(place_m, covariance(jacobian))
        return Prediction(
            snr=snrs.max(axis=1),
            # Enough pairs detect, and the right set passes.
            pd=at_least(pds, self.fewest_pairs) * (1 - OUTSIDE),
            sigma_range_m=errors[0],
            sigma_azimuth_deg=errors[1],
            sigma_elevation_deg=errors[2],
        )


@nan_without_warnings
def _polar_sigmas(place_m: Floats, covariance_m2: Floats) -> tuple[Floats, Floats, Floats]:
    """Standard deviations of range, azimuth and elevation, to first order; (n,) each."""
    range_m = distance_m(place_m)
    ground_m = np.hypot(place_m[:, 0], place_m[:, 1])
    along = place_m / range_m[:, None]
    right = np.stack([place_m[:, 1], -place_m[:, 0], np.zeros(len(place_m))], 1) / ground_m[:, None]
    above = np.cross(right, along)
    found = [
        np.sqrt(np.einsum("ni,nij,nj->n", axis, covariance_m2, axis))
        for axis in (along, right, above)
    ]
    return (
        np.asarray(found[0]),
        np.asarray(np.degrees(found[1] / ground_m)),
        np.asarray(np.degrees(found[2] / range_m)),
    )

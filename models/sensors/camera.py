"""Cameras: fixed or turned to somewhere, and panoramic ones that turn.

By the pixels on a target it is detected, recognised or identified (Johnson's criteria); plots are
directions, and classes as far as the picture tells them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from plotfeed.models import accuracy, optics
from plotfeed.models.chance import of_rows
from plotfeed.models.frames import enu_to_aer, wrap_180
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.sensors.sensor_model import (
    NO_PLOTS,
    CellSensor,
    Prediction,
    Targets,
    sensor_property,
)
from plotfeed.models.state import Bools, Floats, Ints, Looks, Plots, Texts

UNRECOGNISED = "object"  # The class of what is detected and no more


@dataclass(frozen=True, kw_only=True)
class LostContrast:
    """Contrast of targets beside their background, and of what the camera needs at least.

    `visibility_m` is the meteorological optical range; infinite, the air takes nothing.
    """

    inherent: float
    threshold: float
    at_nyquist: float
    visibility_m: float

    def resolved_share(self, range_m: Floats) -> Floats:
        """Share of the finest detail that is left at those ranges; (n,)."""
        left = self.inherent * optics.transmission(range_m, self.visibility_m)
        return optics.resolved_share(left, self.threshold, self.at_nyquist)


@dataclass(frozen=True, kw_only=True)
class HotSpot:
    """Heat of a target that need not be resolved, over the noise of a pixel, kelvin."""

    warmer_k: float
    noise_k: float
    visibility_m: float

    def ratio(self, filled: Floats, range_m: Floats) -> Floats:
        """Signal-to-noise ratios of targets that fill such shares of a pixel, up to 1; (n,)."""
        left_k = self.warmer_k * optics.transmission(range_m, self.visibility_m)
        return np.asarray(left_k * np.minimum(filled, 1.0) / self.noise_k)


@dataclass(frozen=True, slots=True)
class Lens:
    """Fields of view and the angle of a pixel, each a number, or (n,) of as many looks."""

    horizontal_deg: Any
    vertical_deg: Any
    pixel_angle_rad: Any

    def rows(self, which: NDArray[Any]) -> Lens:
        """Lens of some of the looks."""
        return Lens(
            *(
                value[which] if isinstance(value, np.ndarray) and value.ndim else value
                for value in (self.horizontal_deg, self.vertical_deg, self.pixel_angle_rad)
            )
        )


@dataclass(frozen=True, kw_only=True)
class Camera(CellSensor):
    """What the equations need. Cycles are those with which each task is done every other time.

    `panoramic` pictures have equal angles a pixel, others are flat. `pfa` is that of a pixel.
    `classes` are those that it tells apart; its claims are right with `class_probability`. One that
    is `steered` is turned by its mount, from the direction that it has here, and by it zoomed; of
    targets that come without, all are in its picture.
    """

    pan_deg: float
    tilt_deg: float
    horizontal_fov_deg: float
    vertical_fov_deg: float
    pixels_across: float
    pixels_down: float
    panoramic: bool
    steered: bool
    detect_cycles: float
    recognise_cycles: float
    identify_cycles: float
    pointing_error_deg: float
    pixel_error: float
    classes: tuple[str, ...]
    class_probability: float
    contrast: LostContrast | None
    hot_spot: HotSpot | None

    alike: ClassVar[frozenset[str]] = frozenset({"panoramic", "steered", "classes", "surroundings"})

    @cached_property
    def resolution_cells(self) -> float:
        """Pixels of a picture."""
        return self.pixels_across * self.pixels_down

    @sensor_property
    def pixel_angle_rad(self) -> float:
        """Angle that a pixel sees, in the middle of a flat picture."""
        if self.panoramic:
            return float(np.radians(self.horizontal_fov_deg) / self.pixels_across)
        return float(optics.pixel_angle_rad(self.horizontal_fov_deg, self.pixels_across))

    @property
    def lens(self) -> Lens:
        """Lens as the camera's own keys have it."""
        return Lens(self.horizontal_fov_deg, self.vertical_fov_deg, self.pixel_angle_rad)

    def zoomed(self, field_deg: Floats) -> Lens:
        """The lens at other horizontal fields of view; (n,)."""
        larger = self._enlarged(field_deg)
        half_deg = np.radians(self.vertical_fov_deg) / 2
        vertical_deg = 2 * np.degrees(np.arctan(np.tan(half_deg) * larger))
        return Lens(field_deg, vertical_deg, self.pixel_angle_rad * larger)

    def _enlarged(self, field_deg: Floats) -> Floats:
        """Ratio by which a flat picture of that field of view is larger than its own; (n,)."""
        own_deg = np.radians(self.horizontal_fov_deg)
        return np.asarray(np.tan(np.radians(field_deg) / 2) / np.tan(own_deg / 2))

    def in_view(self, position_enu_m: Floats, lens: Lens) -> Bools:
        """Whether places (n, 3) are in the picture."""
        if not self.panoramic:
            fields_deg = lens.horizontal_deg, lens.vertical_deg
            return optics.in_picture(position_enu_m, self.pan_deg, self.tilt_deg, *fields_deg)
        azimuth_deg, elevation_deg, _ = enu_to_aer(position_enu_m)
        above_deg = np.abs(elevation_deg - self.tilt_deg)
        return self.azimuth_cover.holds(azimuth_deg) & (above_deg <= self.vertical_fov_deg / 2)

    @nan_without_warnings
    def task_probabilities(self, size_m: Floats, range_m: Floats, lens: Lens) -> Floats:
        """Probabilities of detection, recognition and identification, rows; (3, n).

        None is above the one before it. 0 for targets of unknown size.
        """
        cycles = optics.cycles_on_target(size_m, range_m, lens.pixel_angle_rad)
        if self.contrast is not None:
            cycles *= self.contrast.resolved_share(range_m)
        tasks = (self.detect_cycles, self.recognise_cycles, self.identify_cycles)
        found = np.stack([optics.task_probability(cycles, needed) for needed in tasks])
        if self.hot_spot is not None:
            filled = (size_m / (range_m * lens.pixel_angle_rad)) ** 2
            ratio = self.hot_spot.ratio(filled, range_m)
            found[0] = optics.hot_spot_pd(ratio, self.pfa)
        return np.minimum.accumulate(np.nan_to_num(found), axis=0)

    def sigma_azimuth_deg(self, elevation_deg: Floats, lens: Lens) -> Floats:
        """Standard deviation of azimuths at those elevations: of the mount, and of the picture."""
        of_pixels_deg = np.degrees(self.pixel_error * lens.pixel_angle_rad)
        level = np.cos(np.radians(elevation_deg))
        return accuracy.with_floor(of_pixels_deg / level, self.pointing_error_deg)

    def sigma_elevation_deg(self, n: int, lens: Lens) -> Floats:
        """Standard deviation of elevations, the same everywhere; (n,)."""
        of_pixels_deg = np.degrees(self.pixel_error * lens.pixel_angle_rad)
        return np.zeros(n) + accuracy.with_floor(of_pixels_deg, self.pointing_error_deg)

    def observe(self, targets: Targets, rng: np.random.Generator) -> tuple[Looks, Plots]:
        """Look once at each target in the picture whose size is known."""
        geometry = _, _, range_m = enu_to_aer(targets.position_enu_m)
        size_m = targets.size_m()
        near = (range_m > 0) & (range_m <= self.range_max_m) & ~np.isnan(size_m)
        near &= self.has_sight_of(targets.true_position_enu_m)
        lens = self.lens if targets.field_deg is None else self.zoomed(targets.field_deg)
        if not self.steered or targets.field_deg is not None:
            near &= self.in_view(targets.position_enu_m, lens)
        seen = np.flatnonzero(near)
        of_seen, rng, lens = self.rows(seen), of_rows(rng, seen), lens.rows(seen)
        probabilities = of_seen.task_probabilities(size_m[seen], range_m[seen], lens)
        probabilities = probabilities * of_seen.pd_factor
        drawn = rng.random((len(seen),))
        detected = drawn < probabilities[0]
        unknown = np.full(len(seen), np.nan)
        looks = targets.looks(seen, geometry, snr=unknown, pd=probabilities[0], detected=detected)
        if not detected.any():
            return looks, NO_PLOTS
        hits, rng, rows = looks.rows(detected), of_rows(rng, detected), seen[detected]
        of_hits, lens = of_seen.rows(detected), lens.rows(detected)
        errors = rng.standard_normal((2, len(hits))) * of_hits.error_factor
        sigma_azimuth_deg = of_hits.sigma_azimuth_deg(hits.elevation_deg, lens)
        sigma_elevation_deg = of_hits.sigma_elevation_deg(len(hits), lens)
        azimuth_deg, elevation_deg = accuracy.fold_over_zenith(
            targets.read_azimuth_deg(hits.azimuth_deg, hits.t_utc_ns)
            + errors[0] * sigma_azimuth_deg,
            hits.elevation_deg + errors[1] * sigma_elevation_deg,
        )
        tasks_done = (drawn[detected] < probabilities[1:, detected]).sum(axis=0)
        claims = of_hits._claims(targets, hits.drone, tasks_done, rng)
        return looks, Plots.of(
            t_utc_ns=hits.t_utc_ns,
            azimuth_deg=azimuth_deg,
            elevation_deg=elevation_deg,
            sigma_azimuth_deg=sigma_azimuth_deg,
            sigma_elevation_deg=sigma_elevation_deg,
            **claims,
            **hits.whose(),
            **targets.true_geometry(hits, rows),
        )

    def _claims(
        self, targets: Targets, drone: Ints, tasks_done: Ints, rng: np.random.Generator
    ) -> dict[str, NDArray[Any]]:
        """What plots are called, and how probably that is right.

        Detected alone, each is an object; recognised, of its class, or wrongly of another that the
        camera knows; identified, of its model, if it has one.
        """
        drawn, right = rng.random((len(drone),)), self.class_probability
        known = np.array([*self.classes, UNRECOGNISED], np.object_)
        of_drone = targets.signatures.target_class[drone]
        is_class = of_drone[:, None] == known[None, :-1]
        knows, true_class = is_class.any(axis=1), is_class.argmax(axis=1)
        others = max(len(self.classes) - 1, 1)
        share = (drawn - right) / np.maximum(1.0 - right, 1e-300)
        step = np.where(share < 0, 0, 1 + np.minimum((share * others).astype(np.int64), others - 1))
        claimed = (true_class + step) % max(len(self.classes), 2)
        recognised = (tasks_done >= 1) & knows
        kind: Texts = known[np.where(recognised, claimed, -1)]
        model = targets.signatures.model[drone]
        named = recognised & (tasks_done == 2) & (step == 0) & (model != "")
        told = kind != UNRECOGNISED
        return {
            "kind": np.where(named, model, kind),
            "kind_probability": np.where(told, right, np.nan),
        }

    def false_plots(self, t_utc_ns: Ints, azimuth_deg: Floats, rng: np.random.Generator) -> Plots:
        """Anywhere in the picture alike, and recognised as nothing."""
        n = len(azimuth_deg)
        height = rng.uniform(-0.5, 0.5, n)
        if self.panoramic:
            elevation_deg = self.tilt_deg + height * self.vertical_fov_deg
        else:
            width = wrap_180(azimuth_deg - self.pan_deg) / self.azimuth_cover.span_deg
            right, above = (
                2 * share * np.tan(np.radians(field_deg) / 2)
                for share, field_deg in (
                    (width, self.horizontal_fov_deg),
                    (height, self.vertical_fov_deg),
                )
            )
            sight = optics.directions_enu(right, above, self.pan_deg, self.tilt_deg)
            azimuth_deg, elevation_deg, _ = enu_to_aer(sight)
        azimuth_deg, elevation_deg = accuracy.fold_over_zenith(azimuth_deg, elevation_deg)
        return Plots.of(
            t_utc_ns=t_utc_ns,
            azimuth_deg=azimuth_deg,
            elevation_deg=elevation_deg,
            sigma_azimuth_deg=self.sigma_azimuth_deg(elevation_deg, self.lens),
            sigma_elevation_deg=self.sigma_elevation_deg(n, self.lens),
            kind=np.full(n, UNRECOGNISED, np.object_),
            kind_probability=np.full(n, np.nan),
        )

    def zoomed_alarms(self, alarms: Plots, field_deg: float) -> Plots:
        """False alarms of a flat picture by its own axes, with another field of view."""
        lens = self.zoomed(np.full(len(alarms), field_deg))
        azimuth, elevation = np.radians(alarms.azimuth_deg), np.radians(alarms.elevation_deg)
        larger = self._enlarged(np.full(len(alarms), field_deg))
        right, above = np.tan(azimuth) * larger, np.tan(elevation) / np.cos(azimuth) * larger
        azimuth_deg, elevation_deg, _ = enu_to_aer(optics.directions_enu(right, above, 0.0, 0.0))
        return alarms.but(
            azimuth_deg=azimuth_deg,
            elevation_deg=elevation_deg,
            sigma_azimuth_deg=self.sigma_azimuth_deg(elevation_deg, lens),
            sigma_elevation_deg=self.sigma_elevation_deg(len(alarms), lens),
        )

    def stated_sigmas(self, snr: float) -> dict[str, float]:  # noqa: ARG002
        """Errors on the horizontal, where they depend on no ratio."""
        return {
            "sigma_azimuth_deg": float(self.sigma_azimuth_deg(np.zeros(1), self.lens)[0]),
            "sigma_elevation_deg": float(self.sigma_elevation_deg(1, self.lens)[0]),
        }

    def predict(self, targets: Targets) -> Prediction:
        """Closed forms, for targets that are in the picture."""
        _, elevation_deg, range_m = enu_to_aer(targets.position_enu_m)
        unknown = np.full(len(range_m), np.nan)
        return Prediction(
            snr=unknown,
            pd=self.task_probabilities(targets.size_m(), range_m, self.lens)[0]
            * self.has_sight_of(targets.true_position_enu_m)
            * self.pd_factor,
            sigma_range_m=unknown,
            sigma_azimuth_deg=self.sigma_azimuth_deg(elevation_deg, self.lens) * self.error_factor,
            sigma_elevation_deg=self.sigma_elevation_deg(len(range_m), self.lens)
            * self.error_factor,
        )

"""The technology-agnostic sensor from which the paper starts: a range gate and Gaussian noise.

Every drone within range is reported at every scan, and nothing else is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from plotfeed.models import detection
from plotfeed.models.beam import Sector
from plotfeed.models.chance import of_rows
from plotfeed.models.frames import enu_to_aer, wrap_360
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.sensors.sensor_model import NO_PLOTS, Prediction, SensorModel, Targets
from plotfeed.models.state import Floats, Ints, Looks, Plots


@dataclass(frozen=True, kw_only=True)
class RangeGate(SensorModel):
    """A gate of radius `range_max_m`, and the noise on east, north and up alike."""

    sigma_m: float

    alike: ClassVar[frozenset[str]] = frozenset({"surroundings"})

    @property
    def false_alarms_per_scan(self) -> float:
        """Always 0."""
        return 0.0

    def observe(self, targets: Targets, rng: np.random.Generator) -> tuple[Looks, Plots]:
        """Every target within the gate, its position with noise added."""
        geometry = _, _, range_m = enu_to_aer(targets.position_enu_m)
        within = (range_m > 0) & (range_m <= self.range_max_m)
        seen = np.flatnonzero(within & self.has_sight_of(targets.true_position_enu_m))
        looks = targets.looks(
            seen,
            geometry,
            snr=np.full(len(seen), np.nan),
            pd=np.ones(len(seen)),
            detected=np.ones(len(seen), np.bool_),
        )
        hits = looks
        if self.degradation is not None:
            pd = looks.pd * self.rows(seen).pd_factor
            detected = detection.draw_hits(pd, of_rows(rng, seen))
            looks = looks.but(pd=pd, detected=detected)
            hits, seen = looks.rows(detected), seen[detected]
            if not len(hits):
                return looks, NO_PLOTS
        return looks, self.rows(seen)._measure(
            hits, targets, seen, of_rows(rng, np.repeat(seen, 3))
        )

    def _measure(
        self, hits: Looks, targets: Targets, rows: Ints, rng: np.random.Generator
    ) -> Plots:
        """Places with noise added, of those rows of the targets."""
        # Three numbers a target, one after the other.
        normal = rng.standard_normal((3 * len(rows),)).reshape(-1, 3)
        noise_m = (normal.T * self.sigma_m * self.error_factor).T
        azimuth_deg, elevation_deg, noisy_m = enu_to_aer(targets.position_enu_m[rows] + noise_m)
        sigmas = self._sigmas(elevation_deg, noisy_m)
        range_m = noisy_m
        if targets.readings is not None:  # errors of reading do not scale the noise
            read_m = targets.read_range_m(hits.range_m, hits.t_utc_ns)
            range_m = read_m + (noisy_m - hits.range_m)
        azimuth_deg = wrap_360(targets.read_azimuth_deg(azimuth_deg, hits.t_utc_ns))
        return Plots.of(
            t_utc_ns=hits.t_utc_ns,
            range_m=range_m,
            azimuth_deg=azimuth_deg,
            elevation_deg=elevation_deg,
            sigma_range_m=sigmas[0],
            sigma_azimuth_deg=sigmas[1],
            sigma_elevation_deg=sigmas[2],
            **hits.whose(),
            **targets.true_geometry(hits, rows),
        )

    @nan_without_warnings
    def mean_place(
        self, azimuth_deg: Floats, elevation_deg: Floats, range_m: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Means to second order in noise over range: that across the line of sight adds to it."""
        share = self.sigma_m * self.error_factor / range_m
        lower_deg = np.degrees(share**2 * np.tan(np.radians(elevation_deg)) / 2)
        return azimuth_deg, elevation_deg - lower_deg, range_m * (1 + share**2)

    def sigmas_at(self, snr: Floats, channel: Ints) -> Mapping[str, Floats]:  # noqa: ARG002
        """Standard deviation of range, which is the same at any ratio."""
        return {"sigma_range_m": np.full(len(snr), self.sigma_m)}

    def draw_false_alarms(self, _sector: Sector, _rng: np.random.Generator) -> Plots:
        """No plots: it has no false alarms."""
        return NO_PLOTS

    def stated_sigmas(self, snr: float) -> dict[str, float]:  # noqa: ARG002
        """Errors on the horizontal at half the range, where the noise is the same as everywhere."""
        sigmas = self._sigmas(np.zeros(1), np.array([self.range_max_m / 2]))
        names = ("sigma_range_m", "sigma_azimuth_deg", "sigma_elevation_deg")
        return {name: float(sigma[0]) for name, sigma in zip(names, sigmas, strict=True)}

    def predict(self, targets: Targets) -> Prediction:
        """Certain within the gate, with the same noise everywhere."""
        _, elevation_deg, range_m = enu_to_aer(targets.position_enu_m)
        sigmas = [s * self.error_factor for s in self._sigmas(elevation_deg, range_m)]
        within = (range_m > 0) & (range_m <= self.range_max_m)
        seen = within & self.has_sight_of(targets.true_position_enu_m)
        return Prediction(
            snr=np.full(len(range_m), np.nan),
            pd=np.where(seen, 1.0, 0.0) * self.pd_factor,
            sigma_range_m=sigmas[0],
            sigma_azimuth_deg=sigmas[1],
            sigma_elevation_deg=sigmas[2],
        )

    @nan_without_warnings
    def _sigmas(self, elevation_deg: Floats, range_m: Floats) -> tuple[Floats, Floats, Floats]:
        """Sigmas of range, azimuth and elevation, to first order in noise over range.

        So near that noise over range is beyond all numbers there is no direction: NaN.
        """
        across_deg = np.degrees(self.sigma_m / range_m)
        across_deg = np.where(np.isinf(across_deg), np.nan, across_deg)
        along_m = np.zeros(len(range_m)) + self.sigma_m
        return along_m, across_deg / np.cos(np.radians(elevation_deg)), across_deg

"""The probability that a plot is of a target, by its signal-to-noise ratio and a stated prior.

How often targets of the prior and false alarms show each ratio is found by the sensor's own draws:
what is made of them holds for any sensor, whatever its equations are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from plotfeed.models.frames import enu_to_aer
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.sensors.sensor_model import SensorModel, Targets
from plotfeed.models.state import Floats, Signature

DRAWS = 8192  # Of targets, and of false alarms
CELL_DB = 0.5
FEW = 20  # False alarms in the first cell, and in the last but one: beyond all drawn is the last
HIGHEST_M = 120.0  # Of drones in the European open category (Regulation 2019/947, UAS.OPEN.010)
HALF_A_DRAW = 0.5  # Spread over all cells, for what was never drawn is not impossible


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetPrior:
    """Targets before anything is measured: so many on average within a sensor's directions.

    Each is anywhere within the range alike, over the ground, and up to 120 m above the sensor.
    """

    mean_number: float
    signature: Signature

    def places_enu_m(
        self,
        n: int,
        range_max_m: float,
        azimuths_deg: tuple[float, float],
        rng: np.random.Generator,
    ) -> Floats:
        """Places of n of them; (n, 3)."""
        ground_m = range_max_m * np.sqrt(rng.random(n))
        azimuth = np.radians(rng.uniform(*azimuths_deg, n))
        east_m, north_m = ground_m * np.sin(azimuth), ground_m * np.cos(azimuth)
        return np.stack([east_m, north_m, rng.uniform(0.0, HIGHEST_M, n)], axis=-1)


@dataclass(frozen=True, slots=True)
class Confidence:
    """Logarithms of the odds that plots are of targets, (n+1,), in cells between ratios, (n,).

    Of a sensor that tells no ratio there is one cell.
    """

    edges_db: Floats
    log_odds: Floats

    @nan_without_warnings
    def of(self, snr: Floats) -> Floats:
        """Probabilities that plots of those ratios, linear, are of targets; (n,)."""
        log_odds = self.log_odds[np.searchsorted(self.edges_db, 10 * np.log10(snr))]
        return np.asarray(1.0 / (1.0 + np.exp(-log_odds)))


def confidence_of(
    model: SensorModel,
    prior: TargetPrior,
    azimuths_deg: tuple[float, float],
    rng: np.random.Generator,
) -> Confidence:
    """The confidence of a sensor of one model that covers those azimuths.

    It does not depend on the draws by more than their number, `DRAWS`, leaves open.
    """
    if getattr(model, "merging", None) is not None:
        alone: dict[str, Any] = {"merging": None}  # targets of the prior are not there together
        model = replace(model, **alone)
    places_enu_m = prior.places_enu_m(DRAWS, model.range_max_m, azimuths_deg, rng)
    places_enu_m = places_enu_m[enu_to_aer(places_enu_m)[2] <= model.range_max_m]
    _, plots = model.observe(Targets.of_one(prior.signature, places_enu_m), rng)
    targets_a_plot = prior.mean_number / DRAWS
    false_snr = model.draw_false_snr(DRAWS, rng)
    alarms_a_plot = model.false_alarms_per_scan / DRAWS
    if not alarms_a_plot:
        return Confidence(np.zeros(0), np.full(1, np.inf))
    if np.isnan(false_snr).any() or np.isnan(plots.snr).any():
        odds = (len(plots) + HALF_A_DRAW) * targets_a_plot / model.false_alarms_per_scan
        return Confidence(np.zeros(0), np.log([odds]))
    true_db, false_db = (10 * np.log10(snr) for snr in (plots.snr, false_snr))
    # Borders of cells by the ratios of false alarms, rising: the last is the highest one.
    sorted_db = np.sort(false_db)
    sparse_db = sorted_db[-FEW]
    ends_db = sparse_db, max(sorted_db[-1], sparse_db + 1e-9)
    edges_db = np.concatenate([np.arange(sorted_db[FEW], sparse_db, CELL_DB), ends_db])
    of_targets, of_alarms = (
        np.bincount(np.searchsorted(edges_db, found_db), minlength=len(edges_db) + 1)
        + HALF_A_DRAW / (len(edges_db) + 1)
        for found_db in (true_db, false_db)
    )
    of_alarms[-1] += 1.0  # beyond the highest of n draws is 1/(n + 1) of all, on average
    log_odds = np.log(of_targets * targets_a_plot) - np.log(of_alarms * alarms_a_plot)
    return Confidence(edges_db, log_odds)

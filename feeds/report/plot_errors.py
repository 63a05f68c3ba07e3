"""Errors of plots against what is true of them, in units of the standard deviation they state."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from plotfeed.feeds.recording.recorded_session import (
    TRUE_COLUMNS,
    SectorKey,
    Truth,
    WaitingPlots,
    sector_plots,
)
from plotfeed.models.frames import wrap_180
from plotfeed.models.state import Floats
from plotfeed.replay.recorded import Recorded

QUANTITIES = {"range": "m", "azimuth": "deg", "elevation": "deg"}
"""What the ledger has the truth of, with the unit of each."""
AZIMUTH = 1
AT_ONCE = 1024
STEP = 0.25
FURTHEST = 6.0
"""In standard deviations; what is further counts with the last cells."""
EDGES = np.arange(-FURTHEST, FURTHEST + STEP, STEP)


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorFigures:
    """Errors of one quantity, over the plots of drones that were joined with their truth."""

    quantity: str
    unit: str
    plots: int
    mean: float
    """Measured less true."""
    rms: float
    stated: int
    """Plots that state a standard deviation; what follows is of these."""
    stated_rms: float
    """Root of the mean of the variances that they state."""
    normalised_mean: float
    """Of errors over their standard deviations; 0 is asked."""
    normalised_rms: float
    """1 is asked."""
    within_2: float
    """Share within two standard deviations; 0.954 is asked."""
    z_mean: float
    z_rms: float
    histogram: Sequence[int]
    """Normalised errors between the report's `normalised_edges`, what is beyond in the last."""


class ErrorsTally:
    """Errors of one sensor's plots."""

    def __init__(self) -> None:
        self.joined = 0
        """Plots with their truth, false alarms left out."""
        self._gathered: list[Floats] = []
        self._waiting = 0
        n = len(QUANTITIES)
        self._sums = np.zeros((n, 8))
        self._histograms = np.zeros((n, len(EDGES) - 1), np.int64)

    def add(self, measured: Floats, sigma: Floats, true: Floats) -> None:
        """Take some plots; (n, 3) each, NaN where there is nothing."""
        if not len(measured):
            return
        self.joined += len(measured)
        self._gathered.append(np.stack([measured, sigma, true]))
        self._waiting += len(measured)
        if self._waiting >= AT_ONCE:
            self.count()

    @np.errstate(all="ignore")  # whatever numbers others have recorded
    def count(self) -> None:
        """Count what has been gathered."""
        if not self._gathered:
            return
        measured, sigma, true = np.concatenate(self._gathered, axis=1)
        self._gathered.clear()
        self._waiting = 0
        error = measured - true
        error[:, AZIMUTH] = wrap_180(error[:, AZIMUTH])
        normalised = np.where((sigma > 0) & np.isfinite(sigma), error / sigma, np.nan)
        for i in range(len(QUANTITIES)):
            self._count(i, error[:, i], sigma[:, i], normalised[:, i])

    def _count(self, i: int, error: Floats, sigma: Floats, normalised: Floats) -> None:
        there, stated = np.isfinite(error), np.isfinite(normalised)
        error, sigma, normalised = error[there], sigma[stated], normalised[stated]
        self._sums[i] += (
            len(error),
            error.sum(),
            error @ error,
            len(sigma),
            sigma @ sigma,
            normalised.sum(),
            normalised @ normalised,
            (np.abs(normalised) <= 2).sum(),
        )
        cells = np.clip((normalised + FURTHEST) / STEP, 0, len(EDGES) - 2).astype(np.int64)
        self._histograms[i] += np.bincount(cells, minlength=len(EDGES) - 1)

    def figures(self) -> list[ErrorFigures]:
        """Figures of every quantity that was measured."""
        return [
            self._figures(i, name, unit)
            for i, (name, unit) in enumerate(QUANTITIES.items())
            if self._sums[i, 0]
        ]

    def _figures(self, i: int, name: str, unit: str) -> ErrorFigures:
        n, error, error2, stated, sigma2, normalised, normalised2, within = self._sums[i].tolist()

        def mean(total: float) -> float:
            return total / stated if stated else math.nan

        # Of independent standard normal numbers the sum has the variance n, that of squares 2n.
        enough = stated >= 20
        return ErrorFigures(
            quantity=name,
            unit=unit,
            plots=round(n),
            mean=error / n,
            rms=math.sqrt(error2 / n),
            stated=round(stated),
            stated_rms=math.sqrt(mean(sigma2)),
            normalised_mean=mean(normalised),
            normalised_rms=math.sqrt(mean(normalised2)),
            within_2=mean(within),
            z_mean=normalised / math.sqrt(stated) if enough else math.nan,
            z_rms=(normalised2 - stated) / math.sqrt(2 * stated) if enough else math.nan,
            histogram=self._histograms[i].tolist(),
        )


MAX_WAITING_TRUTHS = 200_000
"""Plots whose truth waits for what was measured; then the oldest are given up."""


class MeasuredBesideTruth:
    """Holds what has come of a sector until all of it is there; the ledger comes last as a rule."""

    def __init__(self) -> None:
        self._plots = WaitingPlots()
        self._truths: OrderedDict[SectorKey, tuple[Truth, ErrorsTally]] = OrderedDict()
        self._waiting = 0

    def add_message(self, message: Recorded, prefix: str, sensor: str) -> None:
        """Take the plots of a message; one that cannot be read or placed is passed over."""
        found = sector_plots(message, prefix, sensor)
        if found is not None:
            self._plots.add(found)
            self._meet(found.key)

    def add_truth(self, sector: SectorKey, truth: Truth, errors: ErrorsTally) -> None:
        """Take what is true of a sector's plots; their errors are counted where it says."""
        if not len(truth) or sector in self._truths:
            return
        self._truths[sector] = truth, errors
        self._waiting += len(truth)
        self._meet(sector)
        while self._waiting > MAX_WAITING_TRUTHS and self._truths:
            _, (given_up, _) = self._truths.popitem(last=False)
            self._waiting -= len(given_up)

    def _meet(self, sector: SectorKey) -> None:
        """Count errors if all are there; plots that contradict their truth are as good as lost."""
        if sector not in self._truths:
            return
        truth, errors = self._truths[sector]
        if self._plots.count(sector) < len(truth):
            return
        del self._truths[sector]
        self._waiting -= len(truth)
        plots = self._plots.take(sector, truth)
        if plots is not None:
            drones = plots.rows(truth.of_drone)
            values = np.stack([getattr(drones, name) for name in TRUE_COLUMNS], axis=1)
            sigmas = np.stack([getattr(drones, f"sigma_{name}") for name in TRUE_COLUMNS], axis=1)
            errors.add(values, sigmas, truth.values[truth.of_drone])

"""A sensor's detections, false alarms and errors of plots: as they were asked and as they came."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from plotfeed.feeds.recording.look_tally import LookTally
from plotfeed.feeds.recording.recorded_session import (
    TRUE_COLUMNS,
    RecordedSettings,
    SectorKey,
    Truth,
    WaitingPlots,
    sector_plots,
)
from plotfeed.feeds.report.spreads import share_interval, z_score
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.scan_keys import RotatingScan
from plotfeed.feeds.sensing.emulated_sensors import AHEAD_NS
from plotfeed.models.frames import wrap_180
from plotfeed.models.state import Floats
from plotfeed.proto.utc import NS
from plotfeed.replay.recorded import Recorded

CELL_M = 25.0
MAX_CELLS = 40_000
"""Up to 1000 km; what is further counts with the last."""
MAX_BINS = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class PdFigures:
    """Looks at some ranges, and how many of them detected."""

    from_m: float
    to_m: float
    looks: int
    asked: float
    """Mean of the looks' own probabilities."""
    delivered: float
    """Share detected, and its 95 % interval."""
    low: float
    high: float
    z: float


def pd_of_all(looks: LookTally) -> PdFigures | None:
    """Figures of all ranges; None without a look."""
    cells = looks.cells()
    at = np.flatnonzero(cells[0])
    return _pd_figures(cells, int(at[0]), int(at[-1]) + 1) if len(at) else None


def pd_by_range(looks: LookTally) -> list[PdFigures]:
    """Figures of at most `MAX_BINS` equal bins over the ranges looked at; none is empty."""
    cells = looks.cells()
    at = np.flatnonzero(cells[0])
    if not len(at):
        return []
    first, end = int(at[0]), int(at[-1]) + 1
    step = round(_round_up((end - first) * CELL_M / MAX_BINS) / CELL_M)
    edges = range(first // step * step, end + step, step)
    found = (_pd_figures(cells, low, high) for low, high in pairwise(edges))
    return [figures for figures in found if figures.looks]


def _pd_figures(cells: Floats, first: int, end: int) -> PdFigures:
    looks, pd, variance, detected = cells[:, first:end].sum(axis=1).tolist()
    low, high = share_interval(round(detected), round(looks))
    return PdFigures(
        from_m=first * CELL_M,
        to_m=end * CELL_M,
        looks=round(looks),
        asked=pd / looks if looks else math.nan,
        delivered=detected / looks if looks else math.nan,
        low=low,
        high=high,
        z=z_score(detected - pd, variance),
    )


def _round_up(width_m: float) -> float:
    """A width of 1, 2 or 5 times a power of ten, where cells fit into it, and at least a cell."""
    unit = 10.0 ** math.floor(math.log10(max(width_m, CELL_M)))
    for times in (1, 2, 5, 10, 20, 50):
        step = times * unit
        if step >= width_m and step % CELL_M == 0:
            return step
    return 10 * CELL_M * math.ceil(width_m / (10 * CELL_M))


@dataclass(slots=True)
class AskedAlarms:
    """False alarms that a sensor of a recorded scene was to have."""

    scene: Scene
    sensor: Sensor
    settings: RecordedSettings
    start_utc_ns: int
    _per_scan: dict[int, float] = field(default_factory=dict)

    @property
    def sectors(self) -> int:
        """Sectors of a scan."""
        return self.sensor.scan.sectors if isinstance(self.sensor.scan, RotatingScan) else 1

    def in_sector(self, scan: int, sector: int) -> float:
        """Mean number in a sector, as the sensor was when it was worked out; NaN if unknown."""
        period_ns = round(self.sensor.scan.period_s * NS)
        end_utc_ns = (scan * self.sectors + sector + 1) * period_ns // self.sectors
        worked_out_ns = end_utc_ns - min(AHEAD_NS, period_ns // self.sectors)
        then = self.settings.worked_out(self.sensor.id, worked_out_ns, self.start_utc_ns)
        if then is None:
            return math.nan
        if id(then) not in self._per_scan:
            mean = then.model(self.scene.scene.site).false_alarms_per_scan
            self._per_scan[id(then)] = mean
        return self._per_scan[id(then)] / self.sectors


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmFigures:
    """False alarms of one sensor; NaN where no scene says what was asked."""

    count: int
    scans: float = math.nan
    """That the ledger tells of, parts of them counted as such."""
    asked: float = math.nan
    """By the scene, in all of these scans."""
    asked_per_scan: float = math.nan
    delivered_per_scan: float = math.nan
    z: float = math.nan


@dataclass(slots=True)
class AlarmsTally:
    """False alarms in one sensor's ledger, and those that its scene asked for."""

    asked: AskedAlarms | None
    count: int = 0
    _sectors: int = 0
    _mean: float = 0.0

    def add(self, false_alarms: int, scan: int, sector: int) -> None:
        """Take a sector."""
        self.count += false_alarms
        self._sectors += 1
        if self.asked is not None:
            self._mean += self.asked.in_sector(scan, sector)

    def figures(self) -> AlarmFigures:
        """Figures of all sectors taken."""
        if self.asked is None:
            return AlarmFigures(count=self.count)
        scans = self._sectors / self.asked.sectors
        return AlarmFigures(
            count=self.count,
            scans=scans,
            asked=self._mean,
            asked_per_scan=self._mean / scans if scans else math.nan,
            delivered_per_scan=self.count / scans if scans else math.nan,
            z=z_score(self.count - self._mean, self._mean),  # binomial over very many cells
        )


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

"""Detections and false alarms of a sensor: as its odds and its scene had them, and as they came."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from plotfeed.feeds.recording.look_tally import LookTally
from plotfeed.feeds.recording.recorded_session import RecordedSettings
from plotfeed.feeds.report.spreads import share_interval, z_score
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.scan_keys import RotatingScan
from plotfeed.feeds.sensing.emulated_sensor import AHEAD_NS
from plotfeed.models.state import Floats
from plotfeed.proto.utc import NS

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

"""A sensor's scans, detections and false alarms: as they were asked and as they came."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from plotfeed.feeds.recording.look_tally import LookTally
from plotfeed.feeds.report.asked_sensors import AskedSensor
from plotfeed.feeds.report.spreads import share_interval, z_score
from plotfeed.models.state import Floats
from plotfeed.models.tail_chances import p_of_poisson, p_of_trials

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
    p: float
    """Probability of such a share, or one further off, by chance."""


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
    count, sum_pd, *_ = of_cells = cells[:, first:end]
    looks, pd, variance, detected = of_cells.sum(axis=1).tolist()
    mean_pd = np.divide(sum_pd, count, out=np.zeros_like(count), where=count > 0)
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
        p=p_of_trials(count, mean_pd, round(detected)) if looks else math.nan,
    )


def _round_up(width_m: float) -> float:
    """A width of 1, 2 or 5 times a power of ten, where cells fit into it, and at least a cell."""
    unit = 10.0 ** math.floor(math.log10(max(width_m, CELL_M)))
    for times in (1, 2, 5, 10, 20, 50):
        step = times * unit
        if step >= width_m and step % CELL_M == 0:
            return step
    return 10 * CELL_M * math.ceil(width_m / (10 * CELL_M))


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
    p: float = math.nan
    """Probability of such a number, or one further off, by chance."""


@dataclass(slots=True)
class AlarmsTally:
    """False alarms in one sensor's ledger, and those that its scene asked for."""

    sectors: int
    """Of a scan; 0 if nothing is known of what was asked."""
    count: int = 0
    _told: int = 0
    _mean: float = 0.0

    def add(self, false_alarms: int, asked: AskedSensor | None) -> None:
        """Take a sector."""
        self.count += false_alarms
        self._told += 1
        if self.sectors:
            mean = math.nan if asked is None else asked.false_alarms_per_scan
            self._mean += mean / self.sectors

    def figures(self) -> AlarmFigures:
        """Figures of all sectors taken."""
        if not self.sectors:
            return AlarmFigures(count=self.count)
        scans = self._told / self.sectors
        return AlarmFigures(
            count=self.count,
            scans=scans,
            asked=self._mean,
            asked_per_scan=self._mean / scans if scans else math.nan,
            delivered_per_scan=self.count / scans if scans else math.nan,
            z=z_score(self.count - self._mean, self._mean),  # binomial over very many cells
            p=math.nan if math.isnan(self._mean) else p_of_poisson(self.count, self._mean),
        )


MOST_AHEAD = 4096
"""Sectors that may be told of before an earlier one, until that counts as missed."""
MOST_RUNS = 1000


class SectorsTally:
    """Sectors of one sensor that the ledger has, by their numbers, and those that it lacks."""

    def __init__(self) -> None:
        self.lacking: list[range] = []
        """Between those that are there, in their order."""
        self._next: int | None = None
        self._ahead: set[int] = set()

    def add(self, number: int) -> None:
        """Take a sector: its scan times the sectors of a scan, and its place in it."""
        self._ahead.add(number)
        if len(self._ahead) > MOST_AHEAD:
            self._go_on()

    def end(self) -> None:
        """There are no more."""
        while self._ahead:
            self._go_on()

    def _go_on(self) -> None:
        """Count on from the earliest that is known, as far as they follow each other."""
        first = min(self._ahead)
        if self._next is not None and first > self._next and len(self.lacking) < MOST_RUNS:
            self.lacking.append(range(self._next, first))
        while first in self._ahead:
            self._ahead.discard(first)
            first += 1
        self._next = max(first, self._next or first)

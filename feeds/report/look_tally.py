"""Looks by range: how many should have been detected by their own odds, and how many were."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from plotfeed.feeds.report.spreads import share_interval, z_score
from plotfeed.proto import plotfeed_pb2 as pb

CELL_M = 25.0
MAX_CELLS = 40_000
"""Up to 1000 km; what is further counts with the last."""
MAX_BINS = 12
AT_ONCE = 4096
_ROWS = 4  # looks, sum of pd, sum of pd (1 - pd), detected


@dataclass(frozen=True, slots=True, kw_only=True)
class PdFigures:
    """Of the looks at some ranges."""

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


class LooksTally:
    """Of one sensor, in cells of range."""

    def __init__(self) -> None:
        self._cells = np.zeros((_ROWS, 0))
        self._gathered: list[tuple[float, float, bool]] = []

    def add(self, looks: Sequence[pb.Look]) -> None:
        """Take those of a sector."""
        self._gathered.extend((look.range_m, look.pd, look.detected) for look in looks)
        if len(self._gathered) >= AT_ONCE:
            self.count()

    def count(self) -> None:
        """Count what has been gathered; looks without a range or odds tell nothing."""
        if not self._gathered:
            return
        range_m, pd, detected = np.array(self._gathered, np.float64).T
        self._gathered.clear()
        good = (range_m >= 0) & (range_m < math.inf) & (pd >= 0) & (pd <= 1)
        range_m, pd, detected = range_m[good], pd[good], detected[good]
        if not len(pd):
            return
        cell = np.minimum(range_m / CELL_M, MAX_CELLS - 1).astype(np.int64)
        more = int(cell.max()) + 1 - self._cells.shape[1]
        if more > 0:
            self._cells = np.pad(self._cells, ((0, 0), (0, more)))
        for row, values in enumerate((np.ones(len(pd)), pd, pd * (1 - pd), detected)):
            self._cells[row] += np.bincount(cell, values, self._cells.shape[1])

    def total(self) -> PdFigures | None:
        """At all ranges; None without a look."""
        cells = np.flatnonzero(self._cells[0])
        return self._figures(int(cells[0]), int(cells[-1]) + 1) if len(cells) else None

    def bins(self) -> list[PdFigures]:
        """At most `MAX_BINS` equal ones over the ranges that were looked at; none is empty."""
        cells = np.flatnonzero(self._cells[0])
        if not len(cells):
            return []
        width = _round_up((cells[-1] + 1 - cells[0]) * CELL_M / MAX_BINS)
        edges = _edges(int(cells[0]), int(cells[-1]) + 1, round(width / CELL_M))
        found = (self._figures(low, high) for low, high in pairwise(edges))
        return [figures for figures in found if figures.looks]

    def _figures(self, first: int, end: int) -> PdFigures:
        looks, pd, variance, detected = self._cells[:, first:end].sum(axis=1).tolist()
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
    """To 1, 2 or 5 times a power of ten, where cells fit into it, and at least a cell."""
    unit = 10.0 ** math.floor(math.log10(max(width_m, CELL_M)))
    for times in (1, 2, 5, 10, 20, 50):
        step = times * unit
        if step >= width_m and step % CELL_M == 0:
            return step
    return 10 * CELL_M * math.ceil(width_m / (10 * CELL_M))


def _edges(first: int, end: int, step: int) -> list[int]:
    """Cells at which bins begin, at whole multiples of the step, and where the last one ends."""
    return list(range(first // step * step, end + step, step))

"""Looks by range: how many there were, what their own odds came to, and how many detected."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from plotfeed.models.state import Bools, Floats


class LookTally:
    """Looks of one sensor, in cells of range that are equally wide."""

    def __init__(self, cell_m: float, most_cells: int, *, at_once: int = 4096) -> None:
        """What is further than the last cell counts with it; so many are counted together."""
        self.cell_m = cell_m
        self._most_cells = most_cells
        self._at_once = at_once
        self._cells = np.zeros((4, 0))
        self._parts: list[tuple[Any, Any, Any]] = []
        self._waiting = 0

    def add(
        self,
        range_m: Floats | Sequence[float],
        pd: Floats | Sequence[float],
        detected: Bools | Sequence[bool],
    ) -> None:
        """Take some looks; (n,) each."""
        if not len(pd):
            return
        self._parts.append((range_m, pd, detected))
        self._waiting += len(pd)
        if self._waiting >= self._at_once:
            self._count()

    def cells(self) -> Floats:
        """Looks, sum of pd, sum of pd (1 - pd) and detections, by range from 0 on; (4, n).

        There are as many cells as have been looked at. Looks without a range or odds tell nothing.
        """
        if self._parts:
            self._count()
        return self._cells

    def _count(self) -> None:
        range_m, pd, detected = (
            np.concatenate(column, dtype=np.float64) for column in zip(*self._parts, strict=True)
        )
        self._parts.clear()
        self._waiting = 0
        good = (range_m >= 0) & (range_m < math.inf) & (pd >= 0) & (pd <= 1)
        range_m, pd, detected = range_m[good], pd[good], detected[good]
        if not len(pd):
            return
        cell = np.minimum(range_m / self.cell_m, self._most_cells - 1).astype(np.int64)
        more = int(cell.max()) + 1 - self._cells.shape[1]
        if more > 0:
            self._cells = np.pad(self._cells, ((0, 0), (0, more)))
        for row, values in enumerate((np.ones(len(pd)), pd, pd * (1 - pd), detected)):
            self._cells[row] += np.bincount(cell, values, self._cells.shape[1])

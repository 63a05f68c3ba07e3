"""Random numbers of whole scans, a row a drone, of which each look takes those of its drone.

So what is drawn for a drone depends neither on the company in which it is looked at, nor on how
many sectors are worked out at once.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.state import Floats, Ints

Generator = np.random.Generator
Draw = Callable[[Generator, tuple[int, ...]], Floats]
FEWEST_ROWS = 16
SCANS_KEPT = 8


class ScanDraws:
    """The draws of a sensor for one purpose: the k-th that looks ask for is table k of a scan."""

    def __init__(self, chance: Chance, purpose: Purpose) -> None:
        self._chance = chance
        self._purpose = purpose
        self._tables: dict[int, dict[tuple[Any, ...], Floats]] = {}

    def of(self, scans: Ints, drones: Ints) -> DrawsByDrone:
        """Draws for looks in those scans at those drones, by index; each (n,)."""
        return DrawsByDrone(self, scans, drones, count())

    def table(self, scan: int, key: tuple[Any, ...], rows: int, draw: Draw) -> Floats:
        """Rows of what `draw` draws, at least so many; more rows leave the first ones as they are.

        `key` is the number of the table, the shape of a row, and what else the draw depends on.
        """
        tables = self._tables.setdefault(scan, {})
        table = tables.get(key)
        if table is None or len(table) < rows:
            rows = max(FEWEST_ROWS, 1 << (rows - 1).bit_length())
            rng = self._chance.rng(self._purpose, scan, key[0])
            table = tables[key] = draw(rng, (rows, *key[1]))
            while len(self._tables) > SCANS_KEPT:
                del self._tables[min(self._tables)]
        return table


class DrawsByDrone:
    """Stand-in for a generator where sizes end in the number of looks, (..., n)."""

    def __init__(self, scans: ScanDraws, scan: Ints, drone: Ints, tables: count[int]) -> None:
        self._scans = scans
        self._scan = scan
        self._drone = drone
        self._tables = tables

    def rows(self, which: NDArray[Any] | slice) -> DrawsByDrone:
        """Draws for some of the looks, going on with the next table."""
        return DrawsByDrone(self._scans, self._scan[which], self._drone[which], self._tables)

    def random(self, size: tuple[int, ...]) -> Floats:
        """Uniform in [0, 1)."""
        return self._take(size, (), lambda rng, shape: rng.random(shape))

    def standard_normal(self, size: tuple[int, ...]) -> Floats:
        """Normal, of mean 0 and variance 1."""
        return self._take(size, (), lambda rng, shape: rng.standard_normal(shape))

    def standard_exponential(self, size: tuple[int, ...]) -> Floats:
        """Exponential, of mean 1."""
        return self._take(size, (), lambda rng, shape: rng.standard_exponential(shape))

    def standard_gamma(self, order: float, size: tuple[int, ...]) -> Floats:
        """Gamma of that order, one for all, and of scale 1."""
        order = float(order)
        return self._take(size, (order,), lambda rng, shape: rng.standard_gamma(order, shape))

    def _take(self, size: int | tuple[int, ...], law: tuple[Any, ...], draw: Draw) -> Floats:
        inner = size[:-1] if isinstance(size, tuple) else ()
        key = (next(self._tables), inner, *law)
        taken = np.empty((len(self._drone), *inner))
        if len(taken):
            rows = int(self._drone.max()) + 1
            first, last = int(self._scan[0]), int(self._scan[-1])
            if first == last:
                taken = self._scans.table(first, key, rows, draw)[self._drone]
            else:
                for scan in np.unique(self._scan).tolist():
                    mine = self._scan == scan
                    table = self._scans.table(scan, key, rows, draw)
                    taken[mine] = table[self._drone[mine]]
        return np.moveaxis(taken, 0, -1) if inner else taken


def of_rows(rng: Generator, which: NDArray[Any] | slice) -> Generator:
    """Generator for some of the looks: the same, unless draws belong to drones."""
    rows: Callable[[Any], Generator] | None = getattr(rng, "rows", None)
    return rng if rows is None else rows(which)

"""Random numbers that depend on what they are for, and on nothing else.

A Philox generator keyed by (seed, sensor) starts at the counter (scan, purpose, sector): the same
draws come whatever ran before, in whatever order, and in however many processes.

Of the random numbers of whole scans, a row a drone, each look takes those of its drone: what is
drawn for a drone depends neither on the company in which it is looked at, nor on how many sectors
are worked out at once.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from hashlib import blake2b
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.state import Floats, Ints

Generator = np.random.Generator
Draw = Callable[[Generator, tuple[int, ...]], Floats]
FEWEST_ROWS = 16
SCANS_KEPT = 8


class Purpose(IntEnum):
    """What draws are for; each has a stream of its own."""

    DETECTION = 0
    FALSE_ALARMS = 1
    TRACKS = 2
    COOPERATION = 3
    IMPAIRMENT = 4
    SCAN_TIMES = 5
    DRIFT = 6


class Chance:
    """The random numbers of one sensor."""

    def __init__(self, seed: int, sensor: str) -> None:
        sensor_key = int.from_bytes(blake2b(sensor.encode(), digest_size=8).digest(), "big")
        self.key = sensor_key
        """A number of the sensor's own, from its name alone."""
        self._generators = {
            purpose: np.random.Generator(np.random.Philox(key=(seed << 64) | sensor_key))
            for purpose in Purpose
        }
        self._states: dict[Purpose, dict[str, Any]] = {
            purpose: dict(generator.bit_generator.state)
            for purpose, generator in self._generators.items()
        }

    def rng(self, purpose: Purpose, scan: int, sector: int = 0) -> np.random.Generator:
        """The generator for that purpose, at the start of its draws for that scan and sector.

        The one object a purpose is re-keyed at each call (2 us, where a new one takes 9): finish
        with it before asking for the next.
        """
        generator, state = self._generators[purpose], self._states[purpose]
        counter = np.array([0, sector, purpose, scan], dtype=np.uint64)
        state["state"] = {"counter": counter, "key": state["state"]["key"]}
        generator.bit_generator.state = state
        return generator


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

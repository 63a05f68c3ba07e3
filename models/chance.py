"""Random numbers that depend on what they are for, and on nothing else.

A Philox generator keyed by (seed, sensor) starts at the counter (scan, purpose, sector): the same
draws come whatever ran before, in whatever order, and in however many processes.

Of the random numbers of whole scans, a row a drone, each look takes those of its drone: what is
drawn for a drone depends neither on the company in which it is looked at, nor on how many sectors
are worked out at once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from enum import IntEnum
from hashlib import blake2b
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plotfeed.models.state import FEWEST_ROWS, Floats, Ints, renamed

Generator = np.random.Generator
# Scans of a sensor whose draws are kept: the one under way, and the one before or after it.
FEWEST_SLOTS = 2
NO_SCAN = np.iinfo(np.int64).min


class Purpose(IntEnum):
    """What draws are for; each has a stream of its own."""

    DETECTION = 0
    FALSE_ALARMS = 1
    TRACKS = 2
    COOPERATION = 3
    IMPAIRMENT = 4
    SCAN_TIMES = 5
    DRIFT = 6
    FORMATION = 7
    MOVERS = 8
    CLUTTER = 9
    FLUCTUATION = 10
    PAIRS = 11
    SIDELOBES = 12
    CLAIMS = 13
    OTHERS = 14  # Looks of staring sensors at what is no drone


class Chance:
    """The random numbers of one sensor."""

    def __init__(self, seed: int, sensor: str) -> None:
        sensor_key = int.from_bytes(blake2b(sensor.encode(), digest_size=8).digest(), "big")
        self.key = sensor_key  # A number of the sensor's own, from its name alone
        self._key = (seed << 64) | sensor_key
        # Of each purpose that was asked for.
        self._generators: dict[Purpose, tuple[np.random.Generator, dict[str, Any]]] = {}

    def rng(self, purpose: Purpose, scan: int, sector: int = 0) -> np.random.Generator:
        """The generator for that purpose, at the start of its draws for that scan and sector.

        The one object a purpose is re-keyed at each call (2 us, where a new one takes 9): finish
        with it before asking for the next.
        """
        if purpose not in self._generators:
            made = np.random.Generator(np.random.Philox(key=self._key))
            self._generators[purpose] = made, dict(made.bit_generator.state)
        generator, state = self._generators[purpose]
        counter = np.array([0, sector, purpose, scan], dtype=np.uint64)
        state["state"] = {"counter": counter, "key": state["state"]["key"]}
        generator.bit_generator.state = state
        return generator


class _DrawTable:
    """Rows of draws of one law: by sensor, by scan modulo the slots, by drone."""

    def __init__(self, sensors: int, slots: int, rows: int, inner: tuple[int, ...]) -> None:
        self.values = np.empty((sensors, slots, rows, *inner))
        self.scan_of = np.full((sensors, slots), NO_SCAN, np.int64)  # Whose draws they are


# What tables are told apart by: a number, the shape of a row, and a law by its name and orders.
DrawKey = tuple[int, tuple[int, ...], str, tuple[float, ...]]


class ScanDraws:
    """Draws of sensors for one purpose: the k-th that looks ask for is table k of a scan.

    More rows of a table leave the first ones as they are. Tables of scans that are past give way.
    """

    def __init__(self, chances: Sequence[Chance], purpose: Purpose) -> None:
        self._chances = chances
        self._purpose = purpose
        self._tables: dict[DrawKey, _DrawTable] = {}

    def of(self, sensors: Ints, scans: Ints, drones: Ints) -> DrawsByDrone:
        """Draws for looks of those sensors, in those scans, at those drones; indices, each (n,)."""
        return DrawsByDrone(self, sensors, scans, drones, count())

    def trim(self, drones: int) -> None:
        """Keep no room for many more drones than that; what is still asked for is drawn again."""
        most = 2 * max(FEWEST_ROWS, drones)
        large = [key for key, table in self._tables.items() if table.values.shape[2] > 2 * most]
        for key in large:
            del self._tables[key]

    def taken(self, key: DrawKey, sensors: Ints, scans: Ints, drones: Ints) -> Floats:
        """Rows of a table, (n, ...), one a look; n above 0."""
        rows, table = int(drones.max()) + 1, self._tables.get(key)
        slots = FEWEST_SLOTS if table is None else table.scan_of.shape[1]
        if table is None or rows > table.values.shape[2]:
            rows = max(FEWEST_ROWS, 1 << (rows - 1).bit_length())
            table = _DrawTable(len(self._chances), slots, rows, key[1])
        while True:
            slot = scans & (slots - 1)
            missing = table.scan_of[sensors, slot] != scans
            if not missing.any():
                self._tables[key] = table
                taken: Floats = table.values[sensors, slot, drones]
                return taken
            wanted = dict.fromkeys(
                zip(sensors[missing].tolist(), scans[missing].tolist(), strict=True)
            )
            self._fill(key, table, wanted)
            if (table.scan_of[sensors, slot] != scans).any():  # two scans of one slot at once
                slots *= 2
                rows = table.values.shape[2]
                table = _DrawTable(len(self._chances), slots, rows, key[1])

    def draw_next(self, sensors: Ints, scans: Ints) -> None:
        """Draw what looks of the scans after those will ask for if they ask for the same again.

        Sensors that begin their scans together need not draw together then.
        """
        for key, table in self._tables.items():
            last_slot, following = table.scan_of.shape[1] - 1, scans + 1
            asked = table.scan_of[sensors, scans & last_slot] == scans
            asked &= table.scan_of[sensors, following & last_slot] != following
            which = zip(sensors[asked].tolist(), following[asked].tolist(), strict=True)
            self._fill(key, table, which)

    def _fill(self, key: DrawKey, table: _DrawTable, which: Iterable[tuple[int, int]]) -> None:
        """Draw the rows of a table for those sensors and scans."""
        number, _, law, orders = key
        _, slots, *shape = table.values.shape
        for sensor, scan in which:
            rng = self._chances[sensor].rng(self._purpose, scan, number)
            table.values[sensor, scan % slots] = getattr(rng, law)(*orders, tuple(shape))
            table.scan_of[sensor, scan % slots] = scan


class _StandIn(ABC):
    """Stand-in for a generator where sizes end in the number of looks, (..., n)."""

    @abstractmethod
    def _take(self, size: Any, law: str, *orders: Any) -> Floats:
        """What a generator's method of that name draws for the looks; orders are of the law."""

    def random(self, size: int | tuple[int, ...]) -> Floats:
        """Uniform in [0, 1)."""
        return self._take(size, "random")

    def standard_normal(self, size: int | tuple[int, ...]) -> Floats:
        """Normal, of mean 0 and variance 1."""
        return self._take(size, "standard_normal")

    def standard_exponential(self, size: int | tuple[int, ...]) -> Floats:
        """Exponential, of mean 1."""
        return self._take(size, "standard_exponential")

    def standard_gamma(self, order: ArrayLike, size: int | tuple[int, ...]) -> Floats:
        """Gamma of scale 1 and of that order, or those of the looks, (..., n)."""
        return self._take(size, "standard_gamma", order)


class DrawsByDrone(_StandIn):
    """Draws that belong to the drones of looks, in the tables of their scans."""

    def __init__(
        self, draws: ScanDraws, sensor: Ints, scan: Ints, drone: Ints, tables: count[int]
    ) -> None:
        self._draws = draws
        self._sensor = sensor
        self._scan = scan
        self._drone = drone
        self._tables = tables

    def rows(self, which: NDArray[Any] | slice) -> DrawsByDrone:
        """Draws for some of the looks, going on with the next table."""
        sensor, scan, drone = self._sensor[which], self._scan[which], self._drone[which]
        return DrawsByDrone(self._draws, sensor, scan, drone, self._tables)

    def _take(self, size: Any, law: str, *orders: Any) -> Floats:
        """Orders are one for all looks."""
        inner = size[:-1] if isinstance(size, tuple) else ()
        key = next(self._tables), inner, law, tuple(float(order) for order in orders)
        if not len(self._drone):
            return np.empty((*inner, 0))
        taken = self._draws.taken(key, self._sensor, self._scan, self._drone)
        return np.moveaxis(taken, 0, -1) if inner else taken


class DrawsBySensor(_StandIn):
    """Draws of a generator a sensor, each as if it were alone, for looks that stand together."""

    def __init__(self, generators: Sequence[Generator], sensor: Ints) -> None:
        """`sensor` (n,) is the index of the generator of each look, in ascending order.

        A sensor may have a second one, for looks at what is no drone.
        """
        self._generators = generators
        self._sensor = sensor

    def rows(self, which: NDArray[Any] | slice) -> DrawsBySensor:
        """Draws for some of the looks, in their order."""
        return DrawsBySensor(self._generators, self._sensor[which])

    def _take(self, size: Any, law: str, *orders: Any) -> Floats:
        shape = size if isinstance(size, tuple) else (size,)
        taken = np.empty(shape)
        if len(self._sensor):
            ends = np.cumsum(np.bincount(self._sensor)).tolist()
            first = 0
            for generator, end in zip(self._generators, ends, strict=False):
                if end > first:
                    own = [o[..., first:end] if np.ndim(o) else o for o in orders]
                    of_law = getattr(generator, law)
                    taken[..., first:end] = of_law(*own, (*shape[:-1], end - first))
                first = end
        return taken


def of_rows(rng: Generator, which: NDArray[Any] | slice) -> Generator:
    """Generator for some of the looks: the same, unless draws belong to drones."""
    rows: Callable[[Any], Generator] | None = getattr(rng, "rows", None)
    return rng if rows is None else rows(which)


class PairDraws:
    """Draws that a sensor and a drone have once for all, by their names: uniform, and normal."""

    def __init__(self, chances: Sequence[Chance]) -> None:
        self._chances = chances
        self._drawn = np.full((len(chances), 0, 2), np.nan)
        self._names: Sequence[str] = ()

    def of(self, sensor: Ints, drone: Ints, names: Sequence[str]) -> Floats:
        """Draws of looks of sensors at drones, which have those names; (n,) each, (2, n) out."""
        if names is not self._names:
            others = renamed(self._names, names)
            self._drawn[:, others[others < self._drawn.shape[1]]] = np.nan
            self._names = names
        more = len(names) - self._drawn.shape[1]
        if more > 0:
            room = np.full((len(self._chances), more, 2), np.nan)
            self._drawn = np.concatenate([self._drawn, room], axis=1)
        missing = np.isnan(self._drawn[sensor, drone, 0])
        pairs = zip(sensor[missing].tolist(), drone[missing].tolist(), strict=True)
        for one, other in dict.fromkeys(pairs):
            key = int.from_bytes(blake2b(names[other].encode(), digest_size=7).digest(), "big")
            rng = self._chances[one].rng(Purpose.PAIRS, key)
            self._drawn[one, other] = rng.random(), rng.standard_normal()
        return np.moveaxis(self._drawn[sensor, drone], -1, 0)

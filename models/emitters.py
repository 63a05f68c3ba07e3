"""What drones emit: their emitters, one drone after the other, and in columns, a row an emitter."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Self, overload

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.state import Columns, Emitter, Floats, Ints, Texts, with_room


@dataclass(frozen=True, kw_only=True)
class Emissions(Columns):
    """What targets emit: `target` is a row of theirs, `channel` the emitter on that drone.

    `emitter` is a row of the table that they are from, `share` what of their power a sensor
    receives, where that is known.
    """

    target: Ints
    channel: Ints
    emitter: Ints
    frequency_hz: Floats
    bandwidth_hz: Floats
    eirp_dbm: Floats
    share: Floats | None = None


class EmitterTable(Sequence[tuple[Emitter, ...]]):
    """The emitters of every drone, by its index; a drone's may be set anew at little cost."""

    def __init__(self, emitters: Iterable[tuple[Emitter, ...]] = ()) -> None:
        self._of_drones = list(emitters)
        self._columns: _EmitterColumns | None = None

    @classmethod
    def of(cls, emitters: Sequence[tuple[Emitter, ...]]) -> EmitterTable:
        """The table that those are, or one of them."""
        return emitters if isinstance(emitters, EmitterTable) else cls(emitters)

    def __len__(self) -> int:
        return len(self._of_drones)

    @overload
    def __getitem__(self, drone: int) -> tuple[Emitter, ...]: ...
    @overload
    def __getitem__(self, drone: slice) -> list[tuple[Emitter, ...]]: ...
    def __getitem__(self, drone: Any) -> Any:
        return self._of_drones[drone]

    def __iter__(self) -> Iterator[tuple[Emitter, ...]]:
        return iter(self._of_drones)

    def __setitem__(self, drone: int, emitters: tuple[Emitter, ...]) -> None:
        if emitters == self._of_drones[drone]:
            return
        self._of_drones[drone] = emitters
        if self._columns is not None and not self._columns.put(drone, emitters):
            self._columns = None

    def append(self, emitters: tuple[Emitter, ...]) -> None:
        """Add a drone's."""
        self._of_drones.append(emitters)
        drone = len(self._of_drones) - 1
        if self._columns is not None and not self._columns.put(drone, emitters):
            self._columns = None

    def cut(self, drones: int) -> None:
        """Keep those of so many drones, the first ones, and no room for more."""
        del self._of_drones[drones:]
        self._columns = None

    def emissions(self, drones: Ints) -> Emissions:
        """Emissions of targets that are those drones, a row an emitter, in the order of targets."""
        columns = self._made()
        first, count = columns.first[drones], columns.count[drones]
        if (count == 1).all():
            target, channel, emitter = np.arange(len(drones)), np.zeros(len(drones), int), first
        else:
            target = np.repeat(np.arange(len(drones)), count)
            channel = np.arange(len(target)) - (np.cumsum(count) - count)[target]
            emitter = first[target] + channel
        return Emissions(
            target=target,
            channel=channel,
            emitter=emitter,
            frequency_hz=columns.numbers[0, emitter],
            bandwidth_hz=columns.numbers[1, emitter],
            eirp_dbm=columns.numbers[2, emitter],
        )

    def kinds(self, emissions: Emissions) -> Texts:
        """Kinds of emissions that are from here; (n,)."""
        return np.asarray(self._made().texts[0, emissions.emitter])

    def identities(self, emissions: Emissions) -> Texts:
        """What emissions that are from here say when they are decoded; (n,)."""
        return np.asarray(self._made().texts[1, emissions.emitter])

    def _made(self) -> _EmitterColumns:
        if self._columns is None:
            self._columns = _EmitterColumns.of(self._of_drones)
        return self._columns


@dataclass(slots=True)
class _EmitterColumns:
    """Numbers (3, rows) and texts (2, rows) of emitters; those of a drone follow each other.

    What is put anew is put behind all others, as long as there is room for it.
    """

    numbers: Floats
    texts: NDArray[np.object_]
    first: Ints
    count: Ints
    used: int = 0

    @classmethod
    def of(cls, of_drones: Sequence[tuple[Emitter, ...]]) -> Self:
        """Columns with room for as many emitters again."""
        rows, drones = 2 * sum(map(len, of_drones)) + 16, len(of_drones)
        made = cls(
            np.zeros((3, rows)),
            np.full((2, rows), "", np.object_),
            np.zeros(drones, np.int64),
            np.zeros(drones, np.int64),
        )
        for drone, emitters in enumerate(of_drones):
            if emitters:
                made.put(drone, emitters)
        return made

    def put(self, drone: int, emitters: tuple[Emitter, ...]) -> bool:
        """Put a drone's emitters in; False if there is no room."""
        start, end = self.used, self.used + len(emitters)
        if end > self.numbers.shape[1]:
            return False
        if drone >= len(self.first):
            self.first, self.count = (
                with_room(column, drone + 1) for column in (self.first, self.count)
            )
        for i, e in enumerate(emitters, start):
            self.numbers[:, i] = e.frequency_hz, e.bandwidth_hz, e.eirp_dbm
            self.texts[:, i] = e.kind, e.identity
        self.first[drone], self.count[drone] = start, len(emitters)
        self.used = end
        return True

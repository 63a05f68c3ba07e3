"""The random numbers of a link: for each message a row of them, whatever becomes of it.

Rows begin anew with every second of due time, so that a session that starts again, on any clock,
draws what it would have drawn. A setting takes its own column and leaves the others alone.
"""

from __future__ import annotations

from enum import IntEnum
from typing import cast

import numpy as np
from numpy.typing import NDArray

from plotfeed.feeds.impairment.delays import DelaySeries
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.models.chance import Chance, Purpose
from plotfeed.proto.utc import NS

FEWEST_ROWS = 8
MOST_ROWS = 4096
"""Drawn at once."""


class Column(IntEnum):
    """What the numbers of a row are for."""

    STATE = 0
    LOSS = 1
    DUPLICATE = 2
    CORRUPT = 3
    BIT = 4
    REORDER = 5
    DELAY = 6
    COPY_DELAY = 7


def rows(chance: Chance, second: int, first: int, count: int) -> NDArray[np.float64]:
    """Uniform numbers from 0 to 1 of a second's messages from the first-th on; (count, 8)."""
    rng = chance.rng(Purpose.IMPAIRMENT, second)
    if first:  # a step of Philox gives four numbers
        cast(np.random.Philox, rng.bit_generator).advance(first * len(Column) // 4)
    return rng.random((count, len(Column)))


class Draws:
    """What chance has for each message, as columns of which the settings need some."""

    def __init__(self, link: LinkSettings, seed: int, name: str) -> None:
        self._chance = Chance(seed, name)
        self._second = -1
        self._row = self._first = self._end = 0
        self._rows_of_last_second = 0
        self._series = DelaySeries(link)
        self.state: list[float] = []
        self.loss: list[float] = []
        self.duplicate: list[float] = []
        self.corrupt: list[float] = []
        self.bit: list[float] = []
        self.reorder: list[float] = []
        self.delay_ns: list[int] = []
        self.copy_delay_ns: list[int] = []
        self.change(link)

    def change(self, link: LinkSettings) -> None:
        """Draw what these settings need from the next message on."""
        self._series.use(self._row - self._first)
        self._series = DelaySeries(link, self._series.score)
        self._first = self._end = self._row
        self._is_clear = link.is_clear
        self._needed = [
            (Column.STATE, link.loss is not None),
            (Column.LOSS, link.loss is not None),
            (Column.DUPLICATE, link.duplicate > 0),
            (Column.CORRUPT, link.corrupt > 0),
            (Column.BIT, link.corrupt > 0),
            (Column.REORDER, link.reorder is not None),
        ]
        self._has_copies = link.duplicate > 0

    def next(self, t_utc_ns: int) -> int:
        """The place of the next message, which is due then, in the columns."""
        second = t_utc_ns // NS
        if second != self._second:
            self._begin(second)
        row = self._row
        if row >= self._end and not self._is_clear:
            self._draw()
        self._row = row + 1
        return row - self._first

    def _begin(self, second: int) -> None:
        self._series.use(self._row - self._first)
        self._second, self._rows_of_last_second = second, self._row
        self._row = self._first = self._end = 0

    def _draw(self) -> None:
        """Draw as many rows as the last second had; where that is not enough, twice as many."""
        row = self._row
        self._series.use(row - self._first)
        count = self._rows_of_last_second - row
        count = min(max(count if count > 0 else row, FEWEST_ROWS), MOST_ROWS)
        block = rows(self._chance, self._second, row, count)
        self._first, self._end = row, row + count
        self.state, self.loss, self.duplicate, self.corrupt, self.bit, self.reorder = (
            block[:, column].tolist() if needed else [] for column, needed in self._needed
        )
        self.delay_ns, self.copy_delay_ns = self._series.draw(
            block[:, Column.DELAY], block[:, Column.COPY_DELAY] if self._has_copies else None
        )

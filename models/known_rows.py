"""Rows of drones that come and go: room in columns for them, and which are others' now."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.state import Ints


def with_room(column: NDArray[Any], rows: int) -> NDArray[Any]:
    """A column of at least 16 and so many rows, new ones zero; it at least doubles if it grows."""
    more = max(rows, 16) - len(column)
    if more <= 0:
        return column
    room = np.zeros((max(more, len(column)), *column.shape[1:]), column.dtype)
    return np.concatenate([column, room])


FEWEST_ROWS = 16


def trimmed(column: NDArray[Any], rows: int) -> NDArray[Any]:
    """A column for so many rows, without most of the room that it has for more."""
    room = 2 * max(rows, FEWEST_ROWS)
    return column[:room].copy() if len(column) > 2 * room else column


def renamed(before: Sequence[str], names: Sequence[str]) -> Ints:
    """Rows of drones that had other names before, by their names before and now."""
    if before is names:
        return np.zeros(0, np.int64)
    changed = [row for row, (a, b) in enumerate(zip(before, names, strict=False)) if a != b]
    return np.array([*changed, *range(len(names), len(before))], np.int64)

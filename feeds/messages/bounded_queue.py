"""The one bounded queue: whatever waits has a limit, and is counted."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar("Item")


class BoundedQueue(Generic[Item]):
    """First in, first out, up to a limit of items and one of octets."""

    def __init__(self, limit: int, *, limit_octets: int, octets_of: Callable[[Item], int]) -> None:
        self.octets = 0  # Of the items that wait
        self._limit, self._limit_octets = limit, limit_octets
        self._octets_of = octets_of
        self._items: deque[Item] = deque()

    def __len__(self) -> int:
        """How many wait."""
        return len(self._items)

    def put(self, item: Item) -> bool:
        """Let an item wait; False without room."""
        octets = self.octets + self._octets_of(item)
        if len(self._items) >= self._limit or octets > self._limit_octets:
            return False
        self._items.append(item)
        self.octets = octets
        return True

    def take(self) -> Item:
        """Take out the item whose turn it is; there must be one."""
        item = self._items.popleft()
        self.octets -= self._octets_of(item)
        return item

    def clear(self) -> None:
        """Give up all that waits."""
        self._items.clear()
        self.octets = 0

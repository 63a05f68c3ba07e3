"""The one bounded queue: whatever waits has a limit."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Item = TypeVar("Item")


class BoundedQueue(Generic[Item]):
    """First in, first out, up to a limit of items and of octets."""

    def __init__(
        self,
        limit: int,
        *,
        limit_octets: int,
        octets_of: Callable[[Item], int],
        any_size_alone: bool = False,
    ) -> None:
        """`any_size_alone` gives an item room however large it is, if nothing waits."""
        self.octets = 0  # Of the items that wait
        self._limit, self._limit_octets = limit, limit_octets
        self._octets_of = octets_of
        self._any_size_alone = any_size_alone
        self._items: OrderedDict[Hashable, Item] = OrderedDict()
        self._put = 0  # What stands for the key of an item that has none

    def __len__(self) -> int:
        """How many wait."""
        return len(self._items)

    def has_room(self, octets: int) -> bool:
        """Whether an item of that size would find room."""
        if len(self._items) >= self._limit:
            return False
        alone = self._any_size_alone and not self._items
        return alone or self.octets + octets <= self._limit_octets

    def put(self, item: Item, key: Hashable = None) -> bool:
        """Let an item wait, by its key if it may be asked for; False without room."""
        octets = self._octets_of(item)
        if not self.has_room(octets):
            return False
        self._put += 1
        self._items[self._put if key is None else key] = item
        self.octets += octets
        return True

    def put_back(self, item: Item, key: Hashable) -> None:
        """Let an item that was taken go before all others, even where there is no room."""
        self._items[key] = item
        self._items.move_to_end(key, last=False)
        self.octets += self._octets_of(item)

    def first(self) -> Item:
        """The item whose turn it is; there must be one."""
        return next(iter(self._items.values()))

    def take(self, key: Hashable = None) -> Item:
        """Take out the item of that key, or the one whose turn it is; there must be one."""
        item = self._items.popitem(last=False)[1] if key is None else self._items.pop(key)
        self.octets -= self._octets_of(item)
        return item

    def clear(self) -> None:
        """Give up all that waits."""
        self._items.clear()
        self.octets = 0

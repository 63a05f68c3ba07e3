"""The one bounded queue: whatever waits has a limit, and is counted."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True, kw_only=True)
class QueueStatistics:
    """What a queue has done so far, in items; `octets` is the size of those that wait."""

    limit: int
    waiting: int
    octets: int
    put: int  # That found room
    taken: int
    dropped: int  # That found no room, or were given up while they waited


class BoundedQueue(Generic[Item]):
    """First in, first out, up to a limit of items and, if there is one, of octets."""

    def __init__(
        self,
        limit: int,
        *,
        limit_octets: int | None = None,
        octets_of: Callable[[Item], int] = lambda _: 0,
        any_size_alone: bool = False,
    ) -> None:
        """`any_size_alone` gives an item room however large it is, if nothing waits."""
        self.limit = limit
        self.octets = 0  # Of the items that wait
        self._limit_octets = limit_octets
        self._octets_of = octets_of
        self._any_size_alone = any_size_alone
        self._items: OrderedDict[Hashable, Item] = OrderedDict()
        self._put = self._taken = self._dropped = self._returned = 0

    def __len__(self) -> int:
        """How many wait."""
        return len(self._items)

    def __iter__(self) -> Iterator[Item]:
        """Go through the items that wait, the oldest first."""
        return iter(self._items.values())

    def __contains__(self, key: Hashable) -> bool:
        """Whether an item with that key waits."""
        return key in self._items

    def statistics(self) -> QueueStatistics:
        """Counts so far."""
        return QueueStatistics(
            limit=self.limit,
            waiting=len(self._items),
            octets=self.octets,
            put=self._put,
            taken=self._taken,
            dropped=self._dropped,
        )

    def has_room(self, octets: int = 0) -> bool:
        """Whether an item of that size would find room."""
        if len(self._items) >= self.limit:
            return False
        most = self._limit_octets
        if most is None or (self._any_size_alone and not self._items):
            return True
        return self.octets + octets <= most

    def put(self, item: Item, key: Hashable = None) -> bool:
        """Let an item wait, by its key if it may be asked for; False, and dropped, without room."""
        octets = self._octets_of(item)
        if not self.has_room(octets):
            self._dropped += 1
            return False
        self._put += 1
        self._items[self._put if key is None else key] = item
        self.octets += octets
        return True

    def put_back(self, item: Item, key: Hashable = None) -> None:
        """Let an item that was taken go before all others, even where there is no room."""
        self._returned += 1
        key = -self._returned if key is None else key
        self._items[key] = item
        self._items.move_to_end(key, last=False)
        self.octets += self._octets_of(item)
        self._taken -= 1

    def first(self) -> Item:
        """The item whose turn it is; there must be one."""
        return next(iter(self._items.values()))

    def take(self) -> Item:
        """Take out the item whose turn it is; there must be one."""
        _, item = self._items.popitem(last=False)
        self.octets -= self._octets_of(item)
        self._taken += 1
        return item

    def drop(self, key: Hashable = None) -> Item:
        """Give up the item of that key, or the one whose turn it is; there must be one."""
        item = self._items.popitem(last=False)[1] if key is None else self._items.pop(key)
        self.octets -= self._octets_of(item)
        self._dropped += 1
        return item

    def drop_all(self) -> Iterable[Item]:
        """Give up all that waits."""
        return [self.drop() for _ in range(len(self._items))]

"""Tables of what comes with plotfeed, of which a session loads only what its scene names."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping
from importlib import import_module
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class LoadedOnUse(MutableMapping[str, T], Generic[T]):
    """A mapping whose first entries are "module:name": each is loaded when it is asked for.

    Where the name is that of a mapping, the entry is what that has under the same key.
    """

    def __init__(self, homes: Mapping[str, str]) -> None:
        self._entries: dict[str, Any] = dict(homes)

    def __getitem__(self, key: str) -> T:
        entry = self._entries[key]
        if isinstance(entry, str):
            module, _, name = entry.partition(":")
            entry = getattr(import_module(module), name)
            self._entries[key] = entry = entry[key] if isinstance(entry, dict) else entry
        found: T = entry
        return found

    def __contains__(self, key: object) -> bool:
        return key in self._entries

    def __setitem__(self, key: str, entry: T) -> None:
        self._entries[key] = entry

    def __delitem__(self, key: str) -> None:
        del self._entries[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

"""How much an object of ours holds: octets of arrays, and entries of containers, all told."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

OURS = "plotfeed."


def held(*things: object) -> int:
    """Octets of arrays, and 100 for each entry of a container or octet string of 100.

    Of everything that can be reached through objects of ours and containers; each thing once.
    """
    seen: set[int] = set()
    waiting: list[Any] = [*things]
    total = 0
    while waiting:
        one = waiting.pop()
        if id(one) in seen:
            continue
        seen.add(id(one))
        if isinstance(one, np.ndarray):
            total += one.size * one.itemsize if one.strides != (0,) * one.ndim else 0
        elif isinstance(one, Mapping):
            total += 100 * len(one)
            waiting += [*one.keys(), *one.values()]
        elif isinstance(one, (str, bytes)):
            total += len(one)
        elif isinstance(one, (list, tuple, set, frozenset)) or type(one).__name__ == "deque":
            total += 100 * len(one)
            waiting += one
        elif type(one).__module__.startswith(OURS):
            waiting += _attributes(one)
    return total


def _attributes(one: object) -> Iterable[object]:
    names = [*getattr(one, "__dict__", {})]
    for kind in type(one).__mro__:
        slots = getattr(kind, "__slots__", ())
        names += [slots] if isinstance(slots, str) else slots
    return [getattr(one, name) for name in names if hasattr(one, name)]

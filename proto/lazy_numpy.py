"""NumPy, loaded when something of it is first used: ASTERIX is decoded without it.

It takes longer to load than fifty thousand records take to read.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__all__ = ["np"]


class _Later:
    def __getattr__(self, name: str) -> Any:
        value = getattr(import_module("numpy"), name)
        self.__dict__[name] = value
        return value


if TYPE_CHECKING:
    import numpy as np
else:
    np = _Later()

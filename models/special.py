"""SciPy's special functions, by their names, for what needs them seldom.

SciPy takes as long to load as NumPy: here it does so when the first function is asked for.
"""

from __future__ import annotations

from typing import Any


def __getattr__(name: str) -> Any:
    from scipy import special

    found = globals()[name] = getattr(special, name)
    return found

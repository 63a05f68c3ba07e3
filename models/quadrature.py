"""Points and weights for integrals over the unit interval."""

from __future__ import annotations

from functools import cache

import numpy as np

from plotfeed.models.state import Floats


@cache
def unit_interval(points: int) -> tuple[Floats, Floats]:
    """Gauss and Legendre's nodes in (0, 1) and their weights, of sum 1; (n,) each.

    Kept: they take 30 ms to find, more than any integral that is done with them.
    """
    nodes, weights = np.polynomial.legendre.leggauss(points)
    found = (nodes + 1) / 2, weights / 2
    for array in found:
        array.flags.writeable = False
    return found

"""Delays held against the law that a link asks for, of any number of them in bounded memory."""

from __future__ import annotations

import numpy as np

from plotfeed.feeds.impairment.delays import DelayLaw
from plotfeed.models.state import Ints

CELLS = 1 << 13
"""Of equal probability by the law: distances are known to one part in as many."""
HALF_A_NS = 0.5
"""Delays are whole nanoseconds, so that a law's atom is met from below."""


class LawFit:
    """Kolmogorov's distance between delays and a law: both counted by the law's probability."""

    def __init__(self, law: DelayLaw) -> None:
        self.count = 0
        self._law = law
        self._counts = np.zeros(CELLS, np.int64)

    def add(self, delays_ns: Ints) -> None:
        """Take some more; (n,)."""
        below = self._law.cdf((delays_ns + HALF_A_NS) / 1e6)
        cells = np.minimum((below * CELLS).astype(np.int64), CELLS - 1)
        self._counts += np.bincount(cells, minlength=CELLS)
        self.count += len(delays_ns)

    def distance(self) -> float:
        """Largest difference of the two distribution functions; NaN of a law without a spread.

        Probabilities that no delay has, within the law's atoms, are left out.
        """
        edges = np.arange(1, CELLS) / CELLS
        met = np.abs(self._law.cdf(self._law.quantile_ms(edges)) - edges) < 0.1 / CELLS
        if not self.count or not met.any():
            return np.nan
        seen = np.cumsum(self._counts)[:-1] / self.count
        return float(np.abs(seen - edges)[met].max())

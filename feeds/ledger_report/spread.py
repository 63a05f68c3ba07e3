"""How times are spread, of any number of them in bounded memory."""

from __future__ import annotations

import numpy as np

from plotfeed.models.state import Floats, Ints

STEPS = 1000
"""Of a time within a factor of e: quantiles are known to 0.05 %, below a microsecond to 1 ns."""
UNIT_NS = 1000.0


class Spread:
    """Times in nanoseconds, of either sign, counted in fine steps of their inverse sinh."""

    def __init__(self) -> None:
        self.count = 0
        self._total_ns = 0.0
        self._least_ns = self._most_ns = 0
        self._first = 0
        self._counts = np.zeros(0, np.int64)

    def add(self, times_ns: Ints) -> None:
        """Take some more; (n,)."""
        if not len(times_ns):
            return
        least_ns, most_ns = int(times_ns.min()), int(times_ns.max())
        if self.count:
            least_ns, most_ns = min(least_ns, self._least_ns), max(most_ns, self._most_ns)
        self._least_ns, self._most_ns = least_ns, most_ns
        self.count += len(times_ns)
        self._total_ns += float(times_ns.sum(dtype=np.float64))
        steps = np.rint(np.arcsinh(times_ns / UNIT_NS) * STEPS).astype(np.int64)
        self._make_room(int(steps.min()), int(steps.max()))
        self._counts += np.bincount(steps - self._first, minlength=len(self._counts))

    @property
    def mean_ms(self) -> float:
        """NaN of none."""
        return self._total_ns / self.count / 1e6 if self.count else np.nan

    @property
    def max_ms(self) -> float:
        """The longest, exactly; NaN of none."""
        return self._most_ns / 1e6 if self.count else np.nan

    def quantiles_ms(self, shares: Floats) -> Floats:
        """The least times that those shares of all do not exceed; (n,) in and out, NaN of none."""
        if not self.count:
            return np.full(shares.shape, np.nan)
        ranks = np.clip(np.ceil(shares * self.count), 1, self.count)
        steps = np.searchsorted(np.cumsum(self._counts), ranks) + self._first
        times_ns = np.clip(np.sinh(steps / STEPS) * UNIT_NS, self._least_ns, self._most_ns)
        in_ms: Floats = times_ns / 1e6
        return in_ms

    def _make_room(self, low: int, high: int) -> None:
        """For steps up to those; there are 75,000 at most."""
        if not len(self._counts):
            self._first, self._counts = low, np.zeros(high - low + 1, np.int64)
            return
        before = max(self._first - low, 0)
        after = max(high - self._first - len(self._counts) + 1, 0)
        if before or after:
            self._counts = np.pad(self._counts, (before, after))
            self._first -= before

"""Spreads of times, their fit to a law, and how far a figure may be off by chance."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import kolmogorov

from plotfeed.feeds.impairment.delays import DelayLaw
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
        """Make room for steps up to those; there are 75,000 at most."""
        if not len(self._counts):
            self._first, self._counts = low, np.zeros(high - low + 1, np.int64)
            return
        before = max(self._first - low, 0)
        after = max(high - self._first - len(self._counts) + 1, 0)
        if before or after:
            self._counts = np.pad(self._counts, (before, after))
            self._first -= before


ENOUGH = 5.0
"""Variance of a count above which it is taken to be normal; below it, there is no z-score."""
TWO_SIDED_95 = 1.959964
"""Standard deviations of a normal law on either side of its mean that hold 95 % of it."""


def z_score(excess: float, variance: float) -> float:
    """A count's excess in standard deviations; NaN if too few were counted for a normal law."""
    return excess / math.sqrt(variance) if variance >= ENOUGH else math.nan


def share_interval(count: int, of: int) -> tuple[float, float]:
    """95 % interval of a probability of which so many came true; Wilson, 1927."""
    if not of:
        return math.nan, math.nan
    share, z2 = count / of, TWO_SIDED_95**2
    middle = (share + z2 / (2 * of)) / (1 + z2 / of)
    half = TWO_SIDED_95 * math.sqrt(share * (1 - share) / of + z2 / (4 * of**2)) / (1 + z2 / of)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def p_of_distance(distance: float, n: float) -> float:
    """Probability that n independent draws are as far from their law, after Kolmogorov.

    The asymptotic law with Stephens' correction for few draws (1970); NaN of less than 8.
    """
    if not n >= 8 or math.isnan(distance):
        return math.nan
    root = math.sqrt(n)
    return float(np.clip(kolmogorov((root + 0.12 + 0.11 / root) * distance), 0.0, 1.0))


CELLS = 1 << 13
"""Of equal probability by the law: distances are known to one part in as many."""
MET = 0.1
"""Share of a cell by which a law may miss an edge, as it does within an atom."""
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
        # What ends at an edge, within what counts as met of it, lies below it: so do atoms.
        cells = np.clip(np.ceil(below * CELLS - MET).astype(np.int64) - 1, 0, CELLS - 1)
        self._counts += np.bincount(cells, minlength=CELLS)
        self.count += len(delays_ns)

    def distance(self) -> float:
        """Largest difference of the two distribution functions; NaN of a law without a spread.

        Probabilities that no delay has, within the law's atoms, are left out.
        """
        edges = np.arange(1, CELLS) / CELLS
        met = np.abs(self._law.cdf(self._law.quantile_ms(edges)) - edges) < MET / CELLS
        if not self.count or not met.any():
            return np.nan
        seen = np.cumsum(self._counts)[:-1] / self.count
        return float(np.abs(seen - edges)[met].max())

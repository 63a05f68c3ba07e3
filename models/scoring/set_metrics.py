"""GOSPA and OSPA of what there is at one instant: how far sets of tracks are from the truth.

GOSPA with alpha 2: Rahmathullah, Garcia-Fernandez and Svensson, Generalized optimal sub-pattern
assignment metric, 2017. OSPA: Schuhmacher, Vo and Vo, A consistent metric, 2008.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from plotfeed.models.state import Floats, Ints

_NONE = np.zeros(0, np.int64)


class SetScore(NamedTuple):
    """The score of one instant: parts of GOSPA as sums of p-th powers, and OSPA."""

    localisation: float
    missed: float
    false: float
    ospa_m: float
    rows: Ints
    """Truths that are paired within the cut-off, and `columns`, the tracks that they have."""
    columns: Ints

    def gospa_m(self, order: float = 2.0) -> float:
        """GOSPA, metres, of the order for which the parts are."""
        return float((self.localisation + self.missed + self.false) ** (1.0 / order))


def set_score(distances_m: Floats, cutoff_m: float, order: float = 2.0) -> SetScore:
    """Score tracks by their distances from truths, (m, n); NaN stands for what is too far.

    A pair at the cut-off or beyond is one missed truth and one false track, so that the pairs with
    the least sum of min(d, c)^p are those of GOSPA, and of OSPA too.
    """
    m, n = distances_m.shape
    limit = cutoff_m**order
    if not m or not n:
        ospa_m = cutoff_m if m or n else 0.0
        return SetScore(0.0, limit / 2 * m, limit / 2 * n, ospa_m, _NONE, _NONE)
    costs = np.fmin(distances_m, cutoff_m) ** order
    rows, columns = linear_sum_assignment(costs)
    paired = costs[rows, columns]
    near = paired < limit
    pairs = int(np.count_nonzero(near))
    spread = (paired.sum() + limit * abs(m - n)) / max(m, n)
    return SetScore(
        float(paired[near].sum()),
        limit / 2 * (m - pairs),
        limit / 2 * (n - pairs),
        float(spread ** (1.0 / order)),
        rows[near],
        columns[near],
    )

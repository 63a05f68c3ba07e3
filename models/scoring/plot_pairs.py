"""Which plot is of which target that a sensor looked at, found as a tracker would: by place alone.

Plots of a sensor may all be off by as much, or scatter more than they state. So the gate is put
about the commonest residual first, then made as wide as the residuals within it are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from plotfeed.models.effects.merging import REACH, near_pairs
from plotfeed.models.plain_tracker import least_sum
from plotfeed.models.state import Bools, Columns, Floats, Ints

GATE = 5.0
"""Half its width, in standard deviations."""
WIDER = 1.3
"""Spread of residuals, over the claimed one, from which on the gate is made wider."""
MOST_FALSE = 0.3
"""Share of false plots among those in gates from which on their spread tells nothing."""
ROUNDS = 8
WINDOW = 2.0
"""Half the width of the window that looks for the commonest residual, in standard deviations."""
OFFSETS = (-2.5, 2.5, -4.0, 4.0, -5.5, 5.5)
"""Half widths of the gate by which gates are displaced to count what is false."""
TO_NORMAL = 1.4826
"""Standard deviation over the median of absolute deviations, of normal numbers."""


@dataclass(frozen=True, kw_only=True)
class Candidates(Columns):
    """Pairs of a plot and a look of one sector that may belong together, by their numbers; (n,).

    `error` is what was measured less what was true, `sigma` its claimed standard deviation, both
    (n, k) in the units of k quantities, NaN where a plot does not measure one.
    """

    plot: Ints
    look: Ints
    error: Floats
    sigma: Floats


class PlotPairs(NamedTuple):
    """Which candidates are pairs, and the gate by which they were found."""

    chosen: Ints
    """Rows of candidates; no plot and no look twice."""
    centre: Floats
    """Of the gate, (k,), in units of the quantities."""
    gate: Floats
    """Half its width in claimed standard deviations, (k,)."""
    false_per_look: float
    """Mean number of plots of nobody in a gate."""


def plot_pairs(found: Candidates, reach: Floats, looks: int) -> PlotPairs:
    """The pairs among candidates; residuals up to `reach` (k,) and 12 gates are looked for.

    The first quantity is the one by which gates are displaced to count false plots. `looks` is how
    many there are.
    """
    quantities = found.error.shape[1]
    usual = _medians(found.sigma)
    reach = np.fmax(reach, 4 * GATE * usual)
    has = np.isfinite(found.error)
    far = np.abs(found.error) > np.fmax(reach, 4 * GATE * found.sigma)
    near = np.flatnonzero(~far.any(axis=1) & has.any(axis=1))
    error, sigma, has = found.error[near], found.sigma[near], has[near]
    plot, look = found.plot[near], found.look[near]
    centre, gate = np.zeros(quantities), np.full(quantities, GATE)
    within = np.ones(len(near), np.bool_)
    for k in range(quantities):
        centre[k] = _commonest(error[within & has[:, k], k], usual[k])
        within &= (np.abs(error[:, k] - centre[k]) <= GATE * sigma[:, k]) | ~has[:, k]
    ratio = np.where(has, (error - centre) / sigma, 0.0)
    chosen, false_per_look = _NONE, 0.0
    for _ in range(ROUNDS):
        chosen = _one_to_one(plot, look, ratio / gate)
        others = ~np.isin(plot, plot[chosen])
        false_per_look = _false_per_look(ratio[others], sigma[others, 0], gate, reach[0], looks)
        if false_per_look * looks > MOST_FALSE * max(len(chosen), 1):
            break
        wider = np.array(
            [_wanted(ratio[chosen, k][has[chosen, k]], gate[k]) for k in range(quantities)]
        )
        if (wider <= 1.05 * gate).all():
            break
        gate = wider
    return PlotPairs(near[chosen], centre, gate, false_per_look)


def look_groups(axes: Sequence[tuple[Floats, float]]) -> Ints:
    """A number of each look, (n,), which looks share that plots may not tell from each other.

    Each axis is places along it, (n,), over the distance from which plots do tell, and the period
    after which it is the same again, or 0.
    """
    n = len(axes[0][0])
    if n < 2:
        return np.zeros(n, np.int64)
    first, second, _ = near_pairs([(place * REACH, period * REACH) for place, period in axes])
    links: Any = coo_array((np.ones(len(first), np.bool_), (first, second)), shape=(n, n))
    return np.asarray(connected_components(links, directed=False)[1], np.int64)


def _medians(sigma: Floats) -> Floats:
    """Medians of each quantity; 0 of one that is nowhere measured."""
    return np.array(
        [np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else 0.0 for c in sigma.T]
    )


def _commonest(error: Floats, sigma: float) -> float:
    """The residual about which most are, unless about 0 there are nearly as many."""
    width = 2 * WINDOW * sigma
    values = np.sort(error)
    if not len(values):
        return 0.0
    ends = np.searchsorted(values, values + width, side="right")
    counts = ends - np.arange(len(values))
    best = int(counts.argmax())
    about_zero = int((np.abs(values) <= WINDOW * sigma).sum())
    most = int(counts[best])
    if most <= about_zero + 3 * np.sqrt(most):
        return 0.0
    middle = float(np.median(values[best : ends[best]]))
    for _ in range(3):  # the window's own edges are chosen by chance
        middle = float(np.median(values[np.abs(values - middle) <= width]))
    return middle


def _one_to_one(plot: Ints, look: Ints, share: Floats) -> Ints:
    """Pairs within the gate, by the least sum of squares; rows."""
    inside = np.flatnonzero((np.abs(share) <= 1).all(axis=1))
    cost = (share[inside] ** 2).sum(axis=1) - share.shape[1] - 1.0
    return inside[least_sum(plot[inside], look[inside], cost)]


def _false_per_look(ratio: Floats, sigma: Floats, gate: Floats, reach: float, looks: int) -> float:
    """Mean number of plots of nobody in gates that are displaced from where a target was."""
    if not looks or not len(ratio):
        return 0.0
    usual = float(np.median(sigma[np.isfinite(sigma)])) if np.isfinite(sigma).any() else 0.0
    rest: Bools = np.asarray((np.abs(ratio[:, 1:]) <= gate[1:]).all(axis=1))
    counts = [
        int((rest & (np.abs(ratio[:, 0] - offset * gate[0]) <= gate[0])).sum())
        for offset in OFFSETS
        if (abs(offset) + 1) * gate[0] * usual <= reach
    ]
    return float(np.mean(counts)) / looks if counts else 0.0


def _wanted(ratio: Floats, gate: float) -> float:
    """The gate that residuals ask for that lie within one."""
    if len(ratio) < 4:
        return gate
    spread = TO_NORMAL * float(np.median(np.abs(ratio - np.median(ratio))))
    return max(gate, GATE * spread) if spread > WIDER else gate


_NONE: Ints = np.zeros(0, np.int64)

"""OSPA(2) and T-GOSPA: how far whole tracks over a window of time are from whole flights.

OSPA(2): Beard, Vo and Vo, A solution for large-scale multi-object tracking, 2020. T-GOSPA as a
linear programme: Garcia-Fernandez, Rahmathullah and Svensson, A metric on the space of finite sets
of trajectories, 2020. Distances are (w, m, n) over w instants; `truth_there` is (w, m) and
`track_there` (w, n). A distance where one of the two is not there does not count.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_array, vstack

from plotfeed.models.scoring.set_metrics import set_score
from plotfeed.models.state import Bools, Floats, Ints


def ospa2_m(
    distances_m: Floats, truth_there: Bools, track_there: Bools, cutoff_m: float, order: float = 2.0
) -> float:
    """OSPA between flights and tracks, metres.

    The distance of two is the mean of min(d, c), over the instants at which either is there, where
    an instant of one alone counts as c.
    """
    flights, tracks = truth_there.any(axis=0), track_there.any(axis=0)
    truth_there, track_there = truth_there[:, flights], track_there[:, tracks]
    distances_m = distances_m[:, flights][:, :, tracks]
    both = truth_there[:, :, None] & track_there[:, None, :]
    either = truth_there[:, :, None] | track_there[:, None, :]
    each_m = np.where(both, np.fmin(distances_m, cutoff_m), cutoff_m) * either
    base_m = each_m.sum(axis=0) / np.maximum(either.sum(axis=0), 1)
    return set_score(base_m, cutoff_m, order).ospa_m


class TrajectoryScore(NamedTuple):
    """Parts of T-GOSPA over a window, as sums of p-th powers."""

    localisation: float
    missed: float
    false: float
    switching: float

    def t_gospa_m(self, order: float = 2.0) -> float:
        """T-GOSPA of the window, metres, of the order for which the parts are."""
        return float(sum(self) ** (1.0 / order))


def t_gospa(
    distances_m: Floats,
    truth_there: Bools,
    track_there: Bools,
    *,
    cutoff_m: float,
    order: float,
    switch_m: float,
    weights: Floats | None = None,
) -> TrajectoryScore:
    """T-GOSPA, by its linear programme.

    A switch of tracks costs s^p, a pairing that is lost or gained half of it. Pairs that are never
    within the cut-off save nothing and are left out; a flight and a track that have nobody else
    near are solved by themselves, step by step, which gives the same. Instants may count by
    `weights` (w,): those that windows share by a half.
    """
    weigh = np.ones(len(truth_there)) if weights is None else weights
    limit, change = cutoff_m**order, switch_m**order / 2
    both = truth_there[:, :, None] & track_there[:, None, :]
    costs = np.where(both, np.fmin(distances_m, cutoff_m) ** order, limit)
    rows, columns = np.nonzero((costs < limit).any(axis=0))
    costs = costs[:, rows, columns]
    alone = (np.bincount(rows)[rows] == 1) & (np.bincount(columns)[columns] == 1)
    saved = (costs - limit) * weigh[:, None]
    chosen = np.zeros_like(costs)
    chosen[:, alone] = _alone(saved[:, alone], change)
    if not alone.all():
        others = ~alone
        chosen[:, others] = _together(saved[:, others], rows[others], columns[others], change)
    near = chosen * (costs < limit)
    paired = near.sum(axis=1)
    return TrajectoryScore(
        float(weigh @ (near * costs).sum(axis=1)),
        limit / 2 * float(weigh @ (truth_there.sum(axis=1) - paired)),
        limit / 2 * float(weigh @ (track_there.sum(axis=1) - paired)),
        change * float(np.abs(np.diff(chosen, axis=0)).sum()),
    )


def _alone(saved: Floats, change: float) -> Floats:
    """Weights, 0 or 1, of pairs without rivals, (w, k): the cheapest way, from step to step."""
    steps, pairs = saved.shape
    off, on = np.zeros(pairs), saved[0].copy()
    was_on_if_off = np.zeros((steps, pairs), np.bool_)
    was_on_if_on = np.ones((steps, pairs), np.bool_)
    for k in range(1, steps):
        was_on_if_off[k] = on + change < off
        was_on_if_on[k] = on <= off + change
        off, on = (
            np.minimum(off, on + change),
            np.minimum(on, off + change) + saved[k],
        )
    is_on = on < off
    weights = np.zeros((steps, pairs))
    for k in range(steps - 1, -1, -1):
        weights[k] = is_on
        is_on = np.where(is_on, was_on_if_on[k], was_on_if_off[k])
    return weights


def _together(saved: Floats, rows: Ints, columns: Ints, change: float) -> Floats:
    """Weights of pairs, (w, k), that share flights or tracks: least cost, each used once."""
    steps, pairs = saved.shape
    size, moves = steps * pairs, (steps - 1) * pairs
    cells = np.arange(size).reshape(steps, pairs)
    used = []
    for whose in (rows, columns):
        _, numbers = np.unique(whose, return_inverse=True)
        count = int(numbers.max()) + 1
        at = (np.arange(steps)[:, None] * count + numbers).ravel()
        shape = (steps * count, size + moves)
        used.append(coo_array((np.ones(size), (at, cells.ravel())), shape=shape))
    ones, each = np.ones(moves), np.arange(moves)
    before, after = cells[:-1].ravel(), cells[1:].ravel()
    spans = [
        coo_array(
            (
                np.concatenate([sign * ones, -sign * ones, -ones]),
                (np.tile(each, 3), np.concatenate([after, before, size + each])),
            ),
            shape=(moves, size + moves),
        )
        for sign in (1.0, -1.0)
    ]
    limits = np.concatenate([np.ones(sum(part.shape[0] for part in used)), np.zeros(2 * moves)])
    found = linprog(
        np.concatenate([saved.ravel(), np.full(moves, change)]),
        A_ub=vstack([*used, *spans]).tocsr(),
        b_ub=limits,
        bounds=(0.0, None),
        method="highs",
    )
    weights: Floats = np.asarray(found.x[:size]).reshape(steps, pairs)
    return weights

"""Sums along the way of a Markov chain until it leaves, without a subtraction."""

from __future__ import annotations

import math

import numpy as np

from plotfeed.models.state import Floats


def until_left(steps: Floats, leaving: Floats, each: Floats) -> Floats:
    """Expected sum of `each`, (n,), over the states from a start in each until the chain leaves.

    `steps`, (n, n), lead from row to column, `leaving` out. What stays in a state is not asked for:
    1 less a chance of 1e-100 is 1, and a matrix of such is singular. Grassmann, Taksar and Heyman,
    Operations Research 33 (1985). Infinite where the chain cannot leave.
    """
    n = len(steps)
    a, out, total = steps.copy(), leaving.tolist(), each.tolist()
    away = [0.0] * n
    for k in reversed(range(n)):
        away[k] = out[k] + float(a[k, :k].sum())
        for i in range(k):
            share = a[i, k] / away[k] if a[i, k] and away[k] else 0.0
            a[i, :k] += share * a[k, :k]
            out[i] += share * out[k]
            total[i] = math.inf if a[i, k] and not away[k] else total[i] + share * total[k]
    found = np.empty(n)
    for k in range(n):
        met = sum((a[k, j] * found[j] for j in range(k) if a[k, j]), total[k])
        found[k] = met / away[k] if away[k] else math.inf
    return found

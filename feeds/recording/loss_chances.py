"""How improbable it is by chance that a link loses as many messages as it did."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from plotfeed.feeds.impairment.losses import LossChain
from plotfeed.models.tail_chances import Cumulants, p_of_whole

STEP = 1e-3


def p_of_losses(chain: LossChain, of: int, count: int) -> float:
    """Probability of so many losses among messages that a chain decided on in turn."""
    step, emissions = chain.steps, np.array(chain.emissions)

    def log_moment(t: float) -> float:
        tilt = 1 - emissions + emissions * math.exp(t)
        first, matrix, log, scale = chain.stationary * tilt, step * tilt, 0.0, 0.0
        vector, left = first, of - 1
        while left:
            if left & 1:
                vector = vector @ matrix
                size = float(vector.sum())
                vector, log = vector / size, log + math.log(size) + scale
            matrix = matrix @ matrix
            size = float(matrix.max())
            matrix, scale = matrix / size, 2 * scale + math.log(size)
            left >>= 1
        return log + math.log(float(vector.sum()))

    return p_of_whole(count, _by_differences(log_moment), of)


def _by_differences(log_moment: Callable[[float], float]) -> Callable[[float], Cumulants]:
    def cumulants(t: float) -> Cumulants:
        below, here, above = log_moment(t - STEP), log_moment(t), log_moment(t + STEP)
        return Cumulants(here, (above - below) / (2 * STEP), (above - 2 * here + below) / STEP**2)

    return cumulants

"""Slow drift: first-order Gauss-Markov processes that can be asked for any time, in any order.

Such a process has variance 1 and the correlation exp(-|dt|/tau). Far enough apart, at the anchors,
its values are independent; between two known values it is a bridge, of which the value in the
middle, h from either end, is normal of mean (a + b)/(2 cosh(h/tau)) and variance tanh(h/tau).
Halving again and again leads to every step. Each value has a draw of its own, by its step's number:
nothing depends on what was asked before, and nothing is cut off.
"""

from __future__ import annotations

from functools import lru_cache
from math import ceil, cosh, log2, sqrt, tanh

import numpy as np

from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.state import Floats, Ints

INDEPENDENT = 64.0
"""Time constants between anchors: what they would have in common is exp(-64), 2e-28."""


class Drift:
    """Several independent processes at once, constant within steps of time."""

    def __init__(self, chance: Chance, *, step_ns: int, time_constant_ns: float, n: int) -> None:
        self._chance = chance
        self._step_ns = step_ns
        self._steps = step_ns / time_constant_ns  # of time, in time constants
        self._halvings = max(ceil(log2(INDEPENDENT / self._steps)), 0)
        self._n = n
        self._value_at = lru_cache(maxsize=64)(self._value)

    def at(self, t_utc_ns: Ints) -> Floats:
        """Values at times (m,); (m, n)."""
        steps, place = np.unique(t_utc_ns // self._step_ns, return_inverse=True)
        values = [self._value_at(step) for step in steps.tolist()]
        return np.array(values).reshape(-1, self._n)[place]

    def _value(self, step: int) -> Floats:
        low = step >> self._halvings << self._halvings
        if step == low:
            return self._draw(step)
        width = 1 << self._halvings
        at_low, at_high = self._value_at(low), self._value_at(low + width)
        while step != low:
            width //= 2
            h = width * self._steps
            middle = (at_low + at_high) / (2 * cosh(h)) + sqrt(tanh(h)) * self._draw(low + width)
            if step < low + width:
                at_high = middle
            else:
                low, at_low = low + width, middle
        return at_low

    def _draw(self, step: int) -> Floats:
        return self._chance.rng(Purpose.DRIFT, step).standard_normal(self._n)

"""Numerics that equations share: no floating-point warnings where the contract says NaN."""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.state import Floats, Ints

P = ParamSpec("P")
R = TypeVar("R")

_warnings_are_off: ContextVar[bool] = ContextVar("_warnings_are_off", default=False)


def nan_without_warnings(equation: Callable[P, R]) -> Callable[P, R]:
    """Keep NumPy from warning within an equation, which says by NaN where it has no answer.

    Within another such one nothing has to be done: NumPy's own switch takes as long as the
    arithmetic of ten targets.
    """

    @wraps(equation)
    def without_warnings(*args: P.args, **kwargs: P.kwargs) -> R:
        if _warnings_are_off.get():
            return equation(*args, **kwargs)
        token = _warnings_are_off.set(True)
        try:
            with np.errstate(all="ignore"):
                return equation(*args, **kwargs)
        finally:
            _warnings_are_off.reset(token)

    return without_warnings


def as_floats(value: ArrayLike) -> Floats:
    """A number, a list or an array as float64; an array that is so already is not copied."""
    return np.asarray(value, dtype=np.float64)


@cache
def unit_interval(points: int = 128) -> tuple[Floats, Floats]:
    """Gauss and Legendre's nodes in (0, 1) and their weights, of sum 1; (n,) each.

    Nodes are kept: they take 30 ms to find, more than any integral that is done with them.
    """
    nodes, weights = np.polynomial.legendre.leggauss(points)
    found = (nodes + 1) / 2, weights / 2
    for array in found:
        array.flags.writeable = False
    return found


def root(function: Callable[[float], float], low: float, high: float) -> float:
    """Where a continuous function is zero between two numbers, by Brent's method, to 1e-12.

    Raises ValueError where its values at both have one sign, or one of them is NaN, and where 100
    steps do not suffice. After R. P. Brent, Algorithms for Minimization without Derivatives, 1973,
    chapter 4, to the bits of SciPy's brentq, which takes as long to load as all that is solved.
    """
    (x_before, f_before), (x, f) = ((end, function(end)) for end in (low, high))
    if f_before == 0:
        return x_before
    if not (f_before < 0 <= f or f <= 0 < f_before):
        raise ValueError("no change of sign")
    x_across = f_across = step_before = step = 0.0
    for _ in range(100):
        if (f_before < 0) != (f < 0) and f:  # the zero is between these two
            x_across, f_across = x_before, f_before
            step_before = step = x - x_before
        if abs(f_across) < abs(f):
            x_before, x, x_across = x, x_across, x
            f_before, f, f_across = f, f_across, f
        near, half = (1e-12 + 1e-14 * abs(x)) / 2, (x_across - x) / 2
        if f == 0 or abs(half) < near:
            return x
        tried = np.inf
        if abs(step_before) > near and abs(f) < abs(f_before):
            tried = _interpolated(x, f, (x_before, f_before), (x_across, f_across))
        if 2 * abs(tried) < min(abs(step_before), 3 * abs(half) - near):
            step_before, step = step, tried
        else:
            step_before = step = half
        x_before, f_before = x, f
        x += step if abs(step) > near else float(np.copysign(near, half))
        f = function(x)
    raise ValueError("not found in 100 steps")


def _interpolated(
    x: float, f: float, before: tuple[float, float], across: tuple[float, float]
) -> float:
    """The step from x to where a line, or an inverse parabola, by the values at hand is zero."""
    (x_before, f_before), (x_across, f_across) = before, across
    if x_before == x_across:
        return -f * (x - x_before) / (f - f_before)
    slope = (f_before - f) / (x_before - x)
    slope_across = (f_across - f) / (x_across - x)
    divisor = slope_across * slope * (f_across - f_before)
    return -f * (f_across * slope_across - f_before * slope) / divisor if divisor else np.inf


def joined_by_pairs(first: Ints, second: Ints, n: int) -> tuple[int, Ints]:
    """How many sets n things make of which these pairs belong together, and the set of each."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links: Any = coo_array((np.ones(len(first), np.bool_), (first, second)), shape=(n, n))
    m, label = connected_components(links, directed=False)
    return m, np.asarray(label, np.int64)

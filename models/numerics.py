"""Numerics that equations share: no floating-point warnings where the contract says NaN."""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar
from functools import cache, wraps
from typing import ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.state import Floats

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

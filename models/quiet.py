"""Equations without floating-point warnings: what has no answer is NaN or infinite, by contract."""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar
from functools import wraps
from typing import ParamSpec, TypeVar

import numpy as np

P = ParamSpec("P")
R = TypeVar("R")

_is_quiet: ContextVar[bool] = ContextVar("_is_quiet", default=False)


def quiet(equation: Callable[P, R]) -> Callable[P, R]:
    """The same without warnings.

    Within another quiet one nothing has to be done for that: NumPy's own switch takes as long as
    the arithmetic of ten targets.
    """

    @wraps(equation)
    def quietly(*args: P.args, **kwargs: P.kwargs) -> R:
        if _is_quiet.get():
            return equation(*args, **kwargs)
        token = _is_quiet.set(True)
        try:
            with np.errstate(all="ignore"):
                return equation(*args, **kwargs)
        finally:
            _is_quiet.reset(token)

    return quietly

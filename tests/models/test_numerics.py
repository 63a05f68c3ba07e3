"""Equations say nothing of what has no answer; whoever calls them keeps his own warnings."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from plotfeed.models.numerics import nan_without_warnings, root

ZERO = np.zeros(1)


@nan_without_warnings
def inner() -> np.float64:
    return (ZERO / ZERO)[0]


@nan_without_warnings
def outer(fails: bool = False) -> np.float64:
    found = inner() + (ZERO / ZERO)[0]  # quiet still, after the inner one
    if fails:
        raise ValueError("no")
    return found


@pytest.mark.filterwarnings("error")
def test_nothing_is_said_within_and_everything_outside_again() -> None:
    with np.errstate(all="raise"):
        assert np.isnan(outer())
        with pytest.raises(FloatingPointError):
            _ = ZERO / ZERO
        with pytest.raises(ValueError, match="no"):
            outer(fails=True)
        with pytest.raises(FloatingPointError):
            _ = ZERO / ZERO
        assert np.isnan(inner())
    with pytest.raises(RuntimeWarning):
        _ = ZERO / ZERO


def test_it_keeps_its_name_and_words() -> None:
    assert inner.__name__ == "inner"


@pytest.mark.parametrize("steep", [0.1, 1.0, 50.0])
@pytest.mark.parametrize("at", [-4.0, 0.1, 9.0])
def test_a_root_is_scipys_to_the_bit(at: float, steep: float) -> None:
    for curve in (np.tanh, lambda x: np.exp(x / 50) - 1, lambda x: np.clip(x + 0.5, 0, 1) - 0.3):
        found = root(lambda x, curve=curve: float(curve(steep * (x - at))), -10.0, 10.0)
        args = (-10.0, 10.0)
        assert found == brentq(
            lambda x, curve=curve: curve(steep * (x - at)), *args, xtol=1e-12, rtol=1e-14
        )


@pytest.mark.parametrize("level", [1.0, -1.0, np.nan])
def test_what_has_no_root_is_refused(level: float) -> None:
    with pytest.raises(ValueError, match="sign"):
        root(lambda _: level, 0.0, 1.0)

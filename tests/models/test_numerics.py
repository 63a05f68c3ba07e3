"""Equations say nothing of what has no answer; whoever calls them keeps his own warnings."""

from __future__ import annotations

import numpy as np
import pytest

from plotfeed.models.numerics import nan_without_warnings

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

"""Gauss-Markov drift: its covariance to the last digits, its law, and its memory of nothing."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.effects.readings import Drift
from plotfeed.models.state import Floats

S = 1_000_000_000


class Axes:
    """In the place of chance: each draw is an axis of its own, so that values are coefficients."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.axes: dict[int, int] = {}

    def rng(self, _purpose: Purpose, step: int) -> Axes:
        self.step = step
        return self

    def standard_normal(self, n: int) -> Floats:
        axis = self.axes.setdefault(self.step, len(self.axes))
        return np.eye(n)[axis]


def coefficients(steps: list[int], steps_a_constant: float, n: int = 400) -> Floats:
    axes: Any = Axes(n)
    drift = Drift(axes, step_ns=S, time_constant_ns=steps_a_constant * S, n=n)
    return drift.at(np.array(steps, np.int64) * S)


@pytest.mark.parametrize("steps_a_constant", [0.01, 0.5, 3.0, 10.0, 600.0, 1e6])
def test_the_covariance_is_that_of_gauss_and_markov_to_the_last_digits(
    steps_a_constant: float,
) -> None:
    spread = np.unique(np.round(np.geomspace(1, 30 * steps_a_constant + 20, 12)).astype(int))
    steps = [*range(8), *(1_700_000_000 + spread).tolist()]
    value = coefficients(steps, steps_a_constant)
    lags = np.abs(np.subtract.outer(steps, steps))
    covariance = np.exp(-lags / steps_a_constant)
    np.testing.assert_allclose(value @ value.T, covariance, rtol=0, atol=3e-15)


steps = st.integers(0, 9_000_000_000)


@given(st.lists(steps, min_size=1, max_size=6), st.floats(1.0, 1e4), st.integers(0, 999))
def test_the_same_comes_in_any_order_and_company(
    asked: list[int], steps_a_constant: float, seed: int
) -> None:
    def drift() -> Drift:
        chance = Chance(5, "radar")
        return Drift(chance, step_ns=S, time_constant_ns=steps_a_constant * S, n=2)

    alone = {step: drift().at(np.array([step * S]))[0].tolist() for step in asked}
    shuffled = asked * 2
    random.Random(seed).shuffle(shuffled)  # noqa: S311
    one = drift()
    for step in shuffled:
        assert one.at(np.array([step * S]))[0].tolist() == alone[step]
    together = drift().at(np.array(shuffled, np.int64) * S)
    assert together.tolist() == [alone[step] for step in shuffled]


def test_within_a_step_it_stands_still() -> None:
    drift = Drift(Chance(5, "radar"), step_ns=S, time_constant_ns=60 * S, n=2)
    values = drift.at(np.array([7 * S, 7 * S + 1, 8 * S - 1, 8 * S]))
    assert values[0].tolist() == values[1].tolist() == values[2].tolist()
    assert values[3].tolist() != values[2].tolist()


def test_a_week_later_and_at_the_end_of_time_there_is_a_value() -> None:
    drift = Drift(Chance(5, "radar"), step_ns=20_000_000, time_constant_ns=1e9 * S, n=2)
    assert np.isfinite(drift.at(np.array([0, 7 * 86_400 * S, (1 << 63) - 1]))).all()

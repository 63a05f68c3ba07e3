"""Whole configurations: what adds, what lies on the front, and what goes with what."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.lab.chart import MeasuredMethod, MeasuredStage, configurations, on_front
from plotfeed.feeds.lab.charted import Method, Time, share_of_own

numbers = st.lists(st.tuples(st.floats(0, 1e6), st.floats(0, 1e6)), min_size=1, max_size=40).map(
    np.array
)


@dataclass
class Choice:
    name: str
    ns: float
    errors: dict[str, float] = field(default_factory=dict)
    more: dict[str, Any] = field(default_factory=dict)


def stage(name: str, *choices: Choice) -> MeasuredStage:
    measured = [
        MeasuredMethod(
            method=Method(
                name=choice.name, run=lambda: None, units=1, errors=choice.errors, **choice.more
            ),
            time=Time(choice.ns, choice.ns, choice.ns),
            share=0.0,
        )
        for choice in choices
    ]
    return MeasuredStage(name=name, question="", methods=tuple(measured), front=())


OURS = {"ours": True}


@given(numbers)
def test_nothing_on_the_front_is_beaten_and_everything_else_is(points: np.ndarray) -> None:
    costs, shares = points.T
    front = set(on_front(costs, shares).tolist())
    for i in range(len(points)):
        equal = (costs == costs[i]) & (shares == shares[i])
        beaten = ((costs <= costs[i]) & (shares <= shares[i]) & ~equal).any()
        assert beaten or front & set(np.flatnonzero(equal).tolist())
        assert not (i in front and beaten)


def test_the_front_goes_from_the_cheapest_to_the_best() -> None:
    assert on_front(np.array([3.0, 1.0, 2.0]), np.array([0.0, 9.0, 9.0])).tolist() == [1, 0]


def test_costs_add_and_errors_add_in_quadrature() -> None:
    stages = [
        stage("a", Choice("x", 10, {"range_m": 3.0}, OURS)),
        stage("b", Choice("y", 5, {"range_m": 4.0, "pd": 0.5}, OURS)),
    ]
    found = configurations(stages, {"range_m": 10.0, "pd": 2.0})
    assert found.scene.ns == 15
    assert found.scene.errors == {"range_m": 5.0, "pd": 0.5}
    assert found.scene.share == 0.5
    assert found.shares.tolist() == [0.5]
    assert found.cheapest is None


def test_the_cheapest_is_the_cheapest_that_adds_little() -> None:
    frames = stage(
        "frames",
        Choice("wrong", 1, {"range_m": 5.0}),
        Choice("good", 3, {"range_m": 0.05}),
        Choice("best", 9, {}, OURS),
    )
    found = configurations([frames], {"range_m": 1.0})
    assert found.cheapest is not None
    assert found.cheapest.names == {"frames": "good"}
    assert [c.names["frames"] for c in found.front] == ["wrong", "good", "best"]
    assert found.scene.names == {"frames": "best"}


def test_of_several_formats_costs_add_and_the_coarsest_counts() -> None:
    formats = stage(
        "encoding",
        Choice("fine", 5, {"range_m": 0.1}, OURS),
        Choice("coarse", 2, {"range_m": 2.0}, OURS),
    )
    found = configurations([formats], {"range_m": 1.0})
    assert found.scene.names == {"encoding": "fine and coarse"}
    assert found.scene.ns == 7
    assert found.scene.share == 2.0


def test_without_a_ratio_nothing_is_done_that_needs_one() -> None:
    stages = [
        stage(
            "propagation",
            Choice("gate", 1, {}, {"gives_ratio": False}),
            Choice("free", 5, {}, OURS),
        ),
        stage("errors", Choice("drawn", 5, {}, OURS | {"needs_ratio": True}), Choice("floor", 1)),
    ]
    found = configurations(stages, {})
    assert sorted(found.ns.tolist()) == [2, 6, 10]


def test_an_error_where_the_sensor_has_none_is_beyond_all_measure() -> None:
    assert share_of_own({"range_m": 1e-9}, {"range_m": 0.0}) == np.inf
    assert share_of_own({"range_m": 0.0}, {"range_m": 0.0}) == 0
    assert share_of_own({"range_m": 1.0, "pd": 1.0}, {"range_m": 4.0, "pd": 2.0}) == 0.5
    stages = [stage("a", Choice("x", 1, {"range_m": 1.0}, OURS))]
    assert configurations(stages, {"range_m": 0.0}).shares.tolist() == [np.inf]


def test_configurations_of_nothing_are_one() -> None:
    found = configurations([], {"pd": 1.0})
    assert found.ns.tolist() == [0.0]
    assert found.scene.share == pytest.approx(0)

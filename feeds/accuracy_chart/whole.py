"""Whole configurations: an alternative of every stage. Costs add, errors add in quadrature."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from plotfeed.feeds.accuracy_chart.stage import Alternative, Time, share_of_own
from plotfeed.models.state import Bools, Floats, Ints

LITTLE = 0.1
"""The share of the sensor's own error below which what is added does not matter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredMethod:
    """An alternative with its cost, and its largest error beside the sensor's own."""

    alternative: Alternative
    time: Time
    share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredStage:
    """All ways of one stage; `front` has the rows of those that none beats in cost and error."""

    name: str
    question: str
    ways: tuple[MeasuredMethod, ...]
    front: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Configuration:
    """Names by stage, nanoseconds per target-scan, errors by quantity and their largest share."""

    names: Mapping[str, str]
    ns: float
    errors: Mapping[str, float]
    share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Configurations:
    """All of them as points, the front, what the scene has, and the cheapest that is good enough.

    `cheapest` is None where none is.
    """

    ns: Floats
    shares: Floats
    front: tuple[Configuration, ...]
    scene: Configuration
    cheapest: Configuration | None


def on_front(costs: Floats, shares: Floats) -> Ints:
    """Those than which none is both cheaper and better, cheapest first; rows."""
    order = np.lexsort((shares, costs))
    best_before = np.minimum.accumulate(np.concatenate([[np.inf], shares[order]]))[:-1]
    return order[shares[order] < best_before]


def configurations(stages: Sequence[MeasuredStage], own: Mapping[str, float]) -> Configurations:
    """Every combination of the stages' ways that makes sense."""
    shape = tuple(len(stage.ways) for stage in stages)
    ns = np.zeros(shape)
    squares = {name: np.zeros(shape) for name in own}
    for axis, stage in enumerate(stages):
        ns += _along(axis, shape, [way.time.median_ns for way in stage.ways])
        for name in own:
            errors = [way.alternative.errors.get(name, 0.0) for way in stage.ways]
            squares[name] += _along(axis, shape, errors) ** 2
    shares = np.zeros(shape)
    for name in own:
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.sqrt(squares[name]) / own[name]
        shares = np.maximum(shares, np.nan_to_num(share, nan=0.0, posinf=np.inf))
    possible = np.flatnonzero(_possible(stages, shape))
    ns_of, shares_of = ns.ravel()[possible], shares.ravel()[possible]

    def described(row: int) -> Configuration:
        rows = np.unravel_index(possible[row], shape)
        ways = [stage.ways[int(i)] for stage, i in zip(stages, rows, strict=True)]
        return _configuration(stages, [[way] for way in ways], own)

    enough = np.flatnonzero(shares_of < LITTLE)
    return Configurations(
        ns=ns_of,
        shares=shares_of,
        front=tuple(described(row) for row in on_front(ns_of, shares_of).tolist()),
        scene=_configuration(
            stages, [[way for way in s.ways if way.alternative.ours] for s in stages], own
        ),
        cheapest=described(int(enough[np.argmin(ns_of[enough])])) if len(enough) else None,
    )


def _along(axis: int, shape: tuple[int, ...], values: Sequence[float]) -> Floats:
    """Values that lie along one axis, to be added to an array of that shape."""
    return np.reshape(values, [-1 if i == axis else 1 for i in range(len(shape))])


def _possible(stages: Sequence[MeasuredStage], shape: tuple[int, ...]) -> Bools:
    """Nothing that needs a signal-to-noise ratio follows what gives none."""
    gives, needs = np.ones(shape, np.bool_), np.zeros(shape, np.bool_)
    for axis, stage in enumerate(stages):
        gives &= _along(axis, shape, [way.alternative.gives_ratio for way in stage.ways]) > 0
        needs |= _along(axis, shape, [way.alternative.needs_ratio for way in stage.ways]) > 0
    return gives | ~needs


def _configuration(
    stages: Sequence[MeasuredStage],
    chosen: Sequence[Sequence[MeasuredMethod]],
    own: Mapping[str, float],
) -> Configuration:
    """Of one or more ways a stage: of several formats all the costs, and the larger errors."""
    squares: dict[str, float] = {}
    for ways in chosen:
        for name in {name for way in ways for name in way.alternative.errors}:
            error = max(way.alternative.errors.get(name, 0.0) for way in ways)
            squares[name] = squares.get(name, 0.0) + error**2
    errors = {name: squares[name] ** 0.5 for name in own if name in squares}
    return Configuration(
        names={
            stage.name: " and ".join(way.alternative.name for way in ways)
            for stage, ways in zip(stages, chosen, strict=True)
        },
        ns=sum(way.time.median_ns for ways in chosen for way in ways),
        errors=errors,
        share=share_of_own(errors, own),
    )

"""A chart of a scene: all stages measured for each sensor, and whole configurations of methods."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from plotfeed.feeds.lab.charted import (
    Case,
    ChartStage,
    Effort,
    Method,
    Time,
    case_of,
    flown,
    in_turns,
    share_of_own,
    targets_at,
)
from plotfeed.feeds.lab.methods import (
    beam_stage,
    detection_stage,
    encoding_stage,
    errors_stage,
    false_alarms_stage,
    frames_stage,
    propagation_stage,
)
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.state import Bools, Floats, Ints

STAGES: tuple[Callable[[Case], ChartStage | None], ...] = (
    beam_stage,
    frames_stage,
    propagation_stage,
    detection_stage,
    errors_stage,
    false_alarms_stage,
    encoding_stage,
)
"""In the order in which they are done."""
SEED = 1
"""Of where targets are."""
LITTLE = 0.1
"""The share of the sensor's own error below which what is added does not matter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredMethod:
    """A method with its cost, and its largest error beside the sensor's own."""

    method: Method
    time: Time
    share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredStage:
    """All methods of one stage; `front` has the rows of those that none beats in cost and error."""

    name: str
    question: str
    methods: tuple[MeasuredMethod, ...]
    front: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Configuration:
    """Methods by stage, nanoseconds per target-scan, errors by quantity, their largest share."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartedSensor:
    """What was measured of one sensor; `own` has its own errors by quantity."""

    name: str
    type: str
    own: Mapping[str, float]
    stages: tuple[MeasuredStage, ...]
    batches: Mapping[int, Time]
    whole: Configurations


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """What was measured of a scene; `unseen` are sensors that detect none of its drones."""

    scene: str
    effort: Effort
    sensors: tuple[ChartedSensor, ...]
    unseen: tuple[str, ...]


def charted(scene: Scene, effort: Effort) -> Chart:
    """Measure; raises `PlotfeedError` if a flight of the scene cannot be flown."""
    rng = np.random.default_rng(SEED)
    flights = flown(scene, effort.pool, rng)
    cases = {s.id: case_of(scene, s, flights, effort, rng) for s in scene.sensor}
    return Chart(
        scene=scene.scene.name,
        effort=effort,
        sensors=tuple(_charted(case) for case in cases.values() if case is not None),
        unseen=tuple(name for name, case in cases.items() if case is None),
    )


def _charted(case: Case) -> ChartedSensor:
    stages = _measured(case, [stage for make in STAGES if (stage := make(case)) is not None])
    return ChartedSensor(
        name=case.sensor.id,
        type=case.sensor.type,
        own=case.own,
        stages=stages,
        batches=_batches(case),
        whole=configurations(stages, case.own),
    )


def _measured(case: Case, stages: list[ChartStage]) -> tuple[MeasuredStage, ...]:
    """The methods of all stages timed in turns."""
    methods = [method for stage in stages for method in stage.methods]
    turns_ns = _turns_ns(case, [method.run for method in methods])
    each = [
        MeasuredMethod(
            method=method,
            time=Time.of(column / method.units),
            share=share_of_own(method.errors, case.own),
        )
        for method, column in zip(methods, turns_ns.T, strict=True)
    ]
    ends = np.cumsum([0, *(len(stage.methods) for stage in stages)]).tolist()
    return tuple(
        MeasuredStage(
            name=stage.name,
            question=stage.question,
            methods=tuple(each[start:end]),
            front=tuple(
                on_front(
                    np.array([m.time.median_ns for m in each[start:end]]),
                    np.array([m.share for m in each[start:end]]),
                ).tolist()
            ),
        )
        for stage, (start, end) in zip(stages, pairwise(ends), strict=True)
    )


def _batches(case: Case) -> dict[int, Time]:
    """Nanoseconds per target-scan of the sensor's model, by the number of targets at once.

    From where they are seen to what is measured of those that are detected: nearly all of them.
    """
    rng, sizes = case.rng, case.effort.batches
    calls = []
    for n in sizes:
        some = case.seen.drawn(rng.integers(0, len(case.seen), n))
        targets = targets_at(some, case.frame, case.signatures)
        calls.append(partial(case.model.observe, targets, rng))
    each_ns = _turns_ns(case, calls) / np.array(sizes)
    return {n: Time.of(column) for n, column in zip(sizes, each_ns.T, strict=True)}


def _turns_ns(case: Case, calls: Sequence[Callable[[], object]]) -> Floats:
    return in_turns(calls, rounds=case.effort.rounds, seconds=case.effort.seconds)


def on_front(costs: Floats, shares: Floats) -> Ints:
    """Rows of those than which none is both cheaper and better, cheapest first."""
    order = np.lexsort((shares, costs))
    best_before = np.minimum.accumulate(np.concatenate([[np.inf], shares[order]]))[:-1]
    return order[shares[order] < best_before]


def configurations(stages: Sequence[MeasuredStage], own: Mapping[str, float]) -> Configurations:
    """Every combination of the stages' methods that makes sense."""
    shape = tuple(len(stage.methods) for stage in stages)
    ns = np.zeros(shape)
    squares = {name: np.zeros(shape) for name in own}
    for axis, stage in enumerate(stages):
        ns += _along(axis, shape, [m.time.median_ns for m in stage.methods])
        for name in own:
            errors = [m.method.errors.get(name, 0.0) for m in stage.methods]
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
        chosen = [[stage.methods[int(i)]] for stage, i in zip(stages, rows, strict=True)]
        return _configuration(stages, chosen, own)

    enough = np.flatnonzero(shares_of < LITTLE)
    ours = [[m for m in stage.methods if m.method.ours] for stage in stages]
    return Configurations(
        ns=ns_of,
        shares=shares_of,
        front=tuple(described(row) for row in on_front(ns_of, shares_of).tolist()),
        scene=_configuration(stages, ours, own),
        cheapest=described(int(enough[np.argmin(ns_of[enough])])) if len(enough) else None,
    )


def _along(axis: int, shape: tuple[int, ...], values: Sequence[float]) -> Floats:
    """Values that lie along one axis, to be added to an array of that shape."""
    return np.reshape(values, [-1 if i == axis else 1 for i in range(len(shape))])


def _possible(stages: Sequence[MeasuredStage], shape: tuple[int, ...]) -> Bools:
    """Nothing that needs a signal-to-noise ratio follows what gives none."""
    gives, needs = np.ones(shape, np.bool_), np.zeros(shape, np.bool_)
    for axis, stage in enumerate(stages):
        gives &= _along(axis, shape, [m.method.gives_ratio for m in stage.methods]) > 0
        needs |= _along(axis, shape, [m.method.needs_ratio for m in stage.methods]) > 0
    return gives | ~needs


def _configuration(
    stages: Sequence[MeasuredStage],
    chosen: Sequence[Sequence[MeasuredMethod]],
    own: Mapping[str, float],
) -> Configuration:
    """One or more methods a stage: of several formats all the costs, and the larger errors."""
    squares: dict[str, float] = {}
    for methods in chosen:
        for name in {name for m in methods for name in m.method.errors}:
            error = max(m.method.errors.get(name, 0.0) for m in methods)
            squares[name] = squares.get(name, 0.0) + error**2
    errors = {name: squares[name] ** 0.5 for name in own if name in squares}
    return Configuration(
        names={
            stage.name: " and ".join(m.method.name for m in methods)
            for stage, methods in zip(stages, chosen, strict=True)
        },
        ns=sum(m.time.median_ns for methods in chosen for m in methods),
        errors=errors,
        share=share_of_own(errors, own),
    )

"""Everything that a chart shows of a scene: measured, and as plain values for JSON and tables."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.accuracy_chart.case import Case, case_of
from plotfeed.feeds.accuracy_chart.sample import flown, targets_at
from plotfeed.feeds.accuracy_chart.stage import ChartStage, Effort, Time, in_turns, share_of_own
from plotfeed.feeds.accuracy_chart.stage_beam import beam
from plotfeed.feeds.accuracy_chart.stage_detection import detection_stage
from plotfeed.feeds.accuracy_chart.stage_encoding import encoding
from plotfeed.feeds.accuracy_chart.stage_errors import errors
from plotfeed.feeds.accuracy_chart.stage_false_alarms import false_alarms
from plotfeed.feeds.accuracy_chart.stage_frames import frames
from plotfeed.feeds.accuracy_chart.stage_propagation import propagation_stage
from plotfeed.feeds.accuracy_chart.whole import (
    Configuration,
    Configurations,
    MeasuredMethod,
    MeasuredStage,
    configurations,
    on_front,
)
from plotfeed.feeds.scene.scene import Scene

STAGES: tuple[Callable[[Case], ChartStage | None], ...] = (
    beam,
    frames,
    propagation_stage,
    detection_stage,
    errors,
    false_alarms,
    encoding,
)
"""In the order in which they are done."""
SEED = 1
"""Of where targets are."""


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
class Charted:
    """What was measured of a scene; `unseen` are sensors that detect none of its drones."""

    scene: str
    effort: Effort
    sensors: tuple[ChartedSensor, ...]
    unseen: tuple[str, ...]


def charted(scene: Scene, effort: Effort) -> Charted:
    """Measure; raises `PlotfeedError` if a flight of the scene cannot be flown."""
    rng = np.random.default_rng(SEED)
    states = flown(scene, effort.pool, rng)
    cases = {s.id: case_of(scene, s, states, effort, rng) for s in scene.sensor}
    return Charted(
        scene=scene.scene.name,
        effort=effort,
        sensors=tuple(_charted(case) for case in cases.values() if case is not None),
        unseen=tuple(name for name, case in cases.items() if case is None),
    )


def _charted(case: Case) -> ChartedSensor:
    stages = measured(case, [stage for make in STAGES if (stage := make(case)) is not None])
    return ChartedSensor(
        name=case.sensor.id,
        type=case.sensor.type,
        own=case.own,
        stages=stages,
        batches=batches(case),
        whole=configurations(stages, case.own),
    )


def measured(case: Case, stages: list[ChartStage]) -> tuple[MeasuredStage, ...]:
    """The ways of all stages timed in turns."""
    ways = [way for stage in stages for way in stage.alternatives]
    turns_ns = in_turns(
        [way.run for way in ways], rounds=case.effort.rounds, seconds=case.effort.seconds
    )
    each = [
        MeasuredMethod(
            alternative=way,
            time=Time.of(column / way.units),
            share=share_of_own(way.errors, case.own),
        )
        for way, column in zip(ways, turns_ns.T, strict=True)
    ]
    ends = np.cumsum([0, *(len(stage.alternatives) for stage in stages)]).tolist()
    return tuple(
        _measured_stage(stage, each[start:end])
        for stage, (start, end) in zip(stages, pairwise(ends), strict=True)
    )


def _measured_stage(stage: ChartStage, ways: list[MeasuredMethod]) -> MeasuredStage:
    front = on_front(
        np.array([way.time.median_ns for way in ways]), np.array([way.share for way in ways])
    )
    return MeasuredStage(
        name=stage.name, question=stage.question, ways=tuple(ways), front=tuple(front.tolist())
    )


def as_values(chart: Charted) -> dict[str, Any]:
    """The same for JSON: all that the table has, and the front of whole configurations."""
    return {
        "scene": chart.scene,
        "machine": machine(),
        "targets": chart.effort.targets,
        "rounds": chart.effort.rounds,
        "sensors": [_sensor_values(sensor) for sensor in chart.sensors],
        "unseen": list(chart.unseen),
    }


def machine() -> dict[str, Any]:
    """Where the times are from."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": platform.system(),
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "scipy": version("scipy"),
    }


def _processor() -> str:
    """What the machine says that it is."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _sensor_values(sensor: ChartedSensor) -> dict[str, Any]:
    return {
        "id": sensor.name,
        "type": sensor.type,
        "own": dict(sensor.own),
        "stages": [
            {
                "stage": stage.name,
                "question": stage.question,
                "methods": [
                    _method_values(way, on_front=i in stage.front)
                    for i, way in enumerate(stage.ways)
                ],
            }
            for stage in sensor.stages
        ],
        "batches": [{"targets": n, "ns": _time_values(t)} for n, t in sensor.batches.items()],
        "configurations": {
            "scene": _configuration_values(sensor.whole.scene),
            "cheapest": _configuration_values(sensor.whole.cheapest),
            "front": [_configuration_values(c) for c in sensor.whole.front],
            "all": len(sensor.whole.ns),
        },
    }


def _method_values(way: MeasuredMethod, *, on_front: bool) -> dict[str, Any]:
    return {
        "method": way.alternative.name,
        "ns": _time_values(way.time),
        "errors": dict(way.alternative.errors),
        "share": _finite(way.share),
        "ours": way.alternative.ours,
        "on_front": on_front,
    }


def _time_values(time: Time) -> dict[str, float]:
    return {"median": time.median_ns, "low": time.low_ns, "high": time.high_ns}


def _configuration_values(found: Configuration | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "methods": dict(found.names),
        "ns": found.ns,
        "errors": dict(found.errors),
        "share": _finite(found.share),
    }


def _finite(share: float) -> float | None:
    """JSON has no infinity: of an error where the sensor itself has none."""
    return share if np.isfinite(share) else None


def batches(case: Case) -> dict[int, Time]:
    """Nanoseconds per target-scan of the sensor's model, by the number of targets at once.

    From where they are seen to what is measured of those that are detected: nearly all of them.
    """
    rng, sizes = case.rng, case.effort.batches
    calls = []
    for n in sizes:
        some = case.seen.drawn(rng.integers(0, len(case.seen), n))
        targets = targets_at(some, case.frame, case.flown.signatures)
        calls.append(partial(case.model.observe, targets, rng))
    turns_ns = in_turns(calls, rounds=case.effort.rounds, seconds=case.effort.seconds)
    each_ns = turns_ns / np.array(sizes)
    return {n: Time.of(column) for n, column in zip(sizes, each_ns.T, strict=True)}

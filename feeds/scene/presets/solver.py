"""The values of a preset's derived keys: plain rules applied."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from plotfeed.feeds.scene.fields import Site
from plotfeed.feeds.scene.presets.rules import (
    AnyRule,
    Goal,
    PlainRule,
    PresetTarget,
    Solve,
    targets,
)
from plotfeed.feeds.scene.sensors import Sensor, sensor_of
from plotfeed.proto.errors import PlotfeedError

SITE = Site(latitude_deg=0.0, longitude_deg=0.0, height_m=0.0)
"""What a sensor predicts of a target does not depend on where on Earth both are."""
MARGIN = 1e-9
"""By how much a goal is overshot, so that rounding does not leave the model below it."""
BRACKETS = {"_w": (1e-9, 1e9), "_db": (-200.0, 200.0), "_deg": (0.0, 90.0), "_m": (0.0, 1e4)}
"""Where the value of a key of that unit is looked for."""


def derive(
    kind: str, given: Mapping[str, Any], rules: Mapping[str, AnyRule], target: PresetTarget
) -> dict[str, Any]:
    """The values of the rules' keys, for a sensor of that type.

    Plain rules go first, in their order, because solving takes a whole sensor; then what is solved
    for, in its order, so that an error floor is found at the power that was found before it.
    """
    derived: dict[str, Any] = {}
    for key, rule in rules.items():
        if isinstance(rule, PlainRule):
            derived[key] = rule.value({**given, **derived})
    solves = {key: rule for key, rule in rules.items() if isinstance(rule, Solve)}
    if not solves:
        return derived
    # Something that a scene may say, until it is found.
    start = {key: max(_bracket(key)[0], 0.0) for key in solves}
    sensor = sensor_of({**given, **derived, **start, "type": kind, "id": "preset"})
    for key, rule in solves.items():
        derived[key] = _solved(sensor, key, rule.solve, target)
        sensor = sensor.model_copy(update={key: derived[key]})
    return derived


def predicted(sensor: Sensor, target: PresetTarget, quantity: str) -> float:
    """One quantity of what the sensor's model predicts of the target."""
    prediction = sensor.model(SITE).predict(targets(target))
    return float(getattr(prediction, quantity)[0])


def _solved(sensor: Sensor, key: str, goal: Goal, target: PresetTarget) -> float:
    """The key's value by Brent's method; of powers, over their logarithm."""
    from scipy.optimize import brentq

    ends = _bracket(key)
    in_decades = ends[0] > 0

    def value_at(x: float) -> float:
        return float(10**x) if in_decades else x

    def surplus(x: float) -> float:
        trial = sensor.model_copy(update={key: value_at(x)})
        return predicted(trial, target, goal.quantity) - goal.wanted - MARGIN

    low, high = (math.log10(end) if in_decades else end for end in ends)
    try:
        return value_at(brentq(surplus, low, high, xtol=1e-12, rtol=1e-14))
    except ValueError:
        text = f"{key}: no value gives {goal.quantity} {goal.wanted:g}"
        raise PlotfeedError(text) from None


def _bracket(key: str) -> tuple[float, float]:
    return BRACKETS[f"_{key.rpartition('_')[2]}"]

"""A sensor otherwise than its scene says: by a scripted event, or by control while it runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from plotfeed.feeds.scene.problems import problems_of
from plotfeed.feeds.scene.sensors import Sensor, sensor_of
from plotfeed.proto.errors import PlotfeedError

FIXED = frozenset(
    {"id", "type", "preset", "report", "scan", "sac", "sic", "position_enu_m", "event"}
)
"""Keys that a sensor keeps while it runs: who it is, where it stands, its clock and formats."""
PFA_FACTOR = "pfa_factor"
"""Stands for a `pfa` so many times the scene's own."""


class ChangeError(PlotfeedError):
    """A change that no sensor can have. `problems` are (key, what was expected)."""

    def __init__(self, problems: list[tuple[str, str]]) -> None:
        super().__init__("; ".join(f"{key}: {text}" if key else text for key, text in problems))
        self.problems = problems


def changed(sensor: Sensor, *changes: Mapping[str, Any]) -> Sensor:
    """The sensor with those keys in place of its own, later changes over earlier ones.

    Tables are merged key by key, except that a new `kind` begins anew; None takes a key away.
    Raises `ChangeError`.
    """
    tree: dict[str, Any] = sensor.model_dump(exclude_unset=True)
    for change in changes:
        fixed = sorted(FIXED & change.keys())
        if fixed:
            raise ChangeError([(key, "cannot change while the sensor is at work") for key in fixed])
        tree = merged(tree, _with_pfa(sensor, change))
    try:
        return sensor_of(tree)
    except ValidationError as error:
        variant = f"{sensor.type}."  # pydantic says which of all sensors it took it for
        problems = [(k.removeprefix(variant), text) for k, text in problems_of(error, tree)]
        raise ChangeError(problems) from None


def merged(
    tree: Mapping[str, Any], change: Mapping[str, Any], *, keeps_none: bool = False
) -> dict[str, Any]:
    """`tree` with the keys of `change`, tables within tables likewise.

    None takes a key away, or stays in as a change to be made, if `keeps_none`.
    """
    result = dict(tree)
    for key, value in change.items():
        before = result.get(key)
        if value is None and not keeps_none:
            result.pop(key, None)
        elif isinstance(value, Mapping) and isinstance(before, Mapping) and "kind" not in value:
            result[key] = merged(before, value, keeps_none=keeps_none)
        else:
            result[key] = value
    return result


def _with_pfa(sensor: Sensor, change: Mapping[str, Any]) -> Mapping[str, Any]:
    """A change whose factor on the probability of a false alarm is worked out."""
    if PFA_FACTOR not in change:
        return change
    factor, pfa = change[PFA_FACTOR], sensor.false_alarm_probability
    if pfa is None:
        raise ChangeError([(PFA_FACTOR, f"sensor {sensor.id!r} has no pfa")])
    if isinstance(factor, bool) or not isinstance(factor, int | float) or not 0 < factor < 1e15:
        raise ChangeError([(PFA_FACTOR, f"expected a number above 0, not {factor!r}")])
    others = {key: value for key, value in change.items() if key != PFA_FACTOR}
    return {"pfa": pfa * factor, **others}

"""Sensors and drones otherwise than their scene says, by a scripted event or by a command."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import Field, ValidationError

from plotfeed.feeds.scene.claim_keys import ClaimFault
from plotfeed.feeds.scene.drones import Contingency
from plotfeed.feeds.scene.fields import SceneTable
from plotfeed.feeds.scene.problems import in_a_line, problems_of
from plotfeed.feeds.scene.sensors import Sensor, sensor_of
from plotfeed.feeds.scene.sensors.mount_keys import mount_of
from plotfeed.feeds.scene.sensors.scan_keys import Event
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

# Keys that a sensor keeps while it runs: who it is, where it stands, its clock and formats.
FIXED = frozenset(
    {
        *("id", "type", "preset", "report", "scan", "sac", "sic", "position_enu_m"),
        *("height_msl_m", "event"),
    }
)
PFA_FACTOR = "pfa_factor"  # Stands for a `pfa` so many times the scene's own
# What is asked of a sensor over its script, later over earlier: each with the story that asks for
# it, which is empty for what somebody asks for besides.
Layers = tuple[tuple[str, Mapping[str, Any]], ...]


MAX_COMMAND_OCTETS = 1 << 16
EXAMPLE = '{"sensor": "radar", "set": {"link": {"latency_ms": 250}}}'


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
        made = sensor_of(tree)
    except ValidationError as error:
        variant = f"{sensor.type}."  # pydantic says which of all sensors it took it for
        problems = [(k.removeprefix(variant), text) for k, text in problems_of(error, tree)]
        raise ChangeError(problems) from None
    if _cuers(made) != _cuers(sensor):
        key = "mount.cued_by" if _cuers(made) and _cuers(sensor) else "mount"
        raise ChangeError([(key, "cannot change while the sensor is at work")])
    return made


def _cuers(sensor: Sensor) -> tuple[str, ...] | None:
    """The sensors that cue one; None without a mount."""
    mount = mount_of(sensor)
    return None if mount is None else mount.cuers


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


def joined(layers: Layers) -> dict[str, Any]:
    """All layers as one change."""
    tree: dict[str, Any] = {}
    for _, change in layers:
        tree = merged(tree, change, keeps_none=True)
    return tree


def with_change(layers: Layers, change: Mapping[str, Any]) -> Layers:
    """Layers, and over them what somebody asks for by himself."""
    if layers and not layers[-1][0]:
        return (*layers[:-1], ("", merged(layers[-1][1], change, keeps_none=True)))
    return (*layers, ("", change))


def _with_pfa(sensor: Sensor, change: Mapping[str, Any]) -> Mapping[str, Any]:
    """A change whose factor on the probability of a false alarm is worked out."""
    if PFA_FACTOR not in change:
        return change
    others = {key: value for key, value in change.items() if key != PFA_FACTOR}
    factor, pfa = change[PFA_FACTOR], sensor.false_alarm_probability
    if factor is None:
        return others
    if pfa is None:
        raise ChangeError([(PFA_FACTOR, f"sensor {sensor.id!r} has no pfa")])
    if isinstance(factor, bool) or not isinstance(factor, int | float) or not 0 < factor < 1e15:
        raise ChangeError([(PFA_FACTOR, f"expected a number above 0, not {factor!r}")])
    return {"pfa": pfa * factor, **others}


def in_force(events: tuple[Event, ...], elapsed_ns: int) -> list[Mapping[str, Any]]:
    """What the events of a sensor change so long after the beginning, later ones last."""
    return [
        event.set
        for event in events
        if round(event.from_s * NS) <= elapsed_ns
        and (event.to_s is None or elapsed_ns < round(event.to_s * NS))
    ]


def instants_ns(events: tuple[Event, ...]) -> list[int]:
    """When anything begins or ends, after the session has, in order."""
    edges_s = [e.from_s for e in events] + [e.to_s for e in events if e.to_s is not None]
    return sorted({round(edge_s * NS) for edge_s in edges_s})


class ControlError(PlotfeedError):
    """A command that cannot be carried out, in a line."""


class ClockCommand(SceneTable):
    """Asked of a simulated clock alone: real time cannot be held."""

    paused: bool | None = None
    speed: float | None = Field(default=None, ge=0.001, le=10_000)
    step_s: float | None = Field(default=None, gt=0, le=3600)


class Command(SceneTable):
    """One message: of a sensor, of a drone that the scene flies, of a story, or of the clock."""

    sensor: str | None = None
    set: dict[str, Any] | None = None
    """Keys of the sensor as in the scene; null takes one back to its default."""
    reset: bool = False
    """The sensor is again as its scene says; or the drone says again what its scene wants; or the
    story is taken back."""
    drone: str | None = None
    contingency: Contingency | None = None
    """What happens to the drone now, as in the scene but without at_s."""
    claim: ClaimFault | None = None
    """How the drone says otherwise where it is, as in the scene but without from_s and to_s."""
    clock: ClockCommand | None = None
    story: str | None = None
    """Begins, by its id; or with reset ends."""
    undo: bool = False
    """Whatever was asked last of sensors or as a story is taken back, and so on, one by one."""

    def _refusals(self) -> Iterator[str]:
        subjects = [self.sensor, self.drone, self.clock, self.story, self.undo or None]
        if subjects.count(None) != len(subjects) - 1:
            yield "expected one of sensor, drone, clock, story and undo"
        if (self.story is not None or self.undo) and self.set is not None:
            yield "set is of a sensor"
        if self.undo and self.reset:
            yield "undo has no reset: whatever was asked last is undone"
        of_drone = [self.contingency, self.claim]
        if self.sensor is not None and (self.set is None) != self.reset:
            yield 'with a sensor, expected either "set" or "reset"'
        if self.drone is None and of_drone != [None, None]:
            yield "contingency and claim are of a drone"
        if self.drone is not None and (
            self.set is not None or of_drone.count(None) + (not self.reset) != 2
        ):
            yield 'with a drone, expected one of "contingency", "claim" and "reset"'
        if self.contingency is not None and self.contingency.at_s is not None:
            yield "contingency.at_s: it happens at once"
        if self.claim is not None and not {None} >= {self.claim.from_s, self.claim.to_s}:
            yield "claim: from_s and to_s: it holds from now on, until reset"
        if self.clock is not None and not self.clock.model_fields_set:
            yield "clock: expected paused, speed or step_s"


def check_octets(payload: bytes) -> None:
    """Raise `ControlError` for a command, of whatever kind, that is longer than any is."""
    if len(payload) > MAX_COMMAND_OCTETS:
        raise ControlError(f"{len(payload)} octets: at most {MAX_COMMAND_OCTETS} are taken")


def parsed(payload: bytes) -> Command:
    """A command from the wire; raises `ControlError`."""
    check_octets(payload)
    try:
        tree = json.loads(payload)
    except (ValueError, RecursionError):
        raise ControlError(f"not JSON: expected such as {EXAMPLE}") from None
    if not isinstance(tree, dict):
        raise ControlError(f"expected an object such as {EXAMPLE}")
    return command_of(tree)


def command_of(tree: dict[str, Any]) -> Command:
    """A command from an object; raises `ControlError`."""
    try:
        return Command.model_validate(tree)
    except ValidationError as error:
        raise ControlError(in_a_line(problems_of(error, tree))) from None

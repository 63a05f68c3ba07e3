"""What is asked of sensors, drones and stories in mid-run, and how it is undone."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from plotfeed.feeds.console.printed import in_short
from plotfeed.feeds.engine.emulated_sensors import EmulatedSensors
from plotfeed.feeds.engine.scene_drones import SceneDrones
from plotfeed.feeds.scene.changes import Command, ControlError, Layers, joined, with_change
from plotfeed.feeds.scene.drones import Resume
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.story_keys import Story, StoryChange, StoryState
from plotfeed.proto.errors import PlotfeedError

if TYPE_CHECKING:
    from plotfeed.feeds.engine.cooperative_drones import CooperativeDrones

MAX_UNDONE = 100  # Changes that are remembered to be undone; the oldest are forgotten
MAX_WORDS = 80  # Letters by which a change is told in a line
MAX_NAMES = 20  # Of drones, told where another was expected


@dataclass(frozen=True, slots=True)
class _Step:
    """A change that can be undone."""

    words: str
    layers: Mapping[str, tuple[Layers, Layers]]  # Before and after, by sensor
    story: str = ""
    began: bool = False  # Whether the story began by it, or was taken back


class ChangeControl:
    """The sensors and drones of an engine, as commands and stories reach them."""

    def __init__(
        self,
        scene: Scene,
        sensors: EmulatedSensors,
        drones: SceneDrones,
        cooperative: CooperativeDrones | None,
        on_change: Callable[[int, int], object],
    ) -> None:
        """`cooperative` are the drones that say something of themselves, if any do.

        `on_change` is told of each sensor, by index, of which something was asked, from when on.
        """
        # What is asked of sensors over their scripts, by their ids.
        self.layers: dict[str, Layers] = {sensor.id: () for sensor in sensors.sensors}
        self._scene, self._sensors = scene, sensors
        self._drones, self._cooperative = drones, cooperative
        self._index = {name: i for i, name in enumerate(self.layers)}
        self._on_change = on_change
        self._changed: dict[str, None] = {}
        self._begun: dict[str, int] = {}  # When stories began that are on, UTC, by their ids
        self._steps: deque[_Step] = deque(maxlen=MAX_UNDONE)

    @cached_property
    def _stories(self) -> Mapping[str, Story]:
        return self._scene.stories

    @property
    def stories(self) -> list[StoryState]:
        """All that can be told, the usual ones first."""
        return [StoryState(s, self._begun.get(s.id)) for s in self._stories.values()]

    @property
    def undoes(self) -> str:
        """What would be undone next, in words; empty for nothing."""
        return self._steps[-1].words if self._steps else ""

    def obey(self, command: Command, at_utc_ns: int) -> dict[str, Any]:
        """Do what a command asks, from then on, and say what is in force.

        Raises `PlotfeedError`, and nothing has changed.
        """
        if command.drone is not None:
            return self._obey_of_drone(command, at_utc_ns)
        if command.story is not None:
            return self._obey_of_story(command, command.story, at_utc_ns)
        if command.undo:
            return self._undo(at_utc_ns)
        name = command.sensor or ""
        before = self._layers(name)
        self.control(name, None if command.reset else command.set, at_utc_ns)
        words = "as in the scene" if command.reset else told(command.set or {})
        self._steps.append(_Step(f"{name}: {words}", {name: (before, self.layers[name])}))
        self._note_what_is_on(at_utc_ns)
        sensor = self._as_of(name, self.layers[name], at_utc_ns)
        return {"sensor": name, **sensor.model_dump(mode="json", exclude_unset=True)}

    def control(self, sensor: str, change: Mapping[str, Any] | None, at_utc_ns: int) -> None:
        """Change those keys of a sensor from then on, or with None none any more.

        Raises `ChangeError`, and nothing has changed.
        """
        layers = self._layers(sensor)
        self._put_layers(sensor, () if change is None else with_change(layers, change), at_utc_ns)

    def take_changed(self) -> list[str]:
        """Sensors of which something was asked since this was called last, in that order."""
        found, self._changed = list(self._changed), {}
        return found

    def _layers(self, sensor: str) -> Layers:
        layers = self.layers.get(sensor)
        if layers is None:
            known = ", ".join(self.layers)
            raise ControlError(f"sensor: there is no {sensor!r}; expected one of {known}")
        return layers

    def _as_of(self, sensor: str, layers: Layers, at_utc_ns: int) -> Sensor:
        return self._sensors.as_of(self._index[sensor], joined(layers), at_utc_ns)

    def _put_layers(self, sensor: str, layers: Layers, at_utc_ns: int) -> None:
        self._sensors.control(self._index[sensor], joined(layers), at_utc_ns)
        self.layers[sensor] = layers
        self._changed[sensor] = None
        self._on_change(self._index[sensor], at_utc_ns)

    def _obey_of_drone(self, command: Command, at_utc_ns: int) -> dict[str, Any]:
        drone = command.drone or ""
        if drone not in self._drones.names:
            known = ", ".join(self._drones.names[:MAX_NAMES]) or "none"
            raise ControlError(f"drone: the scene flies no {drone!r}; expected one of {known}")
        if command.contingency is not None:
            try:
                self._drones.happen(drone, command.contingency, at_utc_ns)
            except PlotfeedError as error:
                raise ControlError(f"contingency: {error}") from None
        else:
            if self._cooperative is None or drone not in self._cooperative:
                raise ControlError(f"claim: drone {drone!r} says nothing: it is not [cooperative]")
            self._cooperative.control(drone, command.claim, at_utc_ns)
        claim = None if command.claim is None else command.claim.model_dump(exclude_unset=True)
        return {
            "drone": drone,
            "contingency": self._drones.doing(drone, at_utc_ns),
            **({} if command.contingency is not None else {"claim": claim}),
        }

    def _obey_of_story(self, command: Command, name: str, at_utc_ns: int) -> dict[str, Any]:
        story = self._stories.get(name)
        if story is None:
            known = ", ".join(self._stories)
            raise ControlError(f"story: there is no {name!r}; expected one of {known}")
        is_on = name in self._begun
        if is_on != command.reset:
            raise ControlError(f"story: {name!r} is {'on already' if is_on else 'not on'}")
        before = {sensor: self._layers(sensor) for sensor in story.sets}
        after = {s: _without(layers, name) for s, layers in before.items()}
        if not is_on:
            after = {s: (*before[s], (name, keys)) for s, keys in story.sets.items()}
        self._put(after, at_utc_ns, story, begins=not is_on)
        words = f"{story.title or name}{', taken back' if is_on else ''}"
        layers = {sensor: (before[sensor], after[sensor]) for sensor in before}
        self._steps.append(_Step(words, layers, name, not is_on))
        return {"story": name, "on": name in self._begun, "stories": list(self._begun)}

    def _put(
        self,
        layers: Mapping[str, Layers],
        at_utc_ns: int,
        story: Story | None = None,
        *,
        begins: bool = False,
    ) -> None:
        """Have sensors so, and a story begin or end; raises `PlotfeedError` before any change."""
        for sensor, asked in layers.items():
            self._as_of(sensor, asked, at_utc_ns)
        if story is not None and begins:
            seed = self._scene.scene.seed
            joining = [drone for swarm in story.swarm for drone in swarm.members(seed)]
            try:
                self._drones.join(joining, at_utc_ns)
            except PlotfeedError as error:
                raise ControlError(f"story: {error}") from None
        for sensor, asked in layers.items():
            self._put_layers(sensor, asked, at_utc_ns)
        if story is None:
            return
        for change in story.drone_changes:
            with suppress(PlotfeedError):  # the drone may be gone by now, or on its way again
                self._obey_of_drone(_asked(change, begins=begins), at_utc_ns)
        if begins:
            self._begun[story.id] = at_utc_ns
            return
        for swarm in story.swarm:
            self._drones.part_with(swarm.names, at_utc_ns)
        self._begun.pop(story.id, None)

    def _undo(self, at_utc_ns: int) -> dict[str, Any]:
        """Take back what was asked last, so that all is as it was before."""
        if not self._steps:
            raise ControlError("undo: nothing was asked of a sensor, and no story was begun")
        step = self._steps.pop()
        if any(self._layers(name) != after for name, (_, after) in step.layers.items()):
            raise ControlError(f"undo: {step.words}: the sensor was asked otherwise since")
        before = {name: layers for name, (layers, _) in step.layers.items()}
        self._put(before, at_utc_ns, self._stories.get(step.story), begins=not step.began)
        self._note_what_is_on(at_utc_ns)
        return {"undone": step.words, "stories": list(self._begun)}

    def _note_what_is_on(self, at_utc_ns: int) -> None:
        """Stories whose keys sensors have are on, as after a reset that was undone.

        Those that ask nothing but of sensors, all of which were reset, are over.
        """
        for story in self._stories.values():
            if any(name == story.id for s in story.sets for name, _ in self.layers[s]):
                self._begun.setdefault(story.id, at_utc_ns)
            elif story.sets and not story.swarm and not story.drone_changes:
                self._begun.pop(story.id, None)


def _without(layers: Layers, story: str) -> Layers:
    return tuple(layer for layer in layers if layer[0] != story)


def _asked(change: StoryChange, *, begins: bool) -> Command:
    """What a story asks of a drone when it begins or when it is taken back."""
    if begins:
        return Command(drone=change.drone, contingency=change.contingency, claim=change.claim)
    if change.contingency is not None:
        return Command(drone=change.drone, contingency=Resume(kind="resume"))
    return Command(drone=change.drone, reset=True)


def told(change: Mapping[str, Any]) -> str:
    """Keys and values of a change in a line, tables by their keys; cut where it is long."""
    words = ", ".join(_words(change))
    return words if len(words) <= MAX_WORDS else f"{words[: MAX_WORDS - 1]}…"


def _words(change: Mapping[str, Any], above: str = "") -> Iterator[str]:
    for key, value in change.items():
        if isinstance(value, Mapping) and value and "kind" not in value:
            yield from _words(value, f"{above}{key}.")
        else:
            shown = json.dumps(in_short(value), default=str).replace('"', "")
            yield f"{above}{key} {'as usual' if value is None else shown}"

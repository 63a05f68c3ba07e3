"""Commercial sensors as presets: the keys of each, and where every one of them comes from."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from plotfeed.feeds.scene.presets.rules import CatalogueTable, PresetRule, PresetTarget, derive
from plotfeed.feeds.scene.sensors import Sensor, sensor_of
from plotfeed.feeds.scene.sensors.sensor_keys import SensorKeys
from plotfeed.proto.errors import PlotfeedError

SCENE_ONLY = {*SensorKeys.model_fields, "type", "report"}
"""Keys that say what a scene makes of a sensor, not what the sensor is."""

MAX_SHOWN = 60
"""Characters of what somebody wrote that an error repeats."""


class PresetError(PlotfeedError):
    """A preset that a scene cannot use so. `key` is the sensor's key that says so."""

    def __init__(self, key: str, text: str) -> None:
        super().__init__(text)
        self.key = key


class UnknownPresetError(PresetError):
    """A name that no preset has."""

    def __init__(self, name: str) -> None:
        if name in system_names():
            super().__init__("preset", f"{name} is a system of several sensors: write [[system]]")
            return
        hint = closest(name, names())
        super().__init__("preset", f"no such preset as {name[:MAX_SHOWN]!r}; {hint}")


def closest(name: str, known: list[str]) -> str:
    """A hint at the one that may have been meant."""
    begun = [each for each in known if name and f"-{name.lower()}" in f"-{each}"]
    close = begun or difflib.get_close_matches(name.lower(), known, 1, 0.5)
    return f"did you mean {close[0]}?" if close else "`plotfeed sensors` lists them"


class Given(CatalogueTable):
    """A value that is written down, and why it is that."""

    value: Any
    note: str


@dataclass(frozen=True, slots=True)
class MarkedKey:
    """One key of a preset's sensor."""

    key: str
    value: Any
    mark: Literal["stated", "derived", "assumed"]
    rule: str
    """How it was derived, else empty."""
    note: str


class Preset(CatalogueTable):
    """One commercial sensor. A key is stated, derived or assumed; the rest are the defaults."""

    name: str
    title: str
    maker: str
    type: str
    source: str
    target: PresetTarget
    other_target: Annotated[tuple[PresetTarget, ...], Field(strict=False)] = ()
    """What else is quoted, to compare the model with."""
    left_out: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """What the source says of the product and the model has no key for."""
    stated: dict[str, Given] = Field(default_factory=dict)
    derived: dict[str, PresetRule] = Field(default_factory=dict)
    assumed: dict[str, Given] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one_mark_a_key(self) -> Self:
        marked = [*self.stated, *self.derived, *self.assumed]
        twice = {key for key in marked if marked.count(key) > 1}
        if twice:
            raise ValueError(f"{min(twice)} has two marks")
        if reserved := SCENE_ONLY & set(marked):
            raise ValueError(f"{min(reserved)} is for the scene to say")
        return self

    @cached_property
    def keys(self) -> dict[str, Any]:
        """What a scene would write, `type` among them; rules that need the model are solved."""
        given = {key: entry.value for key, entry in {**self.stated, **self.assumed}.items()}
        quoted = self.target, self.other_target
        return {"type": self.type, **given, **derive(self.type, given, self.derived, *quoted)}

    @cached_property
    def sensor(self) -> Sensor:
        """The sensor of a scene that gives no key of its own."""
        return sensor_of({**self.keys, "id": self.name})

    def marked_keys(self) -> Iterator[MarkedKey]:
        """Every key of the sensor, in the order in which the sensor has them."""
        defaults = self.sensor.model_dump()
        meanings = self.sensor.meanings()
        for key in type(self.sensor).model_fields:
            if key in SCENE_ONLY:
                continue
            value = self.keys.get(key, defaults[key])
            if key in self.derived:
                rule = self.derived[key]
                yield MarkedKey(key, value, "derived", str(rule), rule.note)
            elif key in self.stated:
                yield MarkedKey(key, value, "stated", "", self.stated[key].note)
            elif key in self.assumed:
                yield MarkedKey(key, value, "assumed", "", self.assumed[key].note)
            else:
                note = f"The default. {meanings.get(key, '')}".rstrip()
                yield MarkedKey(key, value, "assumed", "", note)


@cache
def names() -> list[str]:
    """The names of all presets of one sensor, in alphabetical order."""
    return _tables_in("plotfeed.feeds.scene.presets")


@cache
def system_names() -> list[str]:
    """The names of all presets of several sensors, in alphabetical order."""
    return _tables_in("plotfeed.feeds.scene.presets.systems")


def _tables_in(package: str) -> list[str]:
    return sorted(
        entry.name.removesuffix(".toml")
        for entry in files(package).iterdir()
        if entry.name.endswith(".toml")
    )


@cache
def preset(name: str) -> Preset:
    """The preset of that name; raises `UnknownPresetError`."""
    if name not in names():
        raise UnknownPresetError(name)
    text = (
        files("plotfeed.feeds.scene.presets").joinpath(f"{name}.toml").read_text(encoding="utf-8")
    )
    return Preset.model_validate({"name": name, **tomllib.loads(text)})


def with_presets(tree: dict[str, Any]) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """A scene's tree in which sensors have what their presets say, and what was wrong with those.

    A key of the scene replaces the preset's as a whole, tables such as `scan` too. What the preset
    derived stays as it was derived: a worse noise figure costs range. Problems are (key, text).
    """
    problems: list[tuple[str, str]] = []
    if not isinstance(tree.get("sensor"), list):
        return tree, problems
    sensors = []
    for i, sensor in enumerate(tree["sensor"]):
        try:
            sensors.append(_merged(sensor))
        except PresetError as error:
            problems.append((f"sensor[{i}].{error.key}", str(error)))
            sensors.append(sensor)
    return {**tree, "sensor": sensors}, problems


def _merged(sensor: Any) -> Any:
    if not isinstance(sensor, dict) or "preset" not in sensor:
        return sensor
    name = sensor["preset"]
    if not isinstance(name, str):
        raise PresetError("preset", "write the name of a preset, in quotes")
    chosen = preset(name)
    if sensor.get("type", chosen.type) != chosen.type:
        text = f"the preset {name} is of type {chosen.type}, not {str(sensor['type'])[:MAX_SHOWN]}"
        raise PresetError("type", text)
    return {**chosen.keys, **sensor}

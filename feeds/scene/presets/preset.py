"""Commercial sensors as presets: the keys of each, where they come from, and by which rules."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, Field, model_validator

from plotfeed.feeds.scene.drones import EmitterKeys
from plotfeed.feeds.scene.fields import NotNegative, Positive, SceneTable, Site
from plotfeed.feeds.scene.sensors import Sensor, sensor_of
from plotfeed.feeds.scene.sensors.sensor_keys import SensorKeys
from plotfeed.models.numerics import root
from plotfeed.models.propagation import C_M_S, beam_gain_dbi
from plotfeed.models.sensors.sensor_model import Targets
from plotfeed.models.state import Emitter, Signature
from plotfeed.proto.errors import PlotfeedError

# What a sensor predicts of a target does not depend on where on Earth both are.
SITE = Site(latitude_deg=0.0, longitude_deg=0.0, height_m=0.0)
MARGIN = 1e-9  # By how much a goal is overshot, so that rounding does not leave the model below it
# Where the value of a key of that unit is looked for.
BRACKETS = {
    "_w": (1e-9, 1e9),
    "_db": (-200.0, 200.0),
    "_deg": (0.0, 90.0),
    "_m": (0.0, 1e4),
    "_cycles": (0.01, 1000.0),
    "_contrast": (1e-4, 1.0),
}


def short(value: float) -> str:
    """A number to five digits, such as 2.4e9."""
    return f"{value:.5g}".replace("e+0", "e").replace("e-0", "e-").replace("e+", "e")


class CatalogueTable(BaseModel):
    """A table of a preset's file: as strict as a scene's, but nothing that a scene may say."""

    model_config = SceneTable.model_config


class PresetTarget(CatalogueTable):
    """The target that a published range is for."""

    range_m: Positive
    """Slant."""
    above_sensor_m: NotNegative = 50.0
    rcs_m2: Positive | None = None
    sound_power_db: float | None = None
    emitter: EmitterKeys | None = None
    size_m: Positive | None = None
    when: dict[str, Any] = Field(default_factory=dict)
    """Keys that the sensor has meanwhile, such as night."""
    note: str
    """Where the range stands, and what is assumed of the target."""

    @property
    def signature(self) -> Signature:
        """What there is of it to sense."""
        return Signature(
            rcs_m2=np.nan if self.rcs_m2 is None else self.rcs_m2,
            sound_power_db=np.nan if self.sound_power_db is None else self.sound_power_db,
            emitters=(Emitter(**self.emitter.model_dump()),) if self.emitter else (),
            size_m=np.nan if self.size_m is None else self.size_m,
        )

    def __str__(self) -> str:
        if self.rcs_m2 is not None:
            return f"{self.rcs_m2:g} m2"
        if self.sound_power_db is not None:
            return f"{self.sound_power_db:g} dB of sound power"
        if self.size_m is not None:
            return ", ".join([f"{self.size_m:g} m across", *self.when])
        return f"{self.emitter.eirp_dbm:g} dBm EIRP" if self.emitter else "no target"


def targets(target: PresetTarget) -> Targets:
    """The one target, north of the sensor."""
    up_m = min(target.above_sensor_m, target.range_m)
    enu_m = np.array([[0.0, (target.range_m**2 - up_m**2) ** 0.5, up_m]])
    return Targets.of_one(target.signature, enu_m)


Quantity = Literal["pd", "sigma_range_m", "sigma_azimuth_deg", "sigma_elevation_deg"]
Pair = Annotated[tuple[float, float], Field(strict=False)]


class PresetRule(CatalogueTable):
    """How the value of a key comes about, by one of `METHODS` or by solving, and why so."""

    note: str
    middle_of: Pair | None = None
    product_of: Pair | None = None
    cell_of_bandwidth_hz: Positive | None = None
    gain_of_beam_deg: Pair | None = None
    turning_deg_s: Positive | None = None
    updating_hz: Positive | None = None
    share_of: str | None = None
    share: Positive | None = None
    share_of_time_on_target: Annotated[float, Field(gt=0, le=1)] | None = None
    solve: Annotated[dict[Quantity, Positive], Field(min_length=1, max_length=1)] | None = None
    """What the sensor's own prediction of the preset's target is to come to."""
    other_target: Annotated[int, Field(ge=0)] | None = None
    """Of the preset's other targets, the one for which it is solved: 0 is the first of them."""

    @model_validator(mode="after")
    def _one_method(self) -> Self:
        if sum(getattr(self, name) is not None for name in (*METHODS, "solve")) != 1:
            raise ValueError(f"a rule has one of {', '.join(METHODS)}, solve")
        if (self.share is None) != (self.share_of is None):
            raise ValueError("share_of and share belong together")
        return self

    @property
    def method(self) -> str:
        """The one method that is given: a key of `METHODS`, or solve."""
        return next((name for name in METHODS if getattr(self, name) is not None), "solve")

    def value(self, keys: Mapping[str, Any]) -> Any:
        """The key's value by a method, from others that are known so far."""
        return METHODS[self.method][0](self, keys)

    def __str__(self) -> str:
        if self.solve is None:
            return METHODS[self.method][1](self)
        ((quantity, wanted),) = self.solve.items()
        where = "the quoted range" if self.other_target is None else "another quoted range"
        return f"such that {quantity} = {wanted:g} at {where}"


def _on_target_s(rule: Any, keys: Mapping[str, Any]) -> float:
    """A share of the time for which a beam is on a target in one turn."""
    beam_deg = keys["azimuth_beamwidth_deg"] * keys.get("receive_beams", 1)
    on_target_s = keys["scan"]["period_s"] * beam_deg / 360
    return float(rule.share_of_time_on_target * on_target_s)


def _on_target_text(rule: Any) -> str:
    share = rule.share_of_time_on_target
    return f"{f'{share:g} of ' if share < 1 else ''}the time that the beam is on a target"


# Methods by their keys in a rule: the value of a rule, and how people read it.
METHODS: Mapping[str, tuple[Callable[[Any, Mapping[str, Any]], Any], Callable[[Any], str]]] = {
    "middle_of": (
        lambda rule, _: sum(rule.middle_of) / 2,
        lambda rule: f"middle of {short(rule.middle_of[0])} and {short(rule.middle_of[1])}",
    ),
    "product_of": (
        lambda rule, _: rule.product_of[0] * rule.product_of[1],
        lambda rule: f"{rule.product_of[0]:g} times {rule.product_of[1]:g}",
    ),
    "cell_of_bandwidth_hz": (
        lambda rule, _: C_M_S / (2 * rule.cell_of_bandwidth_hz),
        lambda rule: f"c/(2B) for B of {rule.cell_of_bandwidth_hz / 1e6:g} MHz",
    ),
    "gain_of_beam_deg": (
        lambda rule, _: float(beam_gain_dbi(*rule.gain_of_beam_deg)),
        lambda rule: "gain of a beam of {:g} x {:g} deg".format(*rule.gain_of_beam_deg),
    ),
    "turning_deg_s": (
        lambda rule, _: {"kind": "rotating", "period_s": 360 / rule.turning_deg_s},
        lambda rule: f"360 deg at {rule.turning_deg_s:g} deg/s",
    ),
    "updating_hz": (
        lambda rule, _: {"kind": "staring", "period_s": 1 / rule.updating_hz},
        lambda rule: f"all cover at {rule.updating_hz:g} Hz",
    ),
    "share_of": (
        lambda rule, keys: float(rule.share * keys[rule.share_of]),
        lambda rule: f"{rule.share:g} of {rule.share_of}",
    ),
    "share_of_time_on_target": (_on_target_s, _on_target_text),
}


def derive(
    kind: str,
    given: Mapping[str, Any],
    rules: Mapping[str, PresetRule],
    target: PresetTarget,
    others: Sequence[PresetTarget] = (),
) -> dict[str, Any]:
    """The values of the rules' keys, for a sensor of that type.

    Plain rules go first, in their order, because solving takes a whole sensor; then what is solved
    for, in its order, so that an error floor is found at the power that was found before it.
    """
    derived: dict[str, Any] = {}
    for key, rule in rules.items():
        if rule.solve is None:
            derived[key] = rule.value({**given, **derived})
    solves = {key: rule for key, rule in rules.items() if rule.solve is not None}
    if not solves:
        return derived
    # Something that a scene may say, until it is found.
    start = {key: max(_bracket(key)[0], 0.0) for key in solves}
    sensor = sensor_of({**given, **derived, **start, "type": kind, "id": "preset"})
    for key, rule in solves.items():
        meant = target if rule.other_target is None else others[rule.other_target]
        derived[key] = _solved(sensor, key, rule, meant)
        sensor = sensor.model_copy(update={key: derived[key]})
    return derived


def predicted(sensor: Sensor, target: PresetTarget, quantity: str) -> float:
    """One quantity of what the sensor's model predicts of the target."""
    then = sensor.model_copy(update=target.when)
    prediction = then.model(SITE).predict(targets(target))
    return float(getattr(prediction, quantity)[0])


def _solved(sensor: Sensor, key: str, rule: PresetRule, target: PresetTarget) -> float:
    """The key's value by Brent's method; of powers, over their logarithm."""
    ((quantity, wanted),) = (rule.solve or {}).items()
    ends = _bracket(key)
    in_decades = ends[0] > 0

    def value_at(x: float) -> float:
        return float(10**x) if in_decades else x

    def surplus(x: float) -> float:
        trial = sensor.model_copy(update={key: value_at(x)})
        return predicted(trial, target, quantity) - wanted - MARGIN

    low, high = (math.log10(end) if in_decades else end for end in ends)
    try:
        return value_at(root(surplus, low, high))
    except ValueError:
        raise PlotfeedError(f"{key}: no value gives {quantity} {wanted:g}") from None


def _bracket(key: str) -> tuple[float, float]:
    return BRACKETS[f"_{key.rpartition('_')[2]}"]


# Keys that say what a scene makes of a sensor, not what the sensor is.
SCENE_ONLY = {*SensorKeys.model_fields, "type", "report"}

MAX_SHOWN = 60  # Characters of what somebody wrote that an error repeats


class PresetError(PlotfeedError):
    """A preset that a scene cannot use so. `key` is the sensor's key that says so."""

    def __init__(self, key: str, text: str) -> None:
        super().__init__(text)
        self.key = key


class UnknownPresetError(PresetError):
    """A name that no preset has."""

    def __init__(self, name: str) -> None:
        text = f"no such preset as {name[:MAX_SHOWN]!r}; {closest(name, names())}"
        if name in system_names():
            text = f"{name} is a system of several sensors: write [[system]]"
        super().__init__("preset", text)


def closest(name: str, known: list[str]) -> str:
    """A hint at the one that may have been meant."""
    import difflib  # only who mistypes waits for it

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
            if (rule := self.derived.get(key)) is not None:
                yield MarkedKey(key, value, "derived", str(rule), rule.note)
            elif (given := self.stated.get(key)) is not None:
                yield MarkedKey(key, value, "stated", "", given.note)
            else:
                given = self.assumed.get(key)
                default = f"The default. {meanings.get(key, '')}".rstrip()
                note = default if given is None else given.note
                yield MarkedKey(key, value, "assumed", "", note)


PRESETS = "plotfeed.feeds.scene.presets"
SYSTEMS = f"{PRESETS}.systems"


@cache
def names(package: str = PRESETS) -> list[str]:
    """The names of all presets of one sensor, or of `SYSTEMS`, in alphabetical order."""
    found = (entry.name for entry in files(package).iterdir())
    return sorted(name.removesuffix(".toml") for name in found if name.endswith(".toml"))


def system_names() -> list[str]:
    """The names of all presets of several sensors, in alphabetical order."""
    return names(SYSTEMS)


def tree_of(name: str, package: str) -> dict[str, Any]:
    """What the file of a preset says, and its name."""
    text = files(package).joinpath(f"{name}.toml").read_text(encoding="utf-8")
    return {"name": name, **tomllib.loads(text)}


@cache
def preset(name: str) -> Preset:
    """The preset of that name; raises `UnknownPresetError`."""
    if name not in names():
        raise UnknownPresetError(name)
    return Preset.model_validate(tree_of(name, PRESETS))


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

"""The sensors that a scene can name: the keys of each, and the model that they make.

`register` adds another, from within this package or from outside.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, reduce
from operator import or_
from typing import Annotated, Any, TypeAlias, TypeVar

from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler, TypeAdapter
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from plotfeed.feeds.scene.report_formats import LoadedOnUse
from plotfeed.feeds.scene.sensors.sensor_keys import SensorKeys

# In alphabetical order, as an error lists them.
_HOMES = {
    "acoustic": "acoustic_keys:AcousticKeys",
    "acoustic_pair": "acoustic_keys:AcousticPairKeys",
    "active_radar": "polar_radar_keys:ActiveRadarKeys",
    "camera": "camera_keys:CameraKeys",
    "mimo_radar": "polar_radar_keys:MimoRadarKeys",
    "multistatic_mimo": "multistatic_keys:MultistaticMimoKeys",
    "multistatic_passive": "multistatic_keys:MultistaticPassiveKeys",
    "passive_radar": "passive_radar_keys:PassiveRadarKeys",
    "range_gate": "range_gate_keys:RangeGateKeys",
    "rf": "rf_keys:RfKeys",
}
# The keys of every sensor, by its `type`; those that no scene names are not loaded.
SENSORS: LoadedOnUse[type[SensorKeys]] = LoadedOnUse(
    {kind: f"plotfeed.feeds.scene.sensors.{home}" for kind, home in _HOMES.items()}
)

_Keys = TypeVar("_Keys", bound=SensorKeys)


def register(keys: type[_Keys]) -> type[_Keys]:
    """Let scenes name a sensor of these keys: `@register` above their class does."""
    if keys.type_name() in SENSORS:
        raise ValueError(f"there is a sensor of type {keys.type_name()} already")
    SENSORS[keys.type_name()] = keys
    return keys


@cache
def _adapter(*sensors: type[SensorKeys]) -> TypeAdapter[Any]:
    """What tells sensors apart by their `type`."""
    union: Any = Annotated[reduce(or_, sensors), Field(discriminator="type")]
    return TypeAdapter(union)


def sensor_of(tree: Mapping[str, Any]) -> SensorKeys:
    """A sensor from its keys; `type` tells which. Raises pydantic's `ValidationError`."""
    kind = tree.get("type") if isinstance(tree, Mapping) else getattr(tree, "type", None)
    if isinstance(kind, str) and kind in SENSORS:
        return SENSORS[kind].model_validate(tree)
    found: SensorKeys = _adapter(*SENSORS.values()).validate_python(tree)  # says which there are
    return found


class _OfAnyType:
    """Lets pydantic validate and describe sensors of all types that are registered by then."""

    def __get_pydantic_core_schema__(
        self, _source: object, _handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(sensor_of)

    def __get_pydantic_json_schema__(
        self, _schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return handler(_adapter(*SENSORS.values()).core_schema)


Sensor: TypeAlias = Annotated[SensorKeys, _OfAnyType()]  # Any of them

__all__ = ["SENSORS", "Sensor", "SensorKeys", "register", "sensor_of"]

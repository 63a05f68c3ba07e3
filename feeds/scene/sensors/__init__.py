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

from plotfeed.feeds.scene.sensors.acoustic_keys import AcousticKeys, AcousticPairKeys
from plotfeed.feeds.scene.sensors.camera_keys import CameraKeys
from plotfeed.feeds.scene.sensors.mimo_radar_keys import MimoRadarKeys
from plotfeed.feeds.scene.sensors.multistatic_keys import (
    MultistaticMimoKeys,
    MultistaticPassiveKeys,
)
from plotfeed.feeds.scene.sensors.passive_radar_keys import PassiveRadarKeys
from plotfeed.feeds.scene.sensors.polar_radar_keys import ActiveRadarKeys
from plotfeed.feeds.scene.sensors.range_gate_keys import RangeGateKeys
from plotfeed.feeds.scene.sensors.rf_keys import RfKeys
from plotfeed.feeds.scene.sensors.sensor_keys import SensorKeys

SENSORS: dict[str, type[SensorKeys]] = {}
"""The keys of every sensor, by its `type`."""

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
    found: SensorKeys = _adapter(*SENSORS.values()).validate_python(tree)
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


Sensor: TypeAlias = Annotated[SensorKeys, _OfAnyType()]
"""Any of them."""

for _keys in (
    AcousticKeys,
    AcousticPairKeys,
    ActiveRadarKeys,
    CameraKeys,
    MimoRadarKeys,
    MultistaticMimoKeys,
    MultistaticPassiveKeys,
    PassiveRadarKeys,
    RangeGateKeys,
    RfKeys,
):
    register(_keys)

__all__ = ["SENSORS", "Sensor", "SensorKeys", "register", "sensor_of"]

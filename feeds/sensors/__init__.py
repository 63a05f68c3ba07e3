"""The sensors that a scene can name: the keys of each, and the model that they make."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from plotfeed.feeds.sensors.acoustic import AcousticSensor
from plotfeed.feeds.sensors.active_radar import ActiveRadarSensor
from plotfeed.feeds.sensors.mimo_radar import MimoRadarSensor
from plotfeed.feeds.sensors.passive_radar import PassiveRadarSensor
from plotfeed.feeds.sensors.range_gate import RangeGateSensor
from plotfeed.feeds.sensors.rf import RfSensor

Sensor = Annotated[
    AcousticSensor
    | ActiveRadarSensor
    | MimoRadarSensor
    | PassiveRadarSensor
    | RangeGateSensor
    | RfSensor,
    Field(discriminator="type"),
]
"""Any of them; `type` tells which."""

__all__ = [
    "AcousticSensor",
    "ActiveRadarSensor",
    "MimoRadarSensor",
    "PassiveRadarSensor",
    "RangeGateSensor",
    "RfSensor",
    "Sensor",
]

"""The sensors that a scene can name: the keys of each, and the model that they make."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from plotfeed.feeds.sensors.active_radar import ActiveRadarSensor
from plotfeed.feeds.sensors.range_gate import RangeGateSensor

Sensor = Annotated[ActiveRadarSensor | RangeGateSensor, Field(discriminator="type")]
"""Any of them; `type` tells which."""

__all__ = ["ActiveRadarSensor", "RangeGateSensor", "Sensor"]

"""The sensors that a scene can name: the keys of each, and the model that they make."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from plotfeed.feeds.scene.sensors.acoustic_keys import AcousticKeys
from plotfeed.feeds.scene.sensors.passive_radar_keys import PassiveRadarKeys
from plotfeed.feeds.scene.sensors.polar_radar_keys import ActiveRadarKeys, MimoRadarKeys
from plotfeed.feeds.scene.sensors.range_gate_keys import RangeGateKeys
from plotfeed.feeds.scene.sensors.rf_keys import RfKeys

Sensor = Annotated[
    AcousticKeys | ActiveRadarKeys | MimoRadarKeys | PassiveRadarKeys | RangeGateKeys | RfKeys,
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

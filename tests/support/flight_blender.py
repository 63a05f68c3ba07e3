"""Flight Blender as a judge: what it demands of air traffic, and what it makes of it.

Facts of https://github.com/openutm/flight-blender at 5d9b953b (27 July 2026), each with its file;
the bounds of a place are those of its edition 0a180613, which refuses others at the door.
"""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

MOST_INT64, MOST_INT32 = 2**63 - 1, 2**31 - 1
# Timestamps above are in these units, others in seconds: repositories/flight_feed_repo.py.
MICROSECONDS_FROM, MILLISECONDS_FROM = 1e15, 1e12


class BlenderObservation(BaseModel):
    """`ObservationIn` of domain_types/flight_feed.py, within `ArrayOfObservations` of its API.

    The API's description (api/flight-blender-server-1.0.0-resolved.yaml) bounds the key's length,
    the sources 0 to 11, of which 5 is a primary radar, and both source types.
    """

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    lat_dd: Annotated[float, Field(ge=-90, le=90)]
    lon_dd: Annotated[float, Field(ge=-180, le=180)]
    altitude_mm: float
    icao_address: Annotated[str, Field(max_length=24)]
    traffic_source: Annotated[int, Field(ge=0, le=11)]
    timestamp: Annotated[int, Field(gt=0, le=MOST_INT64)]
    source_type: Literal[0, 1] = 0
    metadata: dict[str, Any] = Field(default_factory=dict)

    @property
    def sensor_time(self) -> datetime:
        """The UTC that it reads the timestamp as."""
        unit = 1.0
        if self.timestamp > MICROSECONDS_FROM:
            unit = 1e-6
        elif self.timestamp > MILLISECONDS_FROM:
            unit = 1e-3
        return datetime.fromtimestamp(self.timestamp * unit, tz=UTC)


class _Body(BaseModel):
    """`ObservationRequest` of the same file."""

    observations: list[BlenderObservation]


def judged(body: bytes) -> list[BlenderObservation]:
    """What it takes of a body; raises `ValueError` where it answers 422.

    It reads JSON as Python does, and types as pydantic does where it is not strict.
    """
    return _Body.model_validate(json.loads(body)).observations

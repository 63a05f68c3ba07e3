"""The drones that a scene flies by itself: the keys of paths and flights, and of what they emit."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from plotfeed.feeds.parts import (
    Decibels,
    Frequency,
    Height,
    Name,
    NotNegative,
    Part,
    Place,
    Positive,
    Speed,
)
from plotfeed.feeds.report import AltitudeReference


class Waypoint(Place):
    """A place on a path."""

    speed_m_s: Speed | None = None
    """On the way here; without it, the drone's."""


class EmitterPart(Part):
    """Something on the drone that radiates."""

    frequency_hz: Frequency
    """Centre."""
    bandwidth_hz: Positive
    eirp_dbm: Decibels
    kind: str = ""
    """Such as control, video or remote-id."""
    identity: str = ""
    """What a sensor that decodes the emission reads."""


class FlightFile(Part):
    """A recorded flight, flown from the session's start on."""

    file: str
    """DJI SRT, CSV, ArduPilot DataFlash, MAVLink tlog or GPX; relative to the scene."""
    columns: dict[str, str] = Field(default={})
    """Of a CSV: the file's name for each of ours, such as latitude_deg = "lat"."""
    altitude_reference: Annotated[AltitudeReference, Field(strict=False)] | None = None
    """Where the file does not say it: ellipsoid, mean_sea_level or above_takeoff."""
    gps_order: Literal["lat-lon", "lon-lat"] | None = None
    """Of an SRT that does not show it."""
    utc_offset_h: Annotated[float, Field(ge=-14, le=14)] = 0.0
    """Of the file's local time."""
    takeoff_height_m: Height | None = None
    geoid_undulation_m: Annotated[float, Field(ge=-150, le=150)] | None = None
    """For this flight alone, in place of those of [telemetry]."""


class Drone(Part):
    """A drone that the scene itself flies: along waypoints, or as recorded in a file."""

    id: Name
    rcs_m2: Positive | None = None
    sound_power_db: Decibels | None = None
    """Re 1 pW."""
    emitters: Annotated[tuple[EmitterPart, ...], Field(strict=False)] = ()
    """What radiates on board."""
    start_s: NotNegative = 0.0
    """After the session's start."""
    path: Annotated[tuple[Waypoint, ...], Field(strict=False)] = ()
    speed_m_s: Speed | None = None
    repeat: bool = False
    """Back from the last waypoint to the first, and again; otherwise it is gone at the last."""
    flight: FlightFile | None = None

    @model_validator(mode="after")
    def _flies(self) -> Self:
        if bool(self.path) == bool(self.flight):
            raise ValueError("path: a drone has either a path or a flight")
        if self.path and len(self.path) < 2:
            raise ValueError("path: at least two waypoints are needed")
        if self.path and self.speed_m_s is None and any(w.speed_m_s is None for w in self.path[1:]):
            raise ValueError("speed_m_s: needed, unless every waypoint after the first has one")
        if self.flight and (self.speed_m_s or self.repeat):
            raise ValueError("flight: speed_m_s and repeat belong to a path")
        return self

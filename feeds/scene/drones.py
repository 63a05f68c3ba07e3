"""The drones that a scene flies by itself: the keys of paths and flights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from plotfeed.feeds.scene.fields import (
    Decibels,
    Frequency,
    Height,
    Location,
    Name,
    NotNegative,
    Positive,
    SceneTable,
    Size,
    Speed,
)
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.models.state import DRONE, AltitudeReference


class Waypoint(Location):
    """A place on a path."""

    speed_m_s: Speed | None = None
    """On the way here; without it, the drone's."""


class EmitterKeys(SceneTable):
    """Something on the drone that radiates."""

    frequency_hz: Frequency
    """Centre."""
    bandwidth_hz: NotNegative
    eirp_dbm: Decibels
    kind: str = ""
    """Such as control, video or remote-id."""
    identity: str = ""
    """What a sensor that decodes the emission reads."""


class FlightFile(SceneTable):
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


class Drone(SceneTable):
    """A drone that the scene itself flies: along waypoints, or as recorded in a file."""

    id: Name
    rcs_m2: Positive | None = None
    sound_power_db: Decibels | None = None
    """Re 1 pW."""
    size_m: Size | None = None
    """Across, as cameras see it."""
    target_class: Name = DRONE
    """What it is to sensors that recognise it: drone, bird or any other word."""
    model: Annotated[str, Field(max_length=64)] = ""
    """Such as Phantom 4: what sensors call it that identify it."""
    emitters: Annotated[tuple[EmitterKeys, ...], Field(strict=False)] = ()
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


COOPERATIVE = "cooperative"
"""What stands in place of a sensor's id: in topics, and in the `sensors` of a [[udp]]."""
MAX_SERIAL = 12


class CooperativeKeys(SceneTable):
    """Drones of the scene that report themselves, as ASTERIX 129."""

    drones: Annotated[tuple[Name, ...], Field(strict=False)] = ()
    """Their ids; without it, all that the scene flies itself."""
    period_s: Annotated[float, Field(ge=0.05, le=3600)] = 1.0
    """Of their reports, which come at whole multiples of it."""
    sac: Annotated[int, Field(ge=0, le=255)] = 0
    sic: Annotated[int, Field(ge=0, le=255)] = 0
    """Of their reports; the standard wants 0 and 0 for what comes from the air."""
    country: Annotated[str, Field(pattern=r"^[A-Z]{2}$")] = "ZZ"
    """Of registration: two letters of ISO 3166, of which ZZ is nobody's."""
    accuracy_m: Annotated[float, Field(ge=0, le=200)] = 0.0
    """Standard deviation of the error that they make east, north and up, each time anew."""
    link: LinkSettings | None = None
    """Between the drones and whoever hears them."""

    def those_of(self, flown: Sequence[str]) -> Sequence[str]:
        """The ids of the cooperative ones."""
        return self.drones or flown

    def problem(self, flown: Sequence[str]) -> str | None:
        """Why the drones that a scene flies cannot report so, if they cannot."""
        for drone in self.those_of(flown):
            if drone not in flown:
                return f"the scene flies no drone {drone!r}"
            if not drone.isascii() or len(drone) > MAX_SERIAL:
                return (
                    f"the id {drone!r} becomes the serial number, "
                    f"which ASTERIX 129 holds up to {MAX_SERIAL} characters of ASCII"
                )
        return None

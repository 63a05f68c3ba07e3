"""The keys of mappings: how JSON that other systems publish over MQTT becomes telemetry."""

from __future__ import annotations

import re
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from plotfeed.feeds.scene.fields import Positive, SceneTable
from plotfeed.models.state import AltitudeReference

PLACE = "{drone}"
"""The level of a topic that is the drone's name."""


def _topic(text: str) -> str:
    levels = text.split("/")
    if not text.isprintable() or not text or any(PLACE in x and x != PLACE for x in levels):
        raise ValueError(f"expected levels of a topic, of which one may be {PLACE}, not {text!r}")
    if any(("+" in x and x != "+") or "#" in x for x in levels) or levels.count(PLACE) > 1:
        raise ValueError(f"expected + and {PLACE} as whole levels, {PLACE} once and no #: {text!r}")
    return text


def _path(text: str) -> str:
    if not re.fullmatch(r"[^.\s]+(\.[^.\s]+)*", text):
        raise ValueError(f"expected keys with dots between them, such as pos.lat, not {text!r}")
    return text


KeyPath = Annotated[str, Field(max_length=200), AfterValidator(_path)]


class TelemetryMapping(SceneTable):
    """JSON of another system on the session's broker, and where in it telemetry stands.

    Keys are paths with dots: pos.lat is lat in pos; numbers count in lists from 0.
    """

    topic: Annotated[str, Field(max_length=200), AfterValidator(_topic)]
    """Such as fleet/{drone}/state; + is any level, {drone} the one that is the drone's name."""
    drone: KeyPath | None = None
    """Key of the drone's name, where the topic does not tell it."""
    latitude: KeyPath
    """Key of it; WGS-84, north."""
    longitude: KeyPath
    """Key of it; WGS-84, east."""
    angle_unit: Literal["deg", "rad", "1e-7deg"] = "deg"
    """Of latitude and longitude."""
    altitude: KeyPath
    """Key of it."""
    altitude_unit: Literal["m", "ft", "mm", "cm"] = "m"
    """Of what stands there."""
    altitude_reference: Annotated[AltitudeReference, Field(strict=False)]
    """What altitudes are above: ellipsoid, mean_sea_level or above_takeoff."""
    time: KeyPath | None = None
    """Key of it; without it, positions are of when they come."""
    time_format: Literal["iso", "s", "ms", "us", "ns"] = "iso"
    """ISO 8601 with a zone, or a number since 1970."""
    velocity_east: KeyPath | None = None
    """Key of it; without velocities, they are fitted to positions."""
    velocity_north: KeyPath | None = None
    """Key of it."""
    velocity_up: KeyPath | None = None
    """Key of it."""
    velocity_down: KeyPath | None = None
    """Key of it, in place of velocity_up."""
    speed: KeyPath | None = None
    """Key of it: over ground, with course, in place of velocity_east and velocity_north."""
    course: KeyPath | None = None
    """Key of it, degrees clockwise from true north."""
    speed_unit: Literal["m/s", "km/h", "kn", "mph", "cm/s"] = "m/s"
    """Of all velocities."""
    horizontal_accuracy_m: KeyPath | None = None
    """Key of one standard deviation on the ground."""
    vertical_accuracy_m: KeyPath | None = None
    """Key of one standard deviation of the altitude."""
    rcs_m2: Positive | None = None
    """Of its drones; without it, telemetry.rcs_m2."""

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if (PLACE in self.topic) == (self.drone is not None):
            raise ValueError(
                f"drone: either the topic has {PLACE}, or drone is the key of its name"
            )
        if (self.speed is None) != (self.course is None):
            raise ValueError("speed: it and course belong together")
        if self.speed is not None and (self.velocity_east or self.velocity_north):
            raise ValueError("speed: either speed and course, or velocity_east and velocity_north")
        if self.velocity_up is not None and self.velocity_down is not None:
            raise ValueError("velocity_down: either it or velocity_up")
        return self

    @property
    def filter(self) -> str:
        """What is subscribed to."""
        return self.topic.replace(PLACE, "+")

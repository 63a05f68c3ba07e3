"""What a drone of the scene is to do, leg by leg, what it can do, and what comes in between."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from plotfeed.feeds.scene.fields import (
    Azimuth,
    Height,
    Location,
    ModelTable,
    NotNegative,
    Positive,
    SceneTable,
    Speed,
)

if TYPE_CHECKING:
    pass

MAX_TURNS = 100.0


class LimitKeys(ModelTable):
    """What the drone can do on its legs and in contingencies; a Phantom 4's, but acceleration."""

    makes = "flight_plan:FlightLimits"

    speed_m_s: Speed = 20.0
    """Greatest, over all."""
    climb_m_s: Speed = 6.0
    """Greatest, upwards."""
    sink_m_s: Speed = 4.0
    """Greatest, downwards."""
    acceleration_m_s2: Annotated[float, Field(ge=0.1, le=100)] = 4.0
    """Greatest, of any kind; 4 m/s² is a tilt of 22 degrees."""


class TakeOffLeg(SceneTable):
    """Straight up from where it stands."""

    kind: Literal["take-off"]
    """Which leg it is."""
    height_m: Positive
    """Above home."""


class PlaceLeg(Location):
    """Straight to a place, where it comes to rest."""

    kind: Literal["to"]
    """Which leg it is."""
    speed_m_s: Speed | None = None
    """On the way; without it, the limit."""


class HoverLeg(SceneTable):
    """Staying where it is."""

    kind: Literal["hover"]
    """Which leg it is."""
    for_s: Positive
    """How long."""


class OrbitLeg(Location):
    """Round a place, at that place's height, from the point of the circle that is nearest."""

    kind: Literal["orbit"]
    """Which leg it is."""
    radius_m: Annotated[float, Field(ge=1, le=100_000)]
    """Of the circle."""
    turns: Annotated[float, Field(gt=0, le=MAX_TURNS)] = 1.0
    """How often round."""
    speed_m_s: Speed | None = None
    """On the circle; without it, as fast as the limits allow there."""
    clockwise: bool = True
    """Seen from above."""


class LandLeg(SceneTable):
    """Straight down to the height of home; there the drone is gone."""

    kind: Literal["land"]
    """Which leg it is."""


Leg = Annotated[TakeOffLeg | PlaceLeg | HoverLeg | OrbitLeg | LandLeg, Field(discriminator="kind")]


class _Happening(SceneTable):
    """What all contingencies have in common."""

    at_s: NotNegative | None = None
    """When, after the session has begun. On control it is left out: it happens at once."""


class LostLink(_Happening):
    """The control link is lost: it waits, climbs if it must, flies home straight, and lands."""

    kind: Literal["lost-link"]
    """What happens."""
    hold_s: NotNegative = 10.0
    """It hovers so long before it returns."""
    return_height_m: Height | None = None
    """Above home; it climbs to this before it returns. Without it, it returns as high as it is."""
    speed_m_s: Speed | None = None
    """On the way home; without it, the limit."""


class FlyAway(_Happening):
    """The drone flies off and obeys nothing, no geofence either, until its battery is empty."""

    kind: Literal["fly-away"]
    """What happens."""
    course_deg: Azimuth | None = None
    """Clockwise from true north; without it, where it is heading, or north."""
    speed_m_s: Speed | None = None
    """Over ground; without it, the limit."""
    climb_m_s: Annotated[float, Field(ge=-100, le=100)] = 0.0
    """Upwards; below 0 it sinks."""
    for_s: Annotated[float, Field(gt=0, le=86_400)] = 600.0
    """It is gone then."""


class Stray(Location, _Happening):
    """The drone leaves its way for a place, such as one beyond a geofence, and then goes on."""

    kind: Literal["stray"]
    """What happens."""
    hold_s: NotNegative = 0.0
    """It stays there so long."""
    speed_m_s: Speed | None = None
    """There and back; without it, the limit."""


class LowBattery(_Happening):
    """The drone lands where it is."""

    kind: Literal["low-battery"]
    """What happens."""


class Hold(_Happening):
    """The drone hovers until it is told to resume, or lands after a while."""

    kind: Literal["hold"]
    """What happens."""
    for_s: Annotated[float, Field(gt=0, le=86_400)] = 600.0
    """It lands after so long."""


class Resume(_Happening):
    """The drone goes on with what it left.

    With the legs at the end of the one that it left, or anew with an orbit or a hover; with a path
    at the next waypoint; with a recorded flight where it left.
    """

    kind: Literal["resume"]
    """What happens."""


Contingency = Annotated[
    LostLink | FlyAway | Stray | LowBattery | Hold | Resume, Field(discriminator="kind")
]


class GeofenceKeys(SceneTable):
    """A cylinder about home that the drone itself knows, and what it does when it has left it.

    It acts while the drone obeys: not in a fly-away, nor a second time after it has acted. The
    drone crosses by the way that it takes to brake.
    """

    radius_m: Annotated[float, Field(ge=1, le=1e6)]
    """About home."""
    above_home_m: Positive | None = None
    """Its top; without it, there is none."""
    does: Literal["hold", "return", "land"] = "return"
    """What the drone does: hovers, flies home and lands, or lands there."""


class MissionKeys(SceneTable):
    """The part of a drone's keys that says what it does beside a path, and instead of one."""

    home: Location | None = None
    """Where it begins its legs, returns to and lands: at the height of the ground. Needed with leg;
    otherwise it is beneath the first place of the path or flight, at the height of the site."""
    leg: Annotated[tuple[Leg, ...], Field(strict=False)] = ()
    """What it does, one after the other, within its limits and at rest in between; or else `path`
    or `flight`."""
    limits: LimitKeys = LimitKeys()
    """What it can do, on its legs and in contingencies."""
    geofence: GeofenceKeys | None = None
    """What it knows of, and does not mean to leave."""
    contingency: Annotated[tuple[Contingency, ...], Field(strict=False)] = ()
    """What goes otherwise than planned, and when."""

    @model_validator(mode="after")
    def _can_be_flown(self) -> Self:
        if self.leg and self.home is None:
            raise ValueError("home: needed with leg")
        for n, leg in enumerate(self.leg):
            self._check_leg(n, leg)
        before_s = -1.0
        for n, happening in enumerate(self.contingency):
            key = f"contingency[{n}].at_s"
            if happening.at_s is None:
                raise ValueError(f"{key}: missing")
            if happening.at_s <= before_s:
                raise ValueError(f"{key}: must be above that of the one before")
            before_s = happening.at_s
        return self

    def _check_leg(self, n: int, leg: Leg) -> None:
        limits = self.limits.model()
        if leg.kind == "land" and n + 1 < len(self.leg):
            raise ValueError(f"leg[{n}]: nothing comes after land")
        if not isinstance(leg, PlaceLeg | OrbitLeg) or leg.speed_m_s is None:
            return
        most, why = limits.speed_m_s, "limits"
        if isinstance(leg, OrbitLeg):
            most = limits.orbit_speed_m_s(leg.radius_m)
            why = f"limits, on a circle of {leg.radius_m:g} m"
        if leg.speed_m_s > most:
            raise ValueError(f"leg[{n}].speed_m_s: at most {most:.3g} m/s by its {why}")

"""The drones of a scene: missions and paths of those that it flies, and their properties."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field

from plotfeed.feeds.scene.claim_keys import COOPERATIVE, ClaimFault, CooperativeKeys
from plotfeed.feeds.scene.fields import (
    Azimuth,
    Decibels,
    Enu,
    Frequency,
    Height,
    Location,
    ModelTable,
    Name,
    NotNegative,
    Positive,
    SceneTable,
    Size,
    Speed,
)
from plotfeed.feeds.scene.telemetry_keys import Undulation
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.state import DRONE, AltitudeReference, Floats

if TYPE_CHECKING:
    from plotfeed.models.effects.target_echoes import Aspect, TargetEcho, TargetEchoes

MAX_TURNS = 100.0


class LimitKeys(ModelTable):
    """What the drone can do: a Phantom 4's, but for the acceleration."""

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
    height_m: Positive
    """Above home."""


class PlaceLeg(Location):
    """Straight to a place, where it comes to rest."""

    kind: Literal["to"]
    speed_m_s: Speed | None = None
    """On the way; without it, the limit."""


class HoverLeg(SceneTable):
    """Staying where it is."""

    kind: Literal["hover"]
    for_s: Positive
    """How long."""


class OrbitLeg(Location):
    """Round a place, at its height, from the circle's nearest point."""

    kind: Literal["orbit"]
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


Leg = Annotated[TakeOffLeg | PlaceLeg | HoverLeg | OrbitLeg | LandLeg, Field(discriminator="kind")]


class _Happening(SceneTable):
    """What all contingencies have in common."""

    at_s: NotNegative | None = None
    """When, after the session has begun; on control it is left out."""


class LostLink(_Happening):
    """The control link is lost: it waits, climbs if it must, flies home and lands."""

    kind: Literal["lost-link"]
    hold_s: NotNegative = 10.0
    """It hovers so long before it returns."""
    return_height_m: Height | None = None
    """Above home, climbed to first; without it, it returns as high as it is."""
    speed_m_s: Speed | None = None
    """On the way home; without it, the limit."""


class FlyAway(_Happening):
    """The drone flies off, past geofences, until its battery is empty."""

    kind: Literal["fly-away"]
    course_deg: Azimuth | None = None
    """Clockwise from true north; without it, where it is heading, or north."""
    speed_m_s: Speed | None = None
    """Over ground; without it, the limit."""
    climb_m_s: Annotated[float, Field(ge=-100, le=100)] = 0.0
    """Upwards; below 0 it sinks."""
    for_s: Annotated[float, Field(gt=0, le=86_400)] = 600.0
    """It is gone then."""


class Stray(Location, _Happening):
    """The drone leaves its way for a place, and then goes on."""

    kind: Literal["stray"]
    hold_s: NotNegative = 0.0
    """It stays there so long."""
    speed_m_s: Speed | None = None
    """There and back; without it, the limit."""


class LowBattery(_Happening):
    """The drone lands where it is."""

    kind: Literal["low-battery"]


class Hold(_Happening):
    """The drone hovers until it is told to resume, or lands after a while."""

    kind: Literal["hold"]
    for_s: Annotated[float, Field(gt=0, le=86_400)] = 600.0
    """It lands after so long."""


class Resume(_Happening):
    """The drone goes on from the leg, waypoint or place that it left; orbits begin anew."""

    kind: Literal["resume"]


Contingency = Annotated[
    LostLink | FlyAway | Stray | LowBattery | Hold | Resume, Field(discriminator="kind")
]


class GeofenceKeys(SceneTable):
    """A cylinder about home; a drone that has left it acts once, and not in a fly-away."""

    radius_m: Annotated[float, Field(ge=1, le=1e6)]
    """About home."""
    above_home_m: Positive | None = None
    """Its top; without it, there is none."""
    does: Literal["hold", "return", "land"] = "return"
    """What the drone does: hovers, flies home and lands, or lands there."""


class MissionKeys(SceneTable):
    """The part of a drone's keys that says what it does beside a path, and instead of one."""

    home: Location | None = None
    """Where it starts, returns to and lands, on the ground. Needed with leg; else beneath the first
    place."""
    leg: Annotated[tuple[Leg, ...], Field(strict=False)] = ()
    """What it does, one after the other, within its limits; or else `path` or `flight`."""
    limits: LimitKeys = LimitKeys()
    """What it can do, on its legs and in contingencies."""
    geofence: GeofenceKeys | None = None
    """What it knows of, and does not mean to leave."""
    contingency: Annotated[tuple[Contingency, ...], Field(strict=False)] = ()
    """What goes otherwise than planned, and when."""

    def _refusals(self) -> Iterator[str]:
        if self.leg and self.home is None:
            yield "home: needed with leg"
        for n, leg in enumerate(self.leg):
            yield from self._refused_leg(n, leg)
        before_s = -1.0
        for n, happening in enumerate(self.contingency):
            key = f"contingency[{n}].at_s"
            if happening.at_s is None:
                yield f"{key}: missing"
            elif happening.at_s <= before_s:
                yield f"{key}: must be above that of the one before"
            else:
                before_s = happening.at_s

    def _refused_leg(self, n: int, leg: Leg) -> Iterator[str]:
        limits = self.limits.model()
        if leg.kind == "land" and n + 1 < len(self.leg):
            yield f"leg[{n}]: nothing comes after land"
        if not isinstance(leg, PlaceLeg | OrbitLeg) or leg.speed_m_s is None:
            return
        most, why = limits.speed_m_s, "limits"
        if isinstance(leg, OrbitLeg):
            most = limits.orbit_speed_m_s(leg.radius_m)
            why = f"limits, on a circle of {leg.radius_m:g} m"
        if leg.speed_m_s > most:
            yield f"leg[{n}].speed_m_s: at most {most:.3g} m/s by its {why}"


Swerling = Annotated[int, Field(ge=0, le=4)]


class LobedAspectKeys(ModelTable):
    """Four lobes, in dB by the cosine of four times the aspect, of the same mean power."""

    makes = "effects.target_echoes:LobedAspect"

    kind: Literal["lobes"]
    depth_db: Annotated[float, Field(ge=0, le=30)]
    """Of the lobes: half of what lies between the strongest and the weakest."""


class TableAspectKeys(SceneTable):
    """Cross-sections as they were measured around a target."""

    kind: Literal["table"]
    angle_deg: Annotated[tuple[Azimuth, ...], Field(strict=False, min_length=2, max_length=10_000)]
    """From the nose clockwise, seen from above, rising and less than a turn."""
    gain_db: Annotated[tuple[Decibels, ...], Field(strict=False, min_length=2, max_length=10_000)]
    """At those, beside the stated rcs_m2; linear in between, all around."""

    def _refusals(self) -> Iterator[str]:
        if len(self.angle_deg) != len(self.gain_db):
            yield "gain_db: as many as angle_deg are needed"
        if (np.diff(self.angle_deg) <= 0).any() or self.angle_deg[-1] - self.angle_deg[0] >= 360:
            yield "angle_deg: must rise, by less than 360 in all"

    def model(self) -> Aspect:
        """Aspect for a model."""
        from plotfeed.models.effects.target_echoes import AspectTable

        return AspectTable(self.angle_deg, self.gain_db)


class TargetKeys(SceneTable):
    """How radars see all drones of a class."""

    target_class: Name = DRONE
    """Of the drones that this is about; those that state none are drone."""
    swerling: Swerling | None = None
    """Fluctuation: 0 none, 1 and 3 by scan, 2 and 4 by look; 3 and 4 with one strong part. Without
    it 1, and 2 for a radar of several transmitters."""
    aspect: Annotated[LobedAspectKeys | TableAspectKeys, Field(discriminator="kind")] | None = None
    """Cross-section by the side that is seen; a drone faces where it flies, north while it hovers.
    Goes well with swerling 3."""

    def echo(self, swerling: int | None) -> TargetEcho:
        """What is stated of such a drone, by its own case if it has one."""
        from plotfeed.models.effects.target_echoes import TargetEcho

        return TargetEcho(
            swerling=self.swerling if swerling is None else swerling,
            aspect=None if self.aspect is None else self.aspect.model(),
        )


def _of_distinct_classes(targets: tuple[TargetKeys, ...]) -> tuple[TargetKeys, ...]:
    classes = [target.target_class for target in targets]
    for name in classes:
        if classes.count(name) > 1:
            raise ValueError(f"target_class {name!r} is used twice")
    return targets


Targets = Annotated[
    tuple[TargetKeys, ...], Field(strict=False), AfterValidator(_of_distinct_classes)
]


class EchoesByClass:
    """Echoes of drones by their classes, as the [[target]] of a scene state them."""

    def __init__(self, targets: Sequence[TargetKeys]) -> None:
        self._numbers = {keys.target_class: n for n, keys in enumerate(targets)}
        from plotfeed.models.effects.target_echoes import TargetEchoes

        self._echoes = TargetEchoes.of([*(keys.echo(None) for keys in targets), None])

    def of(self, classes: Sequence[str]) -> TargetEchoes:
        """Echoes of drones of those classes, in their order; none of a class that none names."""
        numbers = [self._numbers.get(name, -1) for name in classes]
        return self._echoes.rows(np.array(numbers, np.int64))


def echoes_of(
    targets: Sequence[TargetKeys], target_class: str, swerling: int | None = None
) -> TargetEchoes:
    """The echo of one drone of a class, or of one with a case of its own; of nothing, none."""
    from plotfeed.models.effects.target_echoes import TargetEchoes

    usual = None if swerling is None else TargetKeys()
    keys = next((each for each in targets if each.target_class == target_class), usual)
    return TargetEchoes.of([None if keys is None else keys.echo(swerling)])


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
    """DJI SRT, CSV, ArduPilot DataFlash, MAVLink tlog, PX4 ULog, GPX, KML or NMEA; relative to the
    scene."""
    columns: dict[str, str] = Field(default={})
    """Of a CSV: its name for each of ours, as latitude_deg = "lat"."""
    altitude_reference: Annotated[AltitudeReference, Field(strict=False)] | None = None
    """Where the file does not say it: ellipsoid, mean_sea_level or above_takeoff."""
    gps_order: Literal["lat-lon", "lon-lat"] | None = None
    """Of an SRT that does not show it."""
    utc_offset_h: Annotated[float, Field(ge=-14, le=14)] = 0.0
    """Of the file's local time."""
    height_m: Annotated[float, Field(ge=-1000, le=100_000)] | None = None
    """Of a flight whose file has no heights: above take-off, or what altitude_reference says."""
    takeoff_height_m: Height | None = None
    geoid_undulation_m: Undulation | None = None
    """For this flight alone, in place of those of [telemetry]."""


class FlownKeys(MissionKeys):
    """What drones of the scene have in common, alone or in a swarm."""

    rcs_m2: Positive | None = None
    sound_power_db: Decibels | None = None
    """Re 1 pW."""
    size_m: Size | None = None
    """Across, as cameras see it."""
    target_class: Name = DRONE
    """What it is to sensors that recognise it: drone, bird or any other word."""
    swerling: Annotated[int, Field(ge=0, le=4)] | None = None
    """Swerling's case of its echoes; without it, that of its class in [[target]]."""
    model: Annotated[str, Field(max_length=64)] = ""
    """Such as Phantom 4: what sensors call it that identify it."""
    emitters: Annotated[tuple[EmitterKeys, ...], Field(strict=False)] = ()
    """What radiates on board."""
    start_s: NotNegative = 0.0
    """After the session's start."""
    path: Annotated[tuple[Waypoint, ...], Field(strict=False)] = ()
    speed_m_s: Speed | None = None
    repeat: bool = False
    """From the last waypoint or leg to the first, again and again; else it is gone at the last."""
    flight: FlightFile | None = None
    offset_enu_m: Enu = (0.0, 0.0, 0.0)
    """Moves home and all places by this, east, north and up."""
    claim: Annotated[tuple[ClaimFault, ...], Field(strict=False)] = ()
    """What it says of itself wrongly, if it is [cooperative]; of those that overlap the later one
    counts."""

    def _refusals(self) -> Iterator[str]:
        if bool(self.path) + bool(self.flight) + bool(self.leg) != 1:
            yield "path: a drone has either a path, a flight or legs"
        if self.path and len(self.path) < 2:
            yield "path: at least two waypoints are needed"
        if self.path and self.speed_m_s is None and any(w.speed_m_s is None for w in self.path[1:]):
            yield "speed_m_s: needed, unless every waypoint after the first has one"
        if self.flight and (self.speed_m_s or self.repeat or any(self.offset_enu_m)):
            yield "flight: speed_m_s, repeat and offset_enu_m belong to a path"
        if self.leg and self.speed_m_s:
            yield "speed_m_s: of a path; legs have their own, and limits"
        if self.leg and self.repeat and self.leg[-1].kind == "land":
            yield "repeat: who has landed is gone"
        for n, fault in enumerate(self.claim):
            if fault.from_s is None:
                yield f"claim[{n}].from_s: missing"


class Drone(FlownKeys):
    """A drone that the scene flies: along waypoints, by legs, or as recorded."""

    id: Name


class SwarmArea(SceneTable):
    """Anywhere in an upright cylinder, by the scene's seed."""

    kind: Literal["random"]
    radius_m: Positive
    """About where the drone would be alone."""
    height_spread_m: NotNegative = 0.0
    """From lowest to highest."""

    def places_enu_m(self, number: int, rng: np.random.Generator) -> Floats:
        """Where each is from the middle; (n, 3)."""
        radius_m = self.radius_m * np.sqrt(rng.random(number))
        angle = 2 * np.pi * rng.random(number)
        up_m = self.height_spread_m * (rng.random(number) - 0.5)
        return np.stack([radius_m * np.sin(angle), radius_m * np.cos(angle), up_m], axis=-1)


class SwarmRows(SceneTable):
    """A line from west to east, a square grid row by row, or a circle from north clockwise."""

    kind: Literal["line", "grid", "circle"]
    """Which formation."""
    spacing_m: Positive
    """Between neighbours."""

    def places_enu_m(self, number: int, _rng: np.random.Generator) -> Floats:
        """Where each is from the middle; (n, 3)."""
        k = np.arange(number)
        if self.kind == "circle":
            angle = 2 * np.pi * k / number
            radius_m = self.spacing_m / (2 * np.sin(np.pi / number)) if number > 1 else 0.0
            east_m, north_m = radius_m * np.sin(angle), radius_m * np.cos(angle)
        else:
            columns = number if self.kind == "line" else int(np.ceil(np.sqrt(number)))
            rows = -(-number // columns)
            east_m = (k % columns - (columns - 1) / 2) * self.spacing_m
            north_m = ((rows - 1) / 2 - k // columns) * self.spacing_m
        return np.stack([east_m, north_m, np.zeros(number)], axis=-1)


class Swarm(FlownKeys):
    """Many drones that fly alike: ID-1, ID-2 and so on, also in the identity of an emitter."""

    id: Annotated[Name, Field(max_length=58)]
    """Before the numbers of its drones."""
    number: Annotated[int, Field(ge=1, le=10_000)]
    """Of drones."""
    formation: Annotated[SwarmArea | SwarmRows, Field(discriminator="kind")]
    """Where each is from where one would be alone, all the way."""
    stagger_s: NotNegative = 0.0
    """Each starts so much later than the one before."""

    def _refusals(self) -> Iterator[str]:
        if self.flight is not None:
            yield "flight: a swarm has a path or legs"

    @property
    def names(self) -> list[str]:
        """Ids of its drones."""
        return [f"{self.id}-{n}" for n in range(1, self.number + 1)]

    def members(self, seed: int) -> Iterator[Drone]:
        """Drones of the swarm, by the seed of the scene."""
        shared = {name: getattr(self, name) for name in FlownKeys.model_fields}
        rng = Chance(seed, f"swarm/{self.id}").rng(Purpose.FORMATION, 0)
        places = self.formation.places_enu_m(self.number, rng) + np.array(self.offset_enu_m)
        for n, (name, place) in enumerate(zip(self.names, places.tolist(), strict=True)):
            emitters = tuple(
                e.model_copy(update={"identity": f"{e.identity}-{n + 1}"}) if e.identity else e
                for e in self.emitters
            )
            own = {"offset_enu_m": place, "start_s": self.start_s + n * self.stagger_s}
            yield Drone(**shared | own | {"id": name, "emitters": emitters})


@dataclass(frozen=True, slots=True)
class Fleet:
    """All that a scene flies itself."""

    single: Sequence[Drone]
    swarms: Sequence[Swarm]
    cooperative: CooperativeKeys | None
    seed: int
    waiting: Sequence[Swarm] = ()
    """Those of stories, which are there when their story is told."""

    @property
    def drones(self) -> tuple[Drone, ...]:
        """Each drone, those of swarms among them."""
        members = (drone for swarm in self.swarms for drone in swarm.members(self.seed))
        return (*self.single, *members)

    @property
    def kinds(self) -> tuple[FlownKeys, ...]:
        """What drones have in common: each that is alone, and each swarm once."""
        return (*self.single, *self.swarms, *self.waiting)

    @property
    def names(self) -> list[str]:
        """Ids of all drones."""
        return [d.id for d in self.single] + [name for s in self.swarms for name in s.names]

    @property
    def waiting_names(self) -> list[str]:
        """Ids of drones of stories."""
        return [name for swarm in self.waiting for name in swarm.names]

    @property
    def cooperative_names(self) -> list[str]:
        """Ids of those that report themselves."""
        return [] if self.cooperative is None else self.cooperative.those_of(*self._by_name())

    def refusals(self) -> Iterator[str]:
        """Names that are not one drone's, and claims that nobody says."""
        known: set[str] = set()
        keys = [("drone", n, [d.id]) for n, d in enumerate(self.single)]
        keys += [("swarm", n, [s.id, *s.names]) for n, s in enumerate(self.swarms)]
        for kind, n, names in keys:
            for name in names:
                if name in known:
                    yield f"{kind}[{n}].id: the id {name!r} is used twice"
                known.add(name)
        problem = self.cooperative and self.cooperative.problem(*self._by_name())
        if problem:
            yield f"{COOPERATIVE}: {problem}"
        say = set(self.cooperative_names)
        for (kind, n, names), each in zip(keys, (*self.single, *self.swarms), strict=True):
            if each.claim and say.isdisjoint(names):
                yield f"{kind}[{n}].claim: the drone says nothing: it is not [cooperative]"

    def _by_name(self) -> tuple[list[str], dict[str, list[str]]]:
        return self.names, {swarm.id: swarm.names for swarm in self.swarms}

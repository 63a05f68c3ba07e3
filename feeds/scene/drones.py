"""The drones that a scene flies by itself: the keys of paths and flights, of one or of many."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from plotfeed.feeds.scene.claim_keys import COOPERATIVE, ClaimFault, CooperativeKeys
from plotfeed.feeds.scene.fields import (
    Decibels,
    Enu,
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
from plotfeed.feeds.scene.mission_keys import MissionKeys
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.state import DRONE, AltitudeReference, Floats


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
    """DJI SRT, CSV of whatever exporter, ArduPilot DataFlash, MAVLink tlog, PX4
    ULog, GPX, KML or NMEA; relative to the scene."""
    columns: dict[str, str] = Field(default={})
    """Of a CSV: the file's name for each of ours, such as latitude_deg = "lat"."""
    altitude_reference: Annotated[AltitudeReference, Field(strict=False)] | None = None
    """Where the file does not say it: ellipsoid, mean_sea_level or above_takeoff."""
    gps_order: Literal["lat-lon", "lon-lat"] | None = None
    """Of an SRT that does not show it."""
    utc_offset_h: Annotated[float, Field(ge=-14, le=14)] = 0.0
    """Of the file's local time."""
    height_m: Annotated[float, Field(ge=-1000, le=100_000)] | None = None
    """Of a flight whose file has no heights: above take-off, or what altitude_reference says."""
    takeoff_height_m: Height | None = None
    geoid_undulation_m: Annotated[float, Field(ge=-150, le=150)] | None = None
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
    """Back from the last waypoint to the first, or from the last leg to the first, and again;
    otherwise it is gone at the last."""
    flight: FlightFile | None = None
    offset_enu_m: Enu = (0.0, 0.0, 0.0)
    """Moves home and all places of path, legs and contingencies by this, east, north and up."""
    claim: Annotated[tuple[ClaimFault, ...], Field(strict=False)] = ()
    """What it says of itself otherwise than it is, where it is [cooperative]; of those that overlap
    the later one counts."""

    @model_validator(mode="after")
    def _flies(self) -> Self:
        if bool(self.path) + bool(self.flight) + bool(self.leg) != 1:
            raise ValueError("path: a drone has either a path, a flight or legs")
        if self.path and len(self.path) < 2:
            raise ValueError("path: at least two waypoints are needed")
        if self.path and self.speed_m_s is None and any(w.speed_m_s is None for w in self.path[1:]):
            raise ValueError("speed_m_s: needed, unless every waypoint after the first has one")
        if self.flight and (self.speed_m_s or self.repeat or any(self.offset_enu_m)):
            raise ValueError("flight: speed_m_s, repeat and offset_enu_m belong to a path")
        if self.leg and self.speed_m_s:
            raise ValueError("speed_m_s: of a path; legs have their own, and limits")
        if self.leg and self.repeat and self.leg[-1].kind == "land":
            raise ValueError("repeat: who has landed is gone")
        for n, fault in enumerate(self.claim):
            if fault.from_s is None:
                raise ValueError(f"claim[{n}].from_s: missing")
        return self


class Drone(FlownKeys):
    """A drone that the scene itself flies: along waypoints, leg by leg, or as recorded."""

    id: Name


class SwarmArea(SceneTable):
    """Anywhere in an upright cylinder, alike for all parts of it, by the scene's seed."""

    kind: Literal["random"]
    """Which formation."""
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
    """Many drones that fly alike, each from its own place: ID-1, ID-2 and so on.

    What a drone has, each of them has; an emitter's identity is followed by its number.
    """

    id: Annotated[Name, Field(max_length=58)]
    """Before the numbers of its drones."""
    number: Annotated[int, Field(ge=1, le=10_000)]
    """Of drones."""
    formation: Annotated[SwarmArea | SwarmRows, Field(discriminator="kind")]
    """Where each is from where one would be alone, all the way."""
    stagger_s: NotNegative = 0.0
    """Each starts so much later than the one before."""

    @model_validator(mode="after")
    def _is_no_recording(self) -> Self:
        if self.flight is not None:
            raise ValueError("flight: a swarm has a path or legs")
        return self

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

    def check(self) -> None:
        """Raise `ValueError` where names are not one drone's, or nobody says what is claimed."""
        known: set[str] = set()
        keys = [("drone", n, [d.id]) for n, d in enumerate(self.single)]
        keys += [("swarm", n, [s.id, *s.names]) for n, s in enumerate(self.swarms)]
        for kind, n, names in keys:
            for name in names:
                if name in known:
                    raise ValueError(f"{kind}[{n}].id: the id {name!r} is used twice")
                known.add(name)
        problem = self.cooperative and self.cooperative.problem(*self._by_name())
        if problem:
            raise ValueError(f"{COOPERATIVE}: {problem}")
        say = set(self.cooperative_names)
        for (kind, n, names), each in zip(keys, (*self.single, *self.swarms), strict=True):
            if each.claim and say.isdisjoint(names):
                raise ValueError(
                    f"{kind}[{n}].claim: the drone says nothing: it is not [cooperative]"
                )

    def _by_name(self) -> tuple[list[str], dict[str, list[str]]]:
        return self.names, {swarm.id: swarm.names for swarm in self.swarms}

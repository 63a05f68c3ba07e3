"""Stories of a scene: named sets of changes that begin by a word and are taken back by another."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from plotfeed.feeds.scene.changes import ChangeError, changed
from plotfeed.feeds.scene.claim_keys import ClaimFault
from plotfeed.feeds.scene.drones import Contingency, EmitterKeys, Swarm, SwarmArea, Waypoint
from plotfeed.feeds.scene.fields import Enu, Name, SceneTable
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.sensor_keys import SensorGeometry

MAX_TITLE = 60
MAX_TEXT = 300
Sets = Mapping[str, Mapping[str, Any]]  # Keys that sensors have otherwise, by their ids


class StoryChange(SceneTable):
    """What a story does to a sensor or a scripted drone."""

    sensor: Name | None = None
    """Whose keys are otherwise."""
    set: Annotated[dict[str, Any], Field(min_length=1)] | None = None
    """Its keys meanwhile, as of an event."""
    drone: Name | None = None
    """To which something happens."""
    contingency: Contingency | None = None
    """What, without at_s; when the story is taken back, it resumes."""
    claim: ClaimFault | None = None
    """How it says meanwhile otherwise where it is, without from_s and to_s."""

    def _refusals(self) -> Iterator[str]:
        if (self.sensor is None) == (self.drone is None):
            yield "expected either sensor or drone"
        if (self.set is None) != (self.sensor is None):
            yield "expected set with a sensor, and with no drone"
        happens = [self.contingency, self.claim].count(None) == 1
        if happens != (self.drone is not None):
            yield "expected contingency or claim with a drone, and with no sensor"
        if self.contingency is not None and self.contingency.at_s is not None:
            yield "contingency.at_s: it happens when the story begins"
        if self.claim is not None and not {None} >= {self.claim.from_s, self.claim.to_s}:
            yield "claim: from_s and to_s: it holds for as long as the story"


class Story(SceneTable):
    """What happens at a word, all of it at once."""

    id: Name
    """By which it is begun and taken back."""
    title: Annotated[str, Field(max_length=MAX_TITLE)] = ""
    """In a few words, for a button; without it, its id."""
    text: Annotated[str, Field(max_length=MAX_TEXT)] = ""
    """What there is to see, for people."""
    change: Annotated[tuple[StoryChange, ...], Field(strict=False)] = ()
    """What is otherwise meanwhile."""
    swarm: Annotated[tuple[Swarm, ...], Field(strict=False)] = ()
    """Drones that are there from when it begins until it is taken back."""

    def _refusals(self) -> Iterator[str]:
        if not self.change and not self.swarm:
            yield "change: a story has changes or swarms"

    @property
    def sets(self) -> Sets:
        """What its sensors have otherwise; of a sensor named twice, both."""
        found: dict[str, dict[str, Any]] = {}
        for change in self.change:
            if change.sensor is not None:
                found[change.sensor] = {**found.get(change.sensor, {}), **(change.set or {})}
        return found

    @property
    def drone_changes(self) -> Sequence[StoryChange]:
        """Changes of drones, in the order in which they are written."""
        return [change for change in self.change if change.drone is not None]

    def problems(
        self, sensors: Mapping[str, Sensor], drones: Iterable[str], claiming: Iterable[str]
    ) -> Iterator[tuple[str, str]]:
        """Keys of what cannot be in a scene with those sensors and drones, and why.

        `claiming` are the drones that say something of themselves.
        """
        drones, claiming = set(drones), set(claiming)
        for n, change in enumerate(self.change):
            key = f"change[{n}]"
            if change.sensor is not None:
                if change.sensor not in sensors:
                    yield f"{key}.sensor", f"no sensor has the id {change.sensor!r}"
                    continue
                try:
                    changed(sensors[change.sensor], change.set or {})
                except ChangeError as error:
                    yield f"{key}.set", str(error)
            elif change.drone not in drones:
                yield f"{key}.drone", f"the scene flies no {change.drone!r}"
            elif change.claim is not None and change.drone not in claiming:
                yield f"{key}.claim", "the drone says nothing: it is not [cooperative]"
        for n, swarm in enumerate(self.swarm):
            if taken := drones & {swarm.id, *swarm.names}:
                yield f"swarm[{n}].id", f"the id {min(taken)!r} is used twice"
            if swarm.claim:
                yield f"swarm[{n}].claim", "drones of a story are not [cooperative]"


class StoryState(NamedTuple):
    """A story of a session, and whether it is being told."""

    story: Story
    since_utc_ns: int | None
    """When it began; None while it is not on."""


def usual_stories(sensors: Sequence[Sensor]) -> list[Story]:
    """Stories that any scene with those sensors has, unless its own have the same ids."""
    main = sensors[0]
    radar = next((s for s in sensors if s.geometry is not SensorGeometry.BEARINGS), main)
    found = [
        Story(
            id="bad-link",
            title="The link goes bad",
            text="Messages of all sensors come late and unevenly, and a quarter is lost, in "
            "bursts.",
            change=tuple(StoryChange(sensor=s.id, set={"link": _bad_link(s)}) for s in sensors),
        ),
        Story(
            id="outage",
            title=f"Outage of {main.id}"[:MAX_TITLE],
            text=f"Nothing of {main.id} arrives.",
            change=(StoryChange(sensor=main.id, set={"link": {"down": True}}),),
        ),
        _of_drift(radar),
        _of_jamming(sensors),
        _of_swarm(radar),
    ]
    return [story for story in found if story is not None]


def _bad_link(sensor: Sensor) -> dict[str, Any]:
    """Keys of a link that make it bad whatever it was before."""
    loss = {"kind": "gilbert-elliott", "mean_loss": 0.25, "mean_burst": 6.0}
    if sensor.link is not None and sensor.link.distribution == "table":
        return {"latency_ms": 600.0, "loss": loss}
    return {"latency_ms": 600.0, "jitter_ms": 150.0, "loss": loss}


def _of_drift(radar: Sensor) -> Story | None:
    """North of it is off, and drifts: by about a beamwidth."""
    beamwidth_deg = getattr(radar, "azimuth_beamwidth_deg", None) or 2.0
    off_deg = float(np.clip(beamwidth_deg, 1.0, 10.0))
    range_m = max(0.005 * radar.range_max_m, 10.0)
    keys: dict[str, Any] = {
        "bias": {"azimuth_offset_deg": off_deg},
        "drift": {
            "time_constant_s": 20.0,
            "sigma_azimuth_deg": off_deg / 2,
            "sigma_range_m": range_m,
        },
    }
    return _possible(
        "drift",
        f"{radar.id} drifts",
        f"What {radar.id} measures slips by about {off_deg:.3g}° and {range_m:.0f} m, and wanders.",
        [(radar, keys)],
    )


JAMMER_EIRP_W = 10.0
MOST_JAMMED = 20


def _of_jamming(sensors: Sequence[Sensor]) -> Story | None:
    """One jammer in the north-east for each band that a radar or an RF sensor listens in."""
    heard = [(s, band) for s in sensors if (band := _band_hz(s)) is not None][:MOST_JAMMED]
    if not heard:
        return None
    first, _ = heard[0]
    east_m, north_m, _ = first.position_enu_m
    away_m = 0.4 * first.range_max_m
    place = {"east_m": east_m + away_m, "north_m": north_m + away_m, "above_site_m": 100.0}
    names = ", ".join(sensor.id for sensor, _ in heard)
    text = f"A jammer in the north-east of {first.id} drowns what is faint: {names}."
    jammers = ({**place, "eirp_w": JAMMER_EIRP_W, **band} for _, band in heard)
    sets = [{"jamming": {"story": jammer}} for jammer in jammers]
    return _possible("jamming", "Jamming", text, zip([s for s, _ in heard], sets, strict=True))


def _band_hz(sensor: Sensor) -> dict[str, float] | None:
    """Where a jammer of a sensor radiates; None for what no jammer drowns."""
    signals = getattr(sensor, "signals_hz", None)
    if signals:
        frequency_hz, bandwidth_hz = signals[0]
        return {"frequency_hz": frequency_hz, "bandwidth_hz": max(2 * bandwidth_hz, 1e6)}
    if sensor.band_hz is None:
        return None
    low, high = sensor.band_hz
    return {"frequency_hz": (low + high) / 2, "bandwidth_hz": max(high - low, 1e6)}


SWARM_OF = 12
SWARM_NEAREST_M, SWARM_FURTHEST_M = 600.0, 8_000.0
SWARM_M_S = 22.0


def _of_swarm(radar: Sensor) -> Story:
    """A swarm that comes out of the south-east to that radar, and goes back."""
    east_m, north_m, _ = radar.position_enu_m
    away_m = float(np.clip(0.5 * radar.range_max_m, SWARM_NEAREST_M, SWARM_FURTHEST_M))
    south_east: Enu = (away_m / np.sqrt(2), -away_m / np.sqrt(2), 0.0)
    path = [
        Waypoint(east_m=east_m + e, north_m=north_m + n, above_site_m=up_m)
        for e, n, up_m in ((*south_east[:2], 120.0), (0.0, 0.0, 60.0))
    ]
    swarm = Swarm(
        id="story-swarm",
        number=SWARM_OF,
        formation=SwarmArea(kind="random", radius_m=150.0, height_spread_m=40.0),
        rcs_m2=0.02,
        size_m=0.4,
        sound_power_db=85.0,
        emitters=(
            EmitterKeys(frequency_hz=2.45e9, bandwidth_hz=10e6, eirp_dbm=20.0, kind="control"),
        ),
        speed_m_s=SWARM_M_S,
        repeat=True,
        path=tuple(path),
    )
    return Story(
        id="swarm",
        title="A swarm",
        text=f"{SWARM_OF} drones come out of the south-east, {away_m / 1000:.3g} km away.",
        swarm=(swarm,),
    )


def _possible(
    name: str, title: str, text: str, sets: Iterable[tuple[Sensor, Mapping[str, Any]]]
) -> Story | None:
    """A story of those of the sensors that can be so; None if none can."""
    changes = []
    for sensor, keys in sets:
        try:
            changed(sensor, keys)
        except ChangeError:
            continue
        changes.append(StoryChange(sensor=sensor.id, set=dict(keys)))
    if not changes:
        return None
    return Story(id=name, title=title[:MAX_TITLE], text=text[:MAX_TEXT], change=tuple(changes))

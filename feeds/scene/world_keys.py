"""The keys of what there is about sensors and drones: weather, jammers, birds and cars, terrain."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from plotfeed.feeds.scene.fields import (
    Azimuth,
    ForAWhile,
    Frequency,
    Location,
    Name,
    NotNegative,
    Positive,
    SceneTable,
    Size,
    Speed,
    used_twice,
)
from plotfeed.models.propagation import USUAL_K


class WeatherKeys(SceneTable):
    """Weather, the same as far as a sensor reaches."""

    rain_mm_h: Annotated[float, Field(ge=0, le=300)] = 0.0
    """Weakens the echoes of radars by their frequency (ITU-R P.838-3)."""
    polarisation: Literal["horizontal", "vertical", "circular"] = "horizontal"
    """Of the radars that the rain weakens."""
    rain_echo: bool = False
    """Whether rain sends echoes back to active radars, unhelped by Doppler filters."""
    vapour_g_m3: Annotated[float, Field(ge=0, le=50)] | None = None
    """Of water in the air, 7.5 usually; with it, gases weaken echoes (ITU-R P.676), below 54 GHz.
    """
    wind_m_s: Annotated[float, Field(ge=0, le=60)] = 0.0
    """At microphones, whose noise it adds to."""


class WeatherSpell(WeatherKeys, ForAWhile):
    """Weather of all sensors for a while; where spells overlap, the later one."""


class JammerKeys(Location):
    """A transmitter of noise, and its place."""

    eirp_w: Positive
    """What it radiates towards the sensor, over isotropic."""
    frequency_hz: Frequency
    """Centre of its band."""
    bandwidth_hz: Positive
    """Over which it spreads its noise; receivers beside it hear nothing."""
    sidelobe_db: Annotated[float, Field(ge=-200, le=0)] = -25.0
    """Gain beside a radar's beam, at least; below the beam's."""


class JammerSpell(JammerKeys, ForAWhile):
    """A jammer of all sensors for a while."""

    id: Name
    """By which sensors know it."""


Way = Annotated[tuple[Location, ...], Field(strict=False, min_length=2, max_length=10_000)]
MOST_SPIKY_ORDER = 50.0  # Of K-distributed clutter: its power varies by a seventh
Area = Annotated[tuple[Location, ...], Field(strict=False, min_length=3, max_length=10_000)]


class BirdsKeys(SceneTable):
    """A flock, or a single bird, that follows a leader along a path."""

    id: Name
    """In the ledger its birds are bird/ID-1 and so on."""
    path: Way
    """Of the leader."""
    count: Annotated[int, Field(ge=1, le=10_000)] = 1
    """Birds in it."""
    mass_kg: Annotated[float, Field(ge=0.005, le=20)] = 0.8
    """Of each, by which its speed follows."""
    speed_m_s: Speed | None = None
    """Over the ground; without it, the airspeed of such birds, 15.9 m^0.13."""
    spread_m: Annotated[float, Field(ge=0, le=10_000)] = 15.0
    """Standard deviation about the leader at first, on each axis."""
    wander_m_s: Annotated[float, Field(ge=0, le=50)] = 1.0
    """Standard deviation of velocities about the leader's, on each axis."""
    wander_s: Annotated[float, Field(ge=0.1, le=3600)] = 5.0
    """After which 1/e of such a velocity is left, on average."""
    rcs_m2: Positive = 0.002
    """Radar cross-section of each."""
    size_m: Size = 0.5
    """Size across of each, for cameras."""
    start_s: NotNegative = 0.0
    """After the session's start."""
    repeat: bool = True
    """Back from the last place to the first, and again; otherwise they are gone at the last."""


class RoadKeys(SceneTable):
    """A road with cars on it, both ways."""

    id: Name
    """In the ledger its cars are vehicle/ID-1 and so on."""
    path: Way
    """Of the road; cars turn at its ends."""
    cars_per_h: Annotated[float, Field(gt=0, le=20_000)]
    """That pass a place each way, on average (Poisson)."""
    speed_m_s: Speed
    """Of all cars."""
    rcs_m2: Positive = 10.0
    """Radar cross-section of each."""
    size_m: Size = 4.0
    """Size across of each, for cameras."""


class TurbineKeys(Location):
    """A wind turbine, by the place of its hub: a tower, and blades with fast tips."""

    id: Name
    """In the ledger it is turbine/ID, its tips turbine/ID-1 and so on."""
    radius_m: Annotated[float, Field(ge=0.5, le=150)]
    """Of its rotor."""
    tip_speed_m_s: Annotated[float, Field(ge=0.1, le=150)] = 75.0
    """Of the tips, which is 60 to 90 m/s where there is wind."""
    axis_azimuth_deg: Azimuth = 270.0
    """Where its rotor looks: to where the wind comes from."""
    blades: Annotated[int, Field(ge=0, le=6)] = 3
    """Of its rotor."""
    blade_rcs_m2: Positive = 10.0
    """Radar cross-section of a tip."""
    tower_rcs_m2: Positive = 100.0
    """Radar cross-section of the tower, at the hub."""
    tower_width_m: Annotated[float, Field(ge=0, le=30)] = 4.0
    """Of the tower, which weakens radio signals that pass below the hub; 0 for none."""


class ClutterKeys(SceneTable):
    """A region where radars have plots of woods, houses or waves."""

    id: Name
    """In the ledger its plots are of clutter/ID."""
    area: Area
    """Corners of the region, one after the other."""
    plots_per_km2: Annotated[float, Field(gt=0, le=10_000)] | None = None
    """In a scan, on average over maps; or else threshold_db is given."""
    threshold_db: Annotated[float, Field(ge=3, le=60)] | None = None
    """A fixed threshold over the mean clutter that filters leave; plots are the cells above it, of
    K-distributed power of order `shape`."""
    texture_stays: bool = True
    """With threshold_db: whether spiky places stay, as on land, or change each scan, as waves do.
    """
    cell_m: Annotated[float, Field(ge=1, le=10_000)] = 50.0
    """Side of the squares, each with its own average of plots."""
    shape: Annotated[float, Field(ge=0.05, le=1000)] = 0.5
    """Of the gamma distribution by which these averages differ: less is spikier."""
    rate_m_s: Annotated[float, Field(ge=0, le=100)] = 0.2
    """Standard deviation of range rates, where they are measured."""

    def _refusals(self) -> Iterator[str]:
        if (self.plots_per_km2 is None) == (self.threshold_db is None):
            yield "expected plots_per_km2 or threshold_db"
        if self.threshold_db is not None and self.shape > MOST_SPIKY_ORDER:
            yield (f"shape: at most {MOST_SPIKY_ORDER:g} with threshold_db: beyond it is noise")


HORIZONS = "horizons"  # What a recording has in the place of the files of [terrain]


class TerrainKeys(SceneTable):
    """What hides drones from all sensors, and weakens what it does not hide."""

    elevation: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Rasters of the ground, .hgt tiles or GeoTIFF (extra terrain), relative to the scene; the
    first that knows a place counts."""
    elevation_above: Literal["sea-level", "ellipsoid"] = "sea-level"
    """What their heights are above: of SRTM and Copernicus, sea level."""
    buildings: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """GeoJSON of footprints, polygons by longitude and latitude; relative to the scene."""
    building_height: Annotated[str, Field(min_length=1)] = "height"
    """Property of a footprint with its height above ground, in metres."""
    diffraction: bool = False
    """Whether signals bend over the highest edge in their way, as over a knife's."""
    earth_radius_factor: Annotated[float, Field(ge=0.5, le=10)] = USUAL_K
    """Of the Earth's radius, by refraction: 4/3 in average air, 1 for straight rays."""
    step_m: Annotated[float, Field(ge=1, le=1000)] = 30.0
    """Between samples of the ground; at least a 4000th of the furthest range."""

    def _refusals(self) -> Iterator[str]:
        if not self.elevation and not self.buildings:
            yield "elevation: needed, or buildings"


class WorldKeys(SceneTable):
    """What a scene may name beside sensors and drones. What it does not name costs nothing."""

    terrain: TerrainKeys | None = None
    """The ground and buildings; without it, nothing stands in the way."""
    weather: Annotated[tuple[WeatherSpell, ...], Field(strict=False)] = ()
    """Of all sensors, by time; it counts over a sensor's own."""
    jammer: Annotated[tuple[JammerSpell, ...], Field(strict=False)] = ()
    """Of all sensors, by time."""
    birds: Annotated[tuple[BirdsKeys, ...], Field(strict=False)] = ()
    """Flocks, which sensors look at as they do at drones."""
    road: Annotated[tuple[RoadKeys, ...], Field(strict=False)] = ()
    """Cars, which sensors look at as they do at drones."""
    turbine: Annotated[tuple[TurbineKeys, ...], Field(strict=False)] = ()
    """Wind turbines, which sensors look at as they do at drones."""
    clutter: Annotated[tuple[ClutterKeys, ...], Field(strict=False)] = ()
    """Regions with plots of radars that measure range and azimuth, in every scan."""

    def _refusals(self) -> Iterator[str]:
        for kind in ("jammer", "birds", "road", "turbine", "clutter"):
            yield from used_twice(kind, (each.id for each in getattr(self, kind)))

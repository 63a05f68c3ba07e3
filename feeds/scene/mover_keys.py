"""The keys of what radars see beside drones: birds, cars, wind turbines, and clutter that stays."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from plotfeed.feeds.scene.fields import (
    Azimuth,
    Location,
    Name,
    NotNegative,
    Positive,
    SceneTable,
    Size,
    Speed,
)

Way = Annotated[tuple[Location, ...], Field(strict=False, min_length=2, max_length=10_000)]
MOST_SPIKY_ORDER = 50.0
"""Of K-distributed clutter: its power varies by a seventh."""
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
    """Standard deviation of places about the leader when they set off, on each axis."""
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
    """That pass a place each way; at a time there are a Poisson number of cars on the road."""
    speed_m_s: Speed
    """Of all cars."""
    rcs_m2: Positive = 10.0
    """Radar cross-section of each."""
    size_m: Size = 4.0
    """Size across of each, for cameras."""


class TurbineKeys(Location):
    """A wind turbine, by the place of its hub: a tower in the way, and blades with fast tips."""

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
    """Of the tower, as which it weakens radio signals that pass it below the hub; 0 for none."""


class ClutterKeys(SceneTable):
    """A region from which radars have plots of what stays in its place: woods, houses, waves."""

    id: Name
    """In the ledger its plots are of clutter/ID."""
    area: Area
    """Corners of the region, one after the other."""
    plots_per_km2: Annotated[float, Field(gt=0, le=10_000)] | None = None
    """In a scan, on average over all maps that a seed may draw; or else threshold_db is given."""
    threshold_db: Annotated[float, Field(ge=3, le=60)] | None = None
    """Of a detector with a fixed threshold, over the mean of what its filters leave of the clutter:
    plots are what crosses it, in the radar's cells, of K-distributed power of the order `shape`."""
    texture_stays: bool = True
    """With threshold_db, whether spiky places are the same in every scan, as on land, or others in
    each, as of waves."""
    cell_m: Annotated[float, Field(ge=1, le=10_000)] = 50.0
    """Side of the squares, each of which has as many plots on average in every scan."""
    shape: Annotated[float, Field(ge=0.05, le=1000)] = 0.5
    """Of the gamma distribution by which these averages differ: less is spikier."""
    rate_m_s: Annotated[float, Field(ge=0, le=100)] = 0.2
    """Standard deviation of range rates, where they are measured."""

    @model_validator(mode="after")
    def _comes_somehow(self) -> Self:
        if (self.plots_per_km2 is None) == (self.threshold_db is None):
            raise ValueError("expected plots_per_km2 or threshold_db")
        if self.threshold_db is not None and self.shape > MOST_SPIKY_ORDER:
            raise ValueError(
                f"shape: at most {MOST_SPIKY_ORDER:g} with threshold_db: beyond it is noise"
            )
        return self

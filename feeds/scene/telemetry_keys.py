"""The keys of how telemetry is taken, and of what drones are that tell nothing of themselves."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from plotfeed.feeds.scene.fields import Decibels, Height, NotNegative, Positive, SceneTable, Size
from plotfeed.feeds.scene.mapping_keys import TelemetryMapping
from plotfeed.feeds.scene.source_keys import KINDS, TelemetrySource


class Telemetry(SceneTable):
    """How telemetry is taken, from MQTT, from files and from live sources."""

    stale_after_s: Positive = 3.0
    """A drone without news flies on for this long, and is then gone."""
    takeoff_height_m: Height | None = None
    """Above the ellipsoid; added to altitudes above take-off, which are refused without it."""
    geoid_undulation_m: Annotated[float, Field(ge=-150, le=150)] | None = None
    """Of mean sea level above the ellipsoid; without it, that of the geoid EGM96 at each place."""
    geoid_grid: str | None = None
    """A grid of a finer geoid, GeoTIFF or GTX, that PROJ reads, in place of the package's; relative
    to the scene. Needs the extra geoid."""
    max_ahead_s: NotNegative = 2.0
    """Telemetry from further in the future is refused."""
    max_age_s: Positive = 60.0
    """Telemetry older than this is refused."""
    max_speed_m_s: Annotated[float, Field(gt=0, le=1000)] = 150.0
    """Of a drone: what it cannot have flown to at this speed, with 30 m of grace, is refused.

    Multicopters reach 60 m/s, those with jets 150 m/s. No faster velocity is fitted either.
    """
    max_drones: Annotated[int, Field(ge=1, le=1_000_000)] = 10_000
    """Known at a time."""
    max_new_drones_per_s: Annotated[int, Field(ge=1, le=1_000_000)] = 500
    """That become known in a second; as many again may of those that were refused, and come again.
    """
    forget_after_s: Annotated[float, Field(ge=1, le=86_400)] = 60.0
    """A drone without news for so long is forgotten: what comes under its name is a new drone.

    One that reported once is forgotten when no sensor can see it any more.
    """
    rcs_m2: Positive = 0.01
    """Radar cross-section of a drone that states none."""
    sound_power_db: Decibels = 80.0
    """Sound power level, re 1 pW, of a drone that states none."""
    size_m: Size = 0.35
    """Size across of a drone that states none, and of those that telemetry brings."""
    source: Annotated[tuple[TelemetrySource, ...], Field(strict=False, max_length=64)] = ()
    """Live sources that the session listens to itself, beside what comes by MQTT."""
    mapping: Annotated[tuple[TelemetryMapping, ...], Field(strict=False, max_length=64)] = ()
    """JSON that other systems publish on the session's broker, and how it becomes telemetry."""

    @model_validator(mode="after")
    def _aircraft_are_fast(self) -> Self:
        is_traffic = any(KINDS[source.address.kind].is_traffic for source in self.source)
        if is_traffic and "max_speed_m_s" not in self.model_fields_set:
            raise ValueError(
                "max_speed_m_s: must be stated beside ADS-B, since aircraft fly faster than 150 "
                "m/s; 350 takes airliners"
            )
        return self

    @model_validator(mode="after")
    def _one_sea_level(self) -> Self:
        if self.geoid_grid is not None and self.geoid_undulation_m is not None:
            raise ValueError("geoid_grid: either it or geoid_undulation_m says where sea level is")
        return self

"""The keys of what there is about sensors and drones, the same for all of them."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from plotfeed.feeds.scene.fields import SceneTable
from plotfeed.feeds.scene.mover_keys import BirdsKeys, ClutterKeys, RoadKeys, TurbineKeys
from plotfeed.feeds.scene.terrain_keys import TerrainKeys
from plotfeed.feeds.scene.weather_keys import JammerSpell, WeatherSpell


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

    @model_validator(mode="after")
    def _its_names_are_unique(self) -> Self:
        for kind in ("jammer", "birds", "road", "turbine", "clutter"):
            ids = [each.id for each in getattr(self, kind)]
            for n, name in enumerate(ids):
                if name in ids[:n]:
                    raise ValueError(f"{kind}[{n}].id: the id {name!r} is used twice")
        return self

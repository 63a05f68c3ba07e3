"""The keys of what there is about sensors and drones, the same for all of them."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from plotfeed.feeds.scene.fields import SceneTable
from plotfeed.feeds.scene.mover_keys import BirdsKeys, ClutterKeys, RoadKeys, TurbineKeys
from plotfeed.feeds.scene.weather_keys import JammerSpell, WeatherSpell
from plotfeed.models.propagation import USUAL_K

HORIZONS = "horizons"
"""What a recording has in the place of the files of [terrain]."""


class TerrainKeys(SceneTable):
    """What hides drones from all sensors, and weakens what it does not hide."""

    elevation: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Rasters of the ground: .hgt tiles, whose names say where they lie, or GeoTIFF, which needs
    the extra terrain; relative to the scene. Of several that know a place, the first counts."""
    elevation_above: Literal["sea-level", "ellipsoid"] = "sea-level"
    """What their heights are above; those of SRTM and Copernicus are above sea level."""
    buildings: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """GeoJSON of footprints, polygons by longitude and latitude; relative to the scene."""
    building_height: Annotated[str, Field(min_length=1)] = "height"
    """Which property of a footprint says how high it stands above its ground, in metres. Where no
    raster knows the ground, it is as high as the site."""
    diffraction: bool = False
    """Whether signals bend over the edge that stands highest in their way, as over a knife's; else
    what hides a drone cuts it off."""
    earth_radius_factor: Annotated[float, Field(ge=0.5, le=10)] = USUAL_K
    """Of the Earth as bent rays have it: 4/3 in average air, 1 where rays are straight."""
    step_m: Annotated[float, Field(ge=1, le=1000)] = 30.0
    """Between samples of the ground; at least a 4000th of the furthest range."""

    @model_validator(mode="after")
    def _stands_somewhere(self) -> Self:
        if not self.elevation and not self.buildings:
            raise ValueError("elevation: needed, or buildings")
        return self


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

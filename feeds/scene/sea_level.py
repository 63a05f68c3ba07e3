"""What a scene takes for mean sea level, and heights above it made heights above the ellipsoid."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.frames import LocalFrame, geoid_undulation_m
from plotfeed.models.state import Floats
from plotfeed.proto.errors import PlotfeedError

# From latitudes and longitudes, degrees, to heights of sea level above the ellipsoid, metres.
Undulation = Callable[[ArrayLike, ArrayLike], Floats]


class SeaLevel:
    """Mean sea level: as high as is stated, or by a grid of PROJ's, or by the package's EGM96."""

    def __init__(self, stated_m: float | None = None, *, grid: Path | None = None) -> None:
        """Raises `PlotfeedError` if there is no such grid, or nothing to read it with."""
        self._stated_m = stated_m
        self._of_grid = None if grid is None else _of_proj(grid)

    def undulation_m(self, latitude_deg: ArrayLike, longitude_deg: ArrayLike) -> Floats:
        """Height of sea level above the WGS-84 ellipsoid, metres, at places; (...)."""
        if self._stated_m is not None:
            return np.full(np.broadcast(latitude_deg, longitude_deg).shape, self._stated_m)
        if self._of_grid is None:
            return geoid_undulation_m(latitude_deg, longitude_deg)
        found_m = self._of_grid(latitude_deg, longitude_deg)
        # Beyond a grid that does not cover the Earth, the package's.
        return np.where(
            np.isfinite(found_m), found_m, geoid_undulation_m(latitude_deg, longitude_deg)
        )

    @property
    def level_m(self) -> float | None:
        """Height of sea level where that is the same everywhere; else None."""
        return self._stated_m


def _of_proj(grid: Path) -> Undulation:
    from plotfeed.feeds.console.extras import need_extra

    need_extra("pyproj", "telemetry.geoid_grid", "geoid")
    import pyproj

    pyproj.network.set_network_enabled(active=False)  # type: ignore[attr-defined]
    pipeline = (
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        f'+step +proj=vgridshift +grids="{grid.absolute()}" +multiplier=1 '
        "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    try:
        transformer = pyproj.Transformer.from_pipeline(pipeline)
    except pyproj.exceptions.ProjError:
        raise PlotfeedError(
            f"{grid}: telemetry.geoid_grid: expected a grid of geoid undulations that PROJ reads, "
            "GeoTIFF or GTX, with no comma in its path"
        ) from None

    def undulation_m(latitude_deg: ArrayLike, longitude_deg: ArrayLike) -> Floats:
        latitude, longitude = np.broadcast_arrays(latitude_deg, longitude_deg)
        found_m: Floats = transformer.transform(longitude, latitude, np.zeros(latitude.shape))[2]
        return np.asarray(found_m, np.float64)

    return undulation_m


ABOVE_SEA, ABOVE_ELLIPSOID = "height_msl_m", "height_m"
PLACE = ("latitude_deg", "longitude_deg")
# Of the fixed point for how high over the site's horizontal a sensor stands: 1 um at 1000 km.
STEPS = 3
LARGEST = 1e6  # Of the numbers that a place can have


def with_ellipsoidal_heights(tree: dict[str, Any]) -> dict[str, Any]:
    """A scene's tree in which places have `height_m`, and sensors all of `position_enu_m`.

    Sea level is where the scene states it, else by the package's geoid. What is no place is left
    for whoever checks the tables; raises `ValueError` for a height that is given twice.
    """
    telemetry = tree.get("telemetry")
    keys = telemetry if isinstance(telemetry, dict) else {}
    level = SeaLevel(*_numbers(keys.get("geoid_undulation_m")))

    def converted(part: Any, key: str) -> Any:
        if isinstance(part, list | tuple):
            return [converted(each, f"{key}[{n}]") for n, each in enumerate(part)]
        if not isinstance(part, dict):
            return part
        part = {name: converted(each, f"{key}.{name}".lstrip(".")) for name, each in part.items()}
        if ABOVE_SEA not in part:
            return part
        if ABOVE_ELLIPSOID in part:
            raise ValueError(f"{key}.{ABOVE_SEA}: either it or {ABOVE_ELLIPSOID}")
        if keys.get("geoid_grid") is not None:
            raise ValueError(
                f"{key}.{ABOVE_SEA}: counts from the package's geoid or telemetry."
                "geoid_undulation_m; beside geoid_grid, write heights above the ellipsoid"
            )
        if place := _numbers(part[ABOVE_SEA], *map(part.get, PLACE)):
            del part[ABOVE_SEA]
            part[ABOVE_ELLIPSOID] = place[0] + float(level.undulation_m(*place[1:]))
        return part

    tree = converted(tree, "")
    general = tree.get("scene")
    site = general.get("site") if isinstance(general, dict) else None
    if isinstance(site, dict) and (place := _numbers(*map(site.get, (*PLACE, ABOVE_ELLIPSOID)))):
        frame = LocalFrame(*place)
        tree["sensor"] = [
            _put(sensor, f"sensor[{n}]", frame, level) for n, sensor in enumerate(tree["sensor"])
        ]
    return tree


def _put(sensor: Any, key: str, site: LocalFrame, level: SeaLevel) -> Any:
    """A sensor whose height above the sea is the third of its `position_enu_m`."""
    above_sea_m = _numbers(sensor.get(ABOVE_SEA)) if isinstance(sensor, dict) else []
    if not above_sea_m:
        return sensor
    position = sensor.get("position_enu_m", [0.0, 0.0, 0.0])
    place_m = np.array(_numbers(*position) if isinstance(position, list) else [])
    if len(place_m) != 3:
        return sensor
    if place_m[2]:
        raise ValueError(f"{key}.{ABOVE_SEA}: gives the third of position_enu_m, which is 0 then")
    for _ in range(STEPS):
        latitude_deg, longitude_deg, height_m = (float(x) for x in site.to_geodetic(place_m))
        undulation_m = float(level.undulation_m(latitude_deg, longitude_deg))
        place_m[2] += above_sea_m[0] + undulation_m - height_m
    others = {name: value for name, value in sensor.items() if name != ABOVE_SEA}
    return others | {"position_enu_m": place_m.tolist()}


def _numbers(*values: Any) -> list[float]:
    """The values, if all are numbers that a place can have; else none."""
    kinds = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    return [float(v) for v in values] if kinds and all(abs(v) <= LARGEST for v in values) else []

"""What a scene takes for mean sea level, from which telemetry and some ASTERIX count heights."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.state import Floats
from plotfeed.proto.errors import PlotfeedError

Undulation = Callable[[ArrayLike, ArrayLike], Floats]
"""From latitudes and longitudes, degrees, to heights of sea level above the ellipsoid, metres."""


class SeaLevel:
    """Mean sea level: as high as is stated, or by a grid of PROJ's, or by the package's EGM96."""

    def __init__(self, stated_m: float | None = None, *, grid: Path | None = None) -> None:
        """Raises `PlotfeedError` if there is no such grid, or nothing to read it with."""
        self._stated_m = stated_m
        self._of_grid = None if grid is None else _of_proj(grid)

    @classmethod
    def of(cls, scene: Scene, *, stated_m: float | None = None) -> Self:
        """The sea level of a scene, unless another is stated; raises `PlotfeedError`."""
        keys = scene.telemetry
        if stated_m is not None or keys.geoid_grid is None:
            return cls(keys.geoid_undulation_m if stated_m is None else stated_m)
        return cls(grid=scene.file(keys.geoid_grid))

    def undulation_m(self, latitude_deg: ArrayLike, longitude_deg: ArrayLike) -> Floats:
        """Height of sea level above the WGS-84 ellipsoid, metres, at places; (...)."""
        if self._stated_m is not None:
            return np.full(np.broadcast(latitude_deg, longitude_deg).shape, self._stated_m)
        from plotfeed.models.geoid import geoid_undulation_m

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

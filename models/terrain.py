"""Ground and walls: heights of the Earth's surface from rasters, and footprints of buildings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.frames import geodetic_to_ecef
from plotfeed.models.numerics import as_floats
from plotfeed.models.state import Floats


@dataclass(frozen=True, eq=False, kw_only=True)
class ElevationTile:
    """A raster of heights, metres, rows southwards and columns eastwards, in degrees of WGS-84.

    The first sample is at `north_deg` and `west_deg`; `void` is the value of what is not known.
    """

    heights_m: NDArray[Any]
    north_deg: float
    west_deg: float
    row_step_deg: float
    column_step_deg: float
    void: float = np.nan

    def height_m(self, latitude_deg: Floats, longitude_deg: Floats) -> Floats:
        """Heights between the four samples about each place, bilinear; NaN outside or at a void."""
        rows, columns = self.heights_m.shape
        down = (self.north_deg - latitude_deg) / self.row_step_deg
        right = (longitude_deg - self.west_deg) / self.column_step_deg
        inside = (down >= 0) & (down <= rows - 1) & (right >= 0) & (right <= columns - 1)
        found_m = np.full(latitude_deg.shape, np.nan)
        down, right = down[inside], right[inside]
        row = np.minimum(down.astype(np.int64), max(rows - 2, 0))
        column = np.minimum(right.astype(np.int64), max(columns - 2, 0))
        found_m[inside] = self._between(row, column, down - row, right - column)
        return found_m

    def _between(
        self, row: NDArray[Any], column: NDArray[Any], down: Floats, right: Floats
    ) -> Floats:
        height_m = np.zeros(len(row))
        last_row, last_column = (n - 1 for n in self.heights_m.shape)
        for i, by_row in ((0, 1 - down), (1, down)):
            for j, by_column in ((0, 1 - right), (1, right)):
                at = np.minimum(row + i, last_row), np.minimum(column + j, last_column)
                corner = self.heights_m[at].astype(np.float64)
                corner[corner == self.void] = np.nan
                height_m += corner * by_row * by_column
        return height_m


@dataclass(frozen=True, eq=False)
class Ground:
    """Several rasters: where they overlap, the first one that knows.

    `undulation_m` is added, by latitudes and longitudes: what heights are counted from may be the
    sea.
    """

    tiles: Sequence[ElevationTile]
    undulation_m: Callable[[Floats, Floats], Floats] | None = None

    def height_m(self, latitude_deg: Floats, longitude_deg: Floats) -> Floats:
        """Heights at places, metres above the ellipsoid; NaN where none knows."""
        found_m = np.full(latitude_deg.shape, np.nan)
        for tile in self.tiles:
            open_ = np.isnan(found_m)
            if not open_.any():
                break
            found_m[open_] = tile.height_m(latitude_deg[open_], longitude_deg[open_])
        if self.undulation_m is not None:
            known = ~np.isnan(found_m)
            found_m[known] += self.undulation_m(latitude_deg[known], longitude_deg[known])
        return found_m


@dataclass(frozen=True, eq=False)
class Walls:
    """The upper edges of walls, ECEF, metres: from, and to; (n, 3) each."""

    from_ecef_m: Floats
    to_ecef_m: Floats

    @classmethod
    def of_rings(cls, rings: Sequence[Floats], tops_m: Sequence[float]) -> Walls:
        """Walls of footprints: rings of longitude and latitude, (k, 2), each up to a height.

        Rings may repeat their first corner at the end; heights are above the ellipsoid.
        """
        if not rings:
            return cls(np.zeros((0, 3)), np.zeros((0, 3)))
        lengths = [len(ring) for ring in rings]
        corners = np.concatenate(rings)
        heights_m = np.repeat(as_floats(tops_m), lengths)
        ecef_m = geodetic_to_ecef(corners[:, 1], corners[:, 0], heights_m)
        ends = np.cumsum(lengths)
        following = np.arange(len(corners)) + 1
        following[ends - 1] = ends - lengths
        return cls(ecef_m, ecef_m[following])

    def __len__(self) -> int:
        return len(self.from_ecef_m)

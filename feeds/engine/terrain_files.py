"""Files of the ground and of buildings that a scene names."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.telemetry.foreign_files import FILE_LIMITS, file_octets, read_apart
from plotfeed.models.effects.line_of_sight import ElevationTile, Ground, Walls
from plotfeed.models.state import Floats
from plotfeed.proto.errors import PlotfeedError

HGT_NAME = re.compile(r"([NS])(\d{2})([EW])(\d{3})", re.IGNORECASE)
HGT_VOID = -32768


def ground_of(scene: Scene) -> Ground | None:
    """The ground by a scene's rasters, above the ellipsoid; raises `PlotfeedError`."""
    keys = scene.terrain
    if keys is None or not keys.elevation:
        return None
    above_sea = keys.elevation_above == "sea-level"
    return Ground(
        [_tile(scene.file(name), name) for name in keys.elevation],
        scene.sea_level().undulation_m if above_sea else None,
    )


def _tile(path: Path, name: str) -> ElevationTile:
    try:
        if path.suffix.lower() == ".hgt":
            return _of_hgt(file_octets(path, "SRTM tile"), name)
        if path.suffix.lower() in {".tif", ".tiff"}:
            return _of_geotiff(path, name)
    except PlotfeedError as error:
        raise PlotfeedError(f"{path}: {error}") from None
    raise PlotfeedError(f"terrain.elevation: {name!r}: expected a name that ends in .hgt or .tif")


def _of_hgt(data: bytes, name: str) -> ElevationTile:
    """A tile of SRTM: a square degree of big-endian 16-bit metres, its corners included."""
    corner = HGT_NAME.search(Path(name).name)
    if corner is None:
        raise PlotfeedError(
            f"terrain.elevation: {name!r}: expected a name such as N40W004.hgt, the tile's corner"
        )
    samples = np.frombuffer(data[: len(data) // 2 * 2], ">i2")
    side = round(len(samples) ** 0.5)
    if side < 2 or side * side != len(samples):
        raise PlotfeedError(f"expected a square of 16-bit heights, not {len(samples)}")
    north, east = corner[1].upper() == "N", corner[3].upper() == "E"
    south_deg = float(corner[2]) * (1 if north else -1)
    return ElevationTile(
        heights_m=samples.reshape(side, side),
        north_deg=south_deg + 1,
        west_deg=float(corner[4]) * (1 if east else -1),
        row_step_deg=1 / (side - 1),
        column_step_deg=1 / (side - 1),
        void=HGT_VOID,
    )


def _of_geotiff(path: Path, name: str) -> ElevationTile:
    """The first band of a GeoTIFF, by latitude and longitude, whatever its projection."""
    need_extra("rasterio", f"terrain.elevation: {name!r}", "terrain", load=False)
    found = read_apart("GeoTIFF", path)
    column_step_deg, _, west_deg, _, row_step_deg, north_deg = found["place"]
    return ElevationTile(
        heights_m=found["heights_m"],
        north_deg=north_deg + row_step_deg / 2,
        west_deg=west_deg + column_step_deg / 2,
        row_step_deg=-row_step_deg,
        column_step_deg=column_step_deg,
    )


def walls_of(scene: Scene, ground: Ground | None) -> Walls | None:
    """The walls of a scene's buildings, on that ground; raises `PlotfeedError`."""
    keys = scene.terrain
    if keys is None or not keys.buildings:
        return None
    rings, heights_m = [], []
    for name in keys.buildings:
        for ring, height_m in _footprints(scene.file(name), name, keys.building_height):
            rings.append(ring)
            heights_m.append(height_m)
    bases_m = np.full(len(rings), np.nan)
    if ground is not None and rings:
        middle = np.array([ring.mean(axis=0) for ring in rings])
        bases_m = ground.height_m(middle[:, 1], middle[:, 0])
    bases_m = np.where(np.isnan(bases_m), scene.scene.site.height_m, bases_m)
    return Walls.of_rings(rings, (bases_m + heights_m).tolist())


def _footprints(path: Path, name: str, key: str) -> Iterator[tuple[Floats, float]]:
    """Rings of footprints and how high each stands."""
    try:
        tree = json.loads(file_octets(path, "GeoJSON"))
    except PlotfeedError as error:
        raise PlotfeedError(f"{path}: {error}") from None
    except (ValueError, RecursionError):
        raise PlotfeedError(f"{path}: not JSON") from None
    features = tree.get("features") if isinstance(tree, dict) else None
    if not isinstance(features, list):
        raise PlotfeedError(f"{path}: expected GeoJSON, an object with features")
    corners = 0
    for number, feature in enumerate(features):
        where = f"terrain.buildings: {name!r}: feature {number}"
        for ring in _rings(feature, where):
            corners += len(ring)
            if corners > FILE_LIMITS["GeoJSON"].count:
                most = FILE_LIMITS["GeoJSON"].count
                raise PlotfeedError(f"{path}: more than {most} corners, the most that are read")
            yield ring, _height(feature, key, where)


def _height(feature: Any, key: str, where: str) -> float:
    properties = feature.get("properties") or {}
    told = properties.get(key) if isinstance(properties, dict) else None
    try:
        height_m = float(str(told).removesuffix("m"))
    except ValueError:
        height_m = np.nan
    if not (isfinite(height_m) and -1000 <= height_m <= 10_000):
        raise PlotfeedError(f"{where}: expected its height in metres as {key!r}, not {told!r}")
    return height_m


def _rings(feature: Any, where: str) -> Sequence[Floats]:
    """The rings of a polygon or of several; of what has no area, none."""
    geometry = feature.get("geometry") if isinstance(feature, dict) else None
    geometry = geometry if isinstance(geometry, dict) else {}
    kind = geometry.get("type")
    if kind not in ("Polygon", "MultiPolygon"):
        return []
    told = geometry.get("coordinates")
    try:
        polygons: list[Any] = [told] if kind == "Polygon" else list(told or ())
        rings = [np.array([c[:2] for c in ring], np.float64) for p in polygons for ring in p]
    except (TypeError, ValueError, IndexError):
        rings = [np.full((1, 1), np.nan)]
    for ring in rings:
        placed = ring.ndim == 2 and ring.shape[1:] == (2,) and len(ring) >= 3
        if not (placed and (np.abs(ring) <= (180, 90)).all()):
            raise PlotfeedError(f"{where}: expected rings of longitude and latitude in degrees")
    return rings

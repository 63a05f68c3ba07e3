"""Files of the ground and of buildings that a scene names, and the horizons that these make.

Horizons are those of sensors and of their transmitters, from the files or from a recording.
"""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Iterator, Sequence
from functools import cached_property
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.world_keys import HORIZONS, TerrainKeys
from plotfeed.feeds.telemetry.foreign_files import FILE_LIMITS, file_octets, read_apart
from plotfeed.models.effects.line_of_sight import (
    ElevationTile,
    Ground,
    Horizon,
    HorizonSettings,
    Obstruction,
    Walls,
    horizon_of,
)
from plotfeed.models.frames import LocalFrame, distance_m
from plotfeed.models.sensors.sensor_model import SensorModel
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


AZIMUTHS = 1440
# Parts of the circle: 0.25 degrees are 44 m at 10 km, 0.1 degrees 1.7 m at 1 km.
AZIMUTHS_AMONG_BUILDINGS = MAX_AZIMUTHS = 3600
MAX_STEPS = 4000
# Of a staircase in a recording, after the number of places and these: latitude, longitude, height
# and parts of the circle.
STEP = np.dtype([("place", "<u4"), ("azimuth", "<u4"), ("distance_m", "<f4"), ("slope", "<f4")])
PLACE = np.dtype("<f8")
COUNT = np.dtype("<u4")
MAX_OCTETS = 1 << 30


class Horizons:
    """Horizons of places, each made when it is first asked for."""

    def __init__(self, scene: Scene, keys: TerrainKeys) -> None:
        """Raises `PlotfeedError` for a file without use."""
        self._scene, self._keys = scene, keys
        self._known: dict[tuple[float, ...], Horizon] = {}
        if scene.is_enclosed:
            self._known = _unpacked(scene.file(HORIZONS).read_bytes())
        else:
            _ = self._surface

    def around(self, sensor: Sensor, model: SensorModel) -> Obstruction:
        """What stands about a sensor, its stations and transmitters; raises `PlotfeedError`."""
        frames = self._ends(sensor, model)
        return Obstruction(
            frames=tuple(frames),
            horizons=tuple(self._horizon(sensor, each) for each in frames),
            diffracts=self._keys.diffraction,
            k=self._keys.earth_radius_factor,
        )

    def ground_m(self, latitude_deg: Floats, longitude_deg: Floats) -> Floats:
        """Height of the ground above the ellipsoid at places; NaN where no raster knows it."""
        ground = None if self._scene.is_enclosed else self._surface[0]
        if ground is None:
            return np.full(latitude_deg.shape, np.nan)
        return ground.height_m(latitude_deg, longitude_deg)

    def octets(self) -> bytes:
        """All of the scene's, for a recording."""
        for sensor in self._scene.sensor:
            self.around(sensor, sensor.model(self._scene.scene.site))
        places = [[*place, horizon.azimuths] for place, horizon in self._known.items()]
        steps = []
        for number, horizon in enumerate(self._known.values()):
            of_place = np.zeros(len(horizon.azimuth), STEP)
            of_place["place"] = number
            for name in ("azimuth", "distance_m", "slope"):
                of_place[name] = getattr(horizon, name)
            steps.append(of_place)
        parts = np.array(len(places), COUNT), np.array(places, PLACE), np.concatenate(steps)
        return zlib.compress(b"".join(part.tobytes() for part in parts), level=1)

    def _ends(self, sensor: Sensor, model: SensorModel) -> list[LocalFrame]:
        """Where signals begin or end: at the sensor, its other stations and its transmitters."""
        frame = frame_at(self._scene.scene.site, sensor.position_enu_m)
        places = [frame.to_geodetic(other) for other in model.other_ends_enu_m]
        return [frame, *(LocalFrame(*(float(x) for x in place)) for place in places)]

    def _horizon(self, sensor: Sensor, frame: LocalFrame) -> Horizon:
        place = (frame.latitude_deg, frame.longitude_deg, frame.height_m)
        if place not in self._known:
            if self._scene.is_enclosed:
                raise PlotfeedError(f"the recording holds no horizon for sensor {sensor.id!r}")
            ground, walls = self._surface
            settings = HorizonSettings(
                azimuths=AZIMUTHS if walls is None else AZIMUTHS_AMONG_BUILDINGS,
                step_m=max(self._keys.step_m, self._reach_m / MAX_STEPS),
                reach_m=self._reach_m,
                k=self._keys.earth_radius_factor,
            )
            try:
                self._known[place] = horizon_of(frame, ground, walls, settings)
            except ValueError as error:
                what = f"terrain.buildings: about sensor {sensor.id!r} {error}"
                raise PlotfeedError(what) from None
        return self._known[place]

    @cached_property
    def _surface(self) -> tuple[Ground | None, Walls | None]:
        ground = ground_of(self._scene)
        return ground, walls_of(self._scene, ground)

    @cached_property
    def _reach_m(self) -> float:
        """The furthest that anything of a drone comes from."""
        reaches_m = []
        for sensor in self._scene.sensor:
            model = sensor.model(self._scene.scene.site)
            baselines_m = distance_m(model.other_ends_enu_m)
            reaches_m.append(model.range_max_m + float(baselines_m.max(initial=0.0)))
        return max(reaches_m)


def _unpacked(octets: bytes) -> dict[tuple[float, ...], Horizon]:
    """Horizons as a recording has them; raises `PlotfeedError`."""
    packed = zlib.decompressobj()
    try:
        told = packed.decompress(octets, MAX_OCTETS)
        count = int(np.frombuffer(told, COUNT, 1)[0])
        places = np.frombuffer(told, PLACE, 4 * count, COUNT.itemsize).reshape(count, 4)
        steps = np.frombuffer(told, STEP, offset=COUNT.itemsize + places.nbytes)
    except (ValueError, zlib.error):
        raise PlotfeedError(f"the recording's {HORIZONS} are damaged") from None
    is_sound = packed.eof and np.isfinite(places).all() and (steps["place"] < count).all()
    is_sound = is_sound and (places[:, 3] >= 1).all() and (places[:, 3] <= MAX_AZIMUTHS).all()
    is_sound = is_sound and np.isfinite(steps["distance_m"] + steps["slope"]).all()
    if not is_sound or (steps["azimuth"] >= places[steps["place"], 3]).any():
        raise PlotfeedError(f"the recording's {HORIZONS} are damaged")
    found = {}
    for number, (*place, azimuths) in enumerate(places.tolist()):
        of_place = steps[steps["place"] == number]
        found[tuple(place)] = Horizon(
            int(azimuths),
            of_place["azimuth"].astype(np.int64),
            of_place["distance_m"].astype(np.float64),
            of_place["slope"].astype(np.float64),
        )
    return found


def horizons_of(scene: Scene) -> bytes:
    """The horizons of a scene that names some, for its recording; raises `PlotfeedError`."""
    return Horizons(scene, scene.terrain).octets() if scene.terrain is not None else b""

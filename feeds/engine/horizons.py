"""The horizons of a scene's sensors and of their transmitters, from its files or its recording."""

from __future__ import annotations

import zlib
from functools import cached_property

import numpy as np

from plotfeed.feeds.engine.terrain_files import ground_of, walls_of
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.world_keys import HORIZONS, TerrainKeys
from plotfeed.models.effects.line_of_sight import (
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

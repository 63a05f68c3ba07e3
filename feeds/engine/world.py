"""What of the world a scene names, about each of its sensors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from plotfeed.feeds.scene.fields import enu_from, frame_at, geodetic, site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.world_keys import ClutterKeys
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.effects.surroundings import OnTheWay, Surroundings
from plotfeed.models.frames import Axes, LocalFrame, geodetic_to_ecef
from plotfeed.models.sensors.polar_radar import PolarRadar
from plotfeed.models.sensors.sensor_model import SensorModel
from plotfeed.models.state import Floats
from plotfeed.models.truth import Trajectories
from plotfeed.proto.errors import PlotfeedError

if TYPE_CHECKING:
    from plotfeed.models.clutter import ClutterMap, Spikes
    from plotfeed.models.effects.surroundings import Pillar


def _rates_of(
    keys: ClutterKeys, model: PolarRadar, place_m: Floats, texture: Floats
) -> tuple[Floats, Spikes | None]:
    """Mean plots of squares in a scan, and how spikes make them, if these do."""
    area_m2 = keys.cell_m**2
    if keys.threshold_db is None:
        return (keys.plots_per_km2 or 0.0) * area_m2 / 1e6 * texture, None
    stays = texture if keys.texture_stays else None
    from plotfeed.models.clutter import Spikes

    spikes = Spikes(threshold=10 ** (keys.threshold_db / 10), order=keys.shape, texture=stays)
    ground_m = np.maximum(np.hypot(place_m[:, 0], place_m[:, 1]), keys.cell_m)
    of_beam_m2 = ground_m * np.radians(model.azimuth_beamwidth_deg) * model.range_resolution_m
    return area_m2 / of_beam_m2 * spikes.chance(len(place_m)), spikes


MAX_CELLS = 1_000_000
SUNK_M = 1.0  # By which rasters and masts may disagree about the ground
IT = "it"  # A sensor, in its own warnings; it may be aloft
FITS_M = 3.0  # Within which a site is on the ground, if its height counts from the sea
HIGHEST_SITE_M = 500.0  # Over the ground: no tower is higher by much
# Below and above the sea: where the ground is not known, what is beyond is asked about.
LOWEST_LAND_M, HIGHEST_LAND_M = 10.0, 9000.0


class World:
    """The surroundings of sensors; of a scene that names none, nothing."""

    def __init__(self, scene: Scene) -> None:
        """Raises `PlotfeedError` for a file without use."""
        self._scene, self._site = scene, scene.scene.site
        self._horizons = None
        if scene.terrain is not None:
            from plotfeed.feeds.engine.terrain_files import Horizons

            self._horizons = Horizons(scene, scene.terrain)

    def model_of(self, sensor: Sensor) -> SensorModel:
        """The model of a sensor where it stands; raises `PlotfeedError`."""
        model = sensor.model(self._site)
        met: list[OnTheWay] = list(self._towers(sensor, model))
        obstruction = None
        if self._horizons is not None:
            obstruction = self._horizons.around(sensor, model)
            met.append(obstruction)
        if met:
            model = replace(model, surroundings=Surroundings(tuple(met)))
        return model if obstruction is None else model.with_jammers_behind(obstruction)

    def clutter_of(
        self, model: SensorModel, axes: Axes, trajectories: Trajectories
    ) -> list[ClutterMap]:
        """Clutter that a sensor with those axes sees; the regions get names among the drones."""
        if not self._scene.clutter or not isinstance(model, PolarRadar):
            return []
        return [self._clutter_map(keys, model, axes, trajectories) for keys in self._scene.clutter]

    def _clutter_map(
        self, keys: ClutterKeys, model: PolarRadar, axes: Axes, trajectories: Trajectories
    ) -> ClutterMap:
        """The map of a region, which is that of the seed, as far as nothing hides it."""
        site = site_frame(self._site)
        corners = [geodetic(self._site, place) for place in keys.area]
        corners_m = site.from_ecef(geodetic_to_ecef(*np.array(corners).T))
        low, high = corners_m.min(axis=0), corners_m.max(axis=0)
        east, north = (np.arange(a, b, keys.cell_m) for a, b in zip(low[:2], high[:2], strict=True))
        if len(east) * len(north) > MAX_CELLS:
            raise PlotfeedError(
                f"clutter {keys.id!r}: cell_m: {len(east) * len(north)} cells, of which at most "
                f"{MAX_CELLS} are taken"
            )
        east_m, north_m = (column.ravel() for column in np.meshgrid(east, north))
        half_m = keys.cell_m / 2
        from plotfeed.models.clutter import CLUTTER, ClutterMap, inside

        within = inside(east_m + half_m, north_m + half_m, corners_m[:, :2])
        east_m, north_m = east_m[within], north_m[within]
        from plotfeed.models.movers import other_name

        name = other_name(CLUTTER, keys.id)
        rng = Chance(self._scene.scene.seed, name).rng(Purpose.CLUTTER, 0)
        texture = rng.standard_gamma(keys.shape, len(east_m)) / keys.shape
        latitude_deg, longitude_deg, _ = site.to_geodetic(
            np.stack([east_m, north_m, np.zeros(len(east_m))], axis=-1)
        )
        height_m = np.mean([corner[2] for corner in corners])
        place_m = axes.from_ecef(geodetic_to_ecef(latitude_deg, longitude_deg, height_m))
        seen = model.has_sight_of(place_m)
        place_m, texture = place_m[seen], texture[seen]
        rates, spikes = _rates_of(keys, model, place_m, texture)
        return ClutterMap(
            east_m=place_m[:, 0],
            north_m=place_m[:, 1],
            up_m=place_m[:, 2],
            side_m=keys.cell_m,
            rates=rates,
            spikes=spikes,
            rate_m_s=keys.rate_m_s,
            whose=trajectories.add_other(name),
        )

    def _towers(self, sensor: Sensor, model: SensorModel) -> Iterator[Pillar]:
        """Towers that stand in the way of radio waves."""
        if not model.is_radio:
            return
        for turbine in self._scene.turbine:
            if turbine.tower_width_m:
                frame = frame_at(self._site, sensor.position_enu_m)
                east_m, north_m, up_m = enu_from(frame, self._site, turbine).tolist()
                from plotfeed.models.effects.surroundings import Pillar

                yield Pillar((east_m, north_m, up_m), turbine.tower_width_m)

    def ground_m(self, latitude_deg: Floats, longitude_deg: Floats) -> Floats:
        """Height of the ground above the ellipsoid at places, (n,); NaN where it is not known."""
        if self._horizons is None:
            return np.full(latitude_deg.shape, np.nan)
        return self._horizons.ground_m(latitude_deg, longitude_deg)

    def warnings(self, sensor: Sensor) -> list[str]:
        """What is legal and still looks wrong about where a sensor stands, for `check`."""
        return self._doubts(IT, frame_at(self._site, sensor.position_enu_m), np.inf)

    @property
    def doubts(self) -> list[str]:
        """What is legal and still looks wrong about where the site is."""
        return self._doubts("the site", site_frame(self._site), HIGHEST_SITE_M)

    def _doubts(self, what: str, here: LocalFrame, highest_m: float) -> list[str]:
        """What a height is, read as it is and as one above the sea; nothing of a likely one."""
        place = np.array([here.latitude_deg]), np.array([here.longitude_deg])
        undulation_m = float(self._scene.sea_level().undulation_m(*place)[0])
        ground_m = float(self.ground_m(*place)[0])
        if not np.isnan(ground_m):
            above_m, instead_m = here.height_m - ground_m, here.height_m + undulation_m - ground_m
            lowest_m = -SUNK_M if what == IT else -FITS_M
            fits = abs(instead_m) <= FITS_M and above_m > 3 * FITS_M and what != IT
            if lowest_m <= above_m <= highest_m and not fits:
                return []
            told = f"{what} stands {_beside(above_m)} the ground of terrain.elevation"
        else:
            above_m, instead_m = here.height_m - undulation_m, here.height_m
            if -LOWEST_LAND_M <= above_m <= max(highest_m, HIGHEST_LAND_M):
                return []
            told = f"{what} stands {_beside(above_m)} mean sea level"
        if -SUNK_M <= instead_m <= HIGHEST_LAND_M and abs(instead_m) < abs(above_m):
            return [
                f"{told}, and {_beside(instead_m)} it if its height counts from mean sea level: is "
                f"height_msl_m meant?"
            ]
        return [f"{told}, read from the ellipsoid or from the sea: is it in metres?"]


def _beside(above_m: float) -> str:
    return f"{abs(above_m):.0f} m {'below' if above_m < 0 else 'above'}"

"""The keys of what turns a sensor: pan, tilt and zoom, and by what it is cued."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Sequence
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field, ValidationError

from plotfeed.feeds.scene.fields import (
    Azimuth,
    Elevation,
    Enu,
    Height,
    Latitude,
    Longitude,
    Name,
    SceneTable,
    Site,
    frame_at,
)
from plotfeed.feeds.scene.problems import in_a_line, problems_of
from plotfeed.models.frames import enu_to_aer, geodetic_to_ecef
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from plotfeed.feeds.scene.sensors.sensor_keys import SensorKeys
    from plotfeed.models.cueing import Aim, CueRule

Rate = Annotated[float, Field(gt=0, le=3600)]
Seconds = Annotated[float, Field(ge=0, le=3600)]
WIDEST_DEG = 120.0  # Field of view of a sensor that is no camera; nothing is made of it


class LookAt(SceneTable):
    """Where a sensor is to look: a direction, or a place on the Earth."""

    azimuth_deg: Azimuth | None = None
    """From true north, of the sensor."""
    elevation_deg: Elevation = 0.0
    """Above the sensor's horizon, with azimuth_deg."""
    latitude_deg: Latitude | None = None
    """WGS-84, north, of the place."""
    longitude_deg: Longitude | None = None
    """WGS-84, east, of the place."""
    height_m: Height | None = None
    """Above the WGS-84 ellipsoid, of the place."""
    height_msl_m: Height | None = None
    """Above mean sea level, in place of height_m, in a scene's file."""
    horizontal_fov_deg: Annotated[float, Field(ge=0.01, le=360)] | None = None
    """Of a camera; without it, that of its keys."""

    def _refusals(self) -> Iterator[str]:
        place = (self.latitude_deg, self.longitude_deg, self.height_m)
        if (self.azimuth_deg is None) == (place == (None, None, None)):
            yield "expected azimuth_deg, or latitude_deg, longitude_deg and height_m"
        if (self.azimuth_deg is None and None in place) or self.height_msl_m is not None:
            yield (
                "a place has latitude_deg, longitude_deg and height_m or, in a scene's file, "
                "height_msl_m"
            )

    def aim(self, site: Site, position_enu_m: Enu, field_deg: float) -> Aim:
        """The aim of a sensor that stands there, with that field of view if none is asked for."""
        azimuth_deg, elevation_deg = self.azimuth_deg, self.elevation_deg
        if azimuth_deg is None:
            place = np.array([self.latitude_deg, self.longitude_deg, self.height_m], np.float64)
            seen = enu_to_aer(frame_at(site, position_enu_m).from_ecef(geodetic_to_ecef(*place)))
            azimuth_deg, elevation_deg = float(np.nan_to_num(seen[0])), float(seen[1])
        from plotfeed.models.cueing import Aim

        return Aim(
            pan_deg=azimuth_deg,
            tilt_deg=elevation_deg,
            field_deg=self.horizontal_fov_deg or field_deg,
        )


class MountKeys(SceneTable):
    """Motors that turn a sensor to cues: plots, messages on its topic, tasks."""

    pan_rate_deg_s: Rate = 60.0
    """The fastest; a turn is the shorter way round."""
    tilt_rate_deg_s: Rate = 30.0
    """The fastest."""
    pan_acceleration_deg_s2: Annotated[float, Field(gt=0, le=1e5)] = 120.0
    """With which it gains and loses speed."""
    tilt_acceleration_deg_s2: Annotated[float, Field(gt=0, le=1e5)] = 60.0
    """With which it gains and loses speed."""
    tilt_min_deg: Elevation = -30.0
    """Lowest."""
    tilt_max_deg: Elevation = 90.0
    """Highest."""
    settle_s: Seconds = 0.3
    """From the end of a turn until the sensor sees; before, it reports nothing."""
    dwell_s: Annotated[float, Field(ge=0.1, le=3600)] = 2.0
    """How long it looks at a cue, following newer plots of it."""
    fov_min_deg: Annotated[float, Field(ge=0.01, le=120)] | None = None
    """Narrowest field of view of a camera's zoom; without it, that of its keys."""
    fov_max_deg: Annotated[float, Field(ge=0.01, le=120)] | None = None
    """Widest field of view of a camera's zoom; without it, that of its keys."""
    zoom_s: Seconds = 3.0
    """From the widest field of view to the narrowest."""
    fov_sigmas: Annotated[float, Field(ge=1, le=100)] = 4.0
    """A camera opens its field of view to so many standard deviations of a cue: 4 holds its target
    with 0.91."""
    cued_by: Name | Annotated[tuple[Name, ...], Field(strict=False)] = ()
    """Ids of the sensors whose plots it is cued by, one or several."""
    latency_ms: Annotated[float, Field(ge=20, le=60_000)] = 100.0
    """From the end of a sector, or a message, until the mount knows of it."""
    max_age_s: Annotated[float, Field(ge=0.1, le=3600)] = 2.0
    """Plots older than this are no cues any more."""
    look_at: LookAt | None = None
    """Where it looks whatever cues there are; a SAPIENT task sets it."""

    def _refusals(self) -> Iterator[str]:
        if self.tilt_min_deg > self.tilt_max_deg:
            yield "tilt_min_deg: must not exceed tilt_max_deg"
        low, high = self.fov_min_deg, self.fov_max_deg
        if low is not None and high is not None and low > high:
            yield "fov_min_deg: must not exceed fov_max_deg"

    @property
    def cuers(self) -> tuple[str, ...]:
        """The ids of the sensors that cue it."""
        return (self.cued_by,) if isinstance(self.cued_by, str) else self.cued_by

    def rule(self, home: Aim) -> CueRule:
        """The mount for a model of a sensor that looks there without cues."""
        narrow_deg = home.field_deg if self.fov_min_deg is None else self.fov_min_deg
        wide_deg = home.field_deg if self.fov_max_deg is None else self.fov_max_deg
        from plotfeed.models.cueing import CueRule, Motor, Mount

        mount = self.made(
            Mount,
            pan=Motor(
                rate_deg_s=self.pan_rate_deg_s, acceleration_deg_s2=self.pan_acceleration_deg_s2
            ),
            tilt=Motor(
                rate_deg_s=self.tilt_rate_deg_s, acceleration_deg_s2=self.tilt_acceleration_deg_s2
            ),
            field_min_deg=min(narrow_deg, home.field_deg),
            field_max_deg=max(wide_deg, home.field_deg),
        )
        return CueRule(
            mount=mount,
            home=mount.reachable(home),
            dwell_ns=round(self.dwell_s * NS),
            max_age_ns=round(self.max_age_s * NS),
        )


class Cue(LookAt):
    """A message on `{prefix}/{sensor}/cue`: where to look, for how long."""

    dwell_s: Annotated[float, Field(ge=0.1, le=3600)] | None = None
    """Once the sensor sees it; without it, that of its mount."""


class CueError(PlotfeedError):
    """A cue that cannot be followed, in a line."""


EXAMPLE = '{"azimuth_deg": 45.0, "elevation_deg": 5.0}'


def cue_of(payload: bytes) -> Cue:
    """A cue from the wire; raises `CueError`."""
    tree: Any = None
    with contextlib.suppress(ValueError, RecursionError):
        tree = json.loads(payload)
    if not isinstance(tree, dict):
        raise CueError(f"expected an object of JSON such as {EXAMPLE}")
    try:
        return Cue.model_validate(tree)
    except ValidationError as error:
        raise CueError(in_a_line(problems_of(error, tree))) from None


def mount_of(sensor: SensorKeys) -> MountKeys | None:
    """The mount of a sensor that has one."""
    found: MountKeys | None = getattr(sensor, "mount", None)
    return found


def home_of(sensor: SensorKeys) -> Aim:
    """Where a sensor with a mount looks without cues."""
    from plotfeed.models.cueing import Aim

    return Aim(
        pan_deg=getattr(sensor, "pan_deg", 0.0),
        tilt_deg=getattr(sensor, "tilt_deg", 0.0),
        field_deg=getattr(sensor, "horizontal_fov_deg", WIDEST_DEG),
    )


def cue_order(sensors: Sequence[SensorKeys]) -> list[int]:
    """How many cues stand behind each sensor; raises `ValueError` where they go round.

    Sensors that are not there cue nobody.
    """
    index = {sensor.id: i for i, sensor in enumerate(sensors)}
    mounts = [mount_of(sensor) for sensor in sensors]
    cuers = {
        i: [index[name] for name in (mount.cuers if mount else ()) if name in index]
        for i, mount in enumerate(mounts)
    }
    behind = [0] * len(sensors)
    try:
        for i in TopologicalSorter(cuers).static_order():
            behind[i] = max((behind[each] + 1 for each in cuers[i]), default=0)
    except CycleError as error:
        first = min(error.args[1])
        text = f"sensor[{first}].mount.cued_by: sensors would cue each other"
        raise ValueError(text) from None
    return behind


def refused_cues(sensors: Sequence[SensorKeys]) -> Iterator[str]:
    """Cues by sensors that are not there; raises `ValueError` where sensors cue each other."""
    known = {sensor.id for sensor in sensors}
    for n, sensor in enumerate(sensors):
        mount = mount_of(sensor)
        if mount is not None and sensor.scan.kind != "staring":
            yield f"sensor[{n}].mount: only of a sensor that stares"
        for name in mount.cuers if mount else ():
            if name not in known:
                yield f"sensor[{n}].mount.cued_by: no sensor has the id {name!r}"
    cue_order(sensors)

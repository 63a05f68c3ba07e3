"""Plots as SAPIENT DetectionReports, placed on the Earth, those of some sectors together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plotfeed.feeds.formats import SectorFormat
from plotfeed.feeds.formats.sapient.sapient_node import (
    CONTENT_TYPE,
    detection_confidence_of,
    groups_of,
    manner_of,
    measures_of,
    node_of,
    tells_location,
)
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message, SectorMessage
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.models.frames import WGS84_A_M, LocalFrame, aer_to_enu
from plotfeed.models.state import Floats, Plots
from plotfeed.proto.sapient.encode_sapient import (
    MAX_ERROR_DEG,
    MAX_RANGE_M,
    DetectionEncoder,
    Positions,
)

MAX_SIGMA_DEG = 180.0


def positions_of(plots: Plots, frame: LocalFrame) -> Positions:
    """NaN for plots without azimuth, elevation or range."""
    enu_m = aer_to_enu(plots.azimuth_deg, plots.elevation_deg, plots.range_m)
    latitude_deg, longitude_deg, height_m = frame.to_geodetic(enu_m)
    east_m, north_m, up_m = _sigmas_enu_m(plots)
    return Positions(
        longitude_deg=longitude_deg,
        latitude_deg=latitude_deg,
        height_m=height_m,
        sigma_longitude_deg=_degrees(east_m, latitude_deg),
        sigma_latitude_deg=_degrees(north_m),
        sigma_height_m=up_m,
    )


def somewhere_near(plots: Plots, frame: LocalFrame, range_max_m: float) -> Positions:
    """Positions of plots that say neither where nor how far: the sensor, give or take its range.

    A disc of even probability has a standard deviation of half its radius along each axis.
    """
    n = len(plots)
    sigma_m = np.full(n, range_max_m / 2)
    latitude_deg = np.full(n, frame.latitude_deg)
    return Positions(
        longitude_deg=np.full(n, frame.longitude_deg),
        latitude_deg=latitude_deg,
        height_m=np.full(n, np.nan),
        sigma_longitude_deg=_degrees(sigma_m, latitude_deg),
        sigma_latitude_deg=_degrees(sigma_m),
        sigma_height_m=np.full(n, np.nan),
    )


def _sigmas_enu_m(plots: Plots) -> tuple[Floats, Floats, Floats]:
    """Errors along east, north and up, to first order in those of range and angles.

    Up is the sensor's: at 20 km the target's own is 0.2 degrees away.
    """
    azimuth, elevation = np.radians(plots.azimuth_deg), np.radians(plots.elevation_deg)
    along_m = plots.sigma_range_m
    across_m = plots.range_m * np.cos(elevation) * np.radians(plots.sigma_azimuth_deg)
    upwards_m = plots.range_m * np.radians(plots.sigma_elevation_deg)
    level_m = np.hypot(along_m * np.cos(elevation), upwards_m * np.sin(elevation))
    return (
        np.hypot(level_m * np.sin(azimuth), across_m * np.cos(azimuth)),
        np.hypot(level_m * np.cos(azimuth), across_m * np.sin(azimuth)),
        np.hypot(along_m * np.sin(elevation), upwards_m * np.cos(elevation)),
    )


def _degrees(metres: Floats, latitude_deg: Floats | None = None) -> Floats:
    """Metres along a meridian, or along a parallel, as degrees; an error needs no ellipsoid."""
    share = 1.0 if latitude_deg is None else np.cos(np.radians(latitude_deg))
    with np.errstate(divide="ignore"):
        degrees = np.degrees(metres / (WGS84_A_M * share))
    return np.minimum(degrees, MAX_SIGMA_DEG)


class SapientReports(SectorFormat):
    """One message a plot, all of a group of sectors stamped with the end of the last.

    The standard has no time of measurement, and a middleware may refuse detections whose stamps are
    less than 80 ms apart: where sectors are shorter, plots wait for the end of their group.
    """

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        super().__init__(scene, sensor)
        self._address = self.topics.address("sapient", CONTENT_TYPE)
        self._groups = groups_of(sensor)
        self._encoder = DetectionEncoder(node_of(scene, sensor), manner_of(scene, sensor))
        self._confidence = detection_confidence_of(scene, sensor)
        self._frame = frame_at(scene.scene.site, sensor.position_enu_m)
        self._range_max_m = sensor.range_max_m
        measures = measures_of(scene, sensor)
        self._on_earth = tells_location(scene, measures)
        self._has_direction = measures.azimuth
        self._group = -1
        self._waiting: list[Plots] = []

    def messages_of(self, batch: Batch) -> list[Message]:
        """The messages of a group of sectors, if this one ends it."""
        sector = batch.sector
        group = self._groups.number(sector)
        if group != self._group:  # of one that was not finished, the time is past
            self._group, self._waiting = group, []
        self._waiting.append(batch.plots)
        if not self._groups.ends_with(sector):
            return []
        together, self._waiting = Plots.joined(self._waiting), []
        together = replace(  # an error without bound, as of azimuth straight above, is left unsaid
            together,
            sigma_range_m=_bounded(together.sigma_range_m, MAX_RANGE_M),
            sigma_azimuth_deg=_bounded(together.sigma_azimuth_deg, MAX_ERROR_DEG),
            sigma_elevation_deg=_bounded(together.sigma_elevation_deg, MAX_ERROR_DEG),
        )
        payloads = self._encoder.messages(
            sector.end_ns,
            together,
            self._positions(together),
            None if self._confidence is None else self._confidence.of(together.snr),
        )
        return [
            SectorMessage(self._address, payload, batch.stamp, n)
            for n, payload in enumerate(payloads)
        ]

    def _positions(self, plots: Plots) -> Positions | None:
        if not self._on_earth:
            return None
        if self._has_direction:
            return positions_of(plots, self._frame)
        return somewhere_near(plots, self._frame, self._range_max_m)


def _bounded(sigma: Floats, most: float) -> Floats:
    return np.where(sigma <= most, sigma, np.nan)

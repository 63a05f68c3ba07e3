"""Plots as SAPIENT DetectionReports, those of some sectors together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plotfeed.feeds.formats.base import Topics
from plotfeed.feeds.message import Message
from plotfeed.feeds.places import frame_at
from plotfeed.feeds.sapient.herald import CONTENT_TYPE
from plotfeed.feeds.sapient.node import groups_of, manner_of, measures_of, node_of, tells_location
from plotfeed.feeds.sapient.places import positions_of, somewhere_near
from plotfeed.feeds.scene import Scene
from plotfeed.feeds.sensors import Sensor
from plotfeed.models.scan import Sector
from plotfeed.models.state import Floats, Plots
from plotfeed.proto.sapient.detections import DetectionEncoder
from plotfeed.proto.sapient.locations import MAX_ERROR_DEG, MAX_RANGE_M, Positions


class SapientReports:
    """One message a plot, all of a group of sectors stamped with the end of the last.

    The standard has no time of measurement, and a middleware may refuse detections whose stamps are
    less than 80 ms apart: where sectors are shorter, plots wait for the end of their group.
    """

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        self._topics = Topics(scene, sensor)
        self._groups = groups_of(sensor)
        self._encoder = DetectionEncoder(node_of(scene, sensor), manner_of(scene, sensor))
        self._frame = frame_at(scene.scene.site, sensor.position_enu_m)
        self._range_max_m = sensor.range_max_m
        measures = measures_of(scene, sensor)
        self._on_earth = tells_location(scene, measures)
        self._has_direction = measures.azimuth
        self._group = -1
        self._waiting: list[Plots] = []

    def messages(self, sector: Sector, plots: Plots) -> list[Message]:
        """Those of the group, if the sector ends it."""
        group = self._groups.number(sector)
        if group != self._group:  # of one that was not finished, the time is past
            self._group, self._waiting = group, []
        self._waiting.append(plots)
        if not self._groups.ends_with(sector):
            return []
        together, self._waiting = Plots.joined(self._waiting), []
        together = _with_finite_errors(together)
        payloads = self._encoder.messages(sector.end_ns, together, self._positions(together))
        return self._addressed(sector, payloads)

    def _positions(self, plots: Plots) -> Positions | None:
        if not self._on_earth:
            return None
        if self._has_direction:
            return positions_of(plots, self._frame)
        return somewhere_near(plots, self._frame, self._range_max_m)

    def _addressed(self, sector: Sector, payloads: list[bytes]) -> list[Message]:
        if not payloads:
            return []
        model = self._topics.message("sapient", CONTENT_TYPE, payloads[0], sector)
        alike = tuple(pair for pair in model.properties if pair[0] != "id")
        place = f"sapient-{sector.scan}-{sector.index}"
        return [
            Message(
                topic=model.topic,
                payload=payload,
                content_type=CONTENT_TYPE,
                due_utc_ns=model.due_utc_ns,
                qos=model.qos,
                properties=(("id", f"{place}-{n}"), *alike),
            )
            for n, payload in enumerate(payloads)
        ]


def _with_finite_errors(plots: Plots) -> Plots:
    """An error without bound, such as of azimuth straight above, is left unsaid."""
    return replace(
        plots,
        sigma_range_m=_bounded(plots.sigma_range_m, MAX_RANGE_M),
        sigma_azimuth_deg=_bounded(plots.sigma_azimuth_deg, MAX_ERROR_DEG),
        sigma_elevation_deg=_bounded(plots.sigma_elevation_deg, MAX_ERROR_DEG),
    )


def _bounded(sigma: Floats, most: float) -> Floats:
    return np.where(sigma <= most, sigma, np.nan)

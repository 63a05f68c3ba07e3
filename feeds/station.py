"""One sensor of a scene at its place: a sector of time in, its looks, plots and messages out.

Nothing here waits or sends. A station can be asked for any sector, in any order, unless it tracks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from plotfeed.feeds.formats import reporters_of
from plotfeed.feeds.formats.base import Seen
from plotfeed.feeds.message import Message
from plotfeed.feeds.places import frame_at
from plotfeed.feeds.scene import Scene
from plotfeed.feeds.sensors import Sensor
from plotfeed.feeds.sensors.base import RotatingScan
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.frames import aer_to_enu, enu_to_aer
from plotfeed.models.scan import (
    Sector,
    beam_meets,
    beam_passes,
    next_sector,
    sector_at,
    time_after_share_ns,
)
from plotfeed.models.state import Floats, Looks, Plots, Targets, TruthState
from plotfeed.models.truth import NS, Trajectories

TRAVEL_TIME_STEPS = 5
"""Of the fixed point for the time at which a sound left: they leave 3 cm at 60 m/s and 1 km."""


@dataclass(frozen=True, slots=True)
class SectorReport:
    """What became of one sector: its plots are in the order of time, as they are sent."""

    sensor: str
    sector: Sector
    looks: Looks
    plots: Plots
    messages: list[Message]


class Station:
    """A sensor, where it stands and what it reports."""

    def __init__(self, scene: Scene, sensor: Sensor, trajectories: Trajectories) -> None:
        self.sensor = sensor
        self._site = scene.scene.site
        self.model = sensor.model(self._site)
        self.frame = frame_at(scene.scene.site, sensor.position_enu_m)
        self.period_ns = round(sensor.scan.period_s * NS)
        self.sectors = sensor.scan.sectors if isinstance(sensor.scan, RotatingScan) else 1
        self._trajectories = trajectories
        self._chance = Chance(scene.scene.seed, sensor.id)
        self._reporters = reporters_of(scene, sensor)
        self._edge = (-1, -1, np.zeros(0))

    def change(self, sensor: Sensor) -> None:
        """Be that sensor from the next sector on: the same one, with other values."""
        self.sensor = sensor
        self.model = sensor.model(self._site)

    def sector_at(self, t_utc_ns: int) -> Sector:
        """The sector under way at a time."""
        return sector_at(t_utc_ns, self.period_ns, self.sectors)

    def next_sector(self, sector: Sector) -> Sector:
        """The one after it."""
        return next_sector(sector, self.period_ns, self.sectors)

    def report(self, sector: Sector) -> SectorReport:
        """Look at every drone when the beam is there, and say what was measured."""
        truth = self._illuminated(sector)
        looks, detections = self.model.observe(
            self._targets(truth),
            self._chance.rng(Purpose.DETECTION, sector.scan, sector.index),
        )
        alarms = self.model.draw_false_alarms(
            sector, self._chance.rng(Purpose.FALSE_ALARMS, sector.scan, sector.index)
        )
        plots = self._with_heights(Plots.joined([detections, alarms]).in_order_of_time())
        seen = Seen(sector, looks, plots, self._trajectories.state_at)
        messages = [message for report in self._reporters for message in report(seen)]
        return SectorReport(self.sensor.id, sector, looks, plots, messages)

    def _illuminated(self, sector: Sector) -> TruthState:
        """The drones that the sensor looks at in a sector, each when it does."""
        if self.sectors == 1:
            return self._trajectories.state_at(sector.end_ns)
        passed, share = beam_passes(sector, *self._azimuths_at_edges(sector))
        drones = np.flatnonzero(passed)
        if not len(drones):
            return self._trajectories.state_at(sector.end_ns, drones)

        def azimuth_at(share: Floats) -> Floats:
            state = self._trajectories.state_at(time_after_share_ns(sector, share), drones)
            azimuth_deg = np.full(len(drones), np.nan)  # of one that is gone before the beam comes
            azimuth_deg[np.isin(drones, state.drone)] = self._azimuths(state)
            return azimuth_deg

        share = beam_meets(sector, share[drones], azimuth_at)
        met = ~np.isnan(share)
        state = self._trajectories.state_at(time_after_share_ns(sector, share[met]), drones[met])
        return state.rows(np.argsort(state.t_utc_ns, kind="stable"))

    def _azimuths_at_edges(self, sector: Sector) -> tuple[Floats, Floats]:
        """Azimuth of every drone there ever was, at the start and at the end; NaN if it is gone.

        At the start it is what it was taken for when the sector before was reported, whatever
        telemetry says since: else a drone could be on either side of the border in both.
        """
        version = self._trajectories.version
        end = self._azimuths_at(sector.end_ns)
        if (sector.start_ns, version) == self._edge[:2]:
            start = self._edge[2]
        else:
            start = self._azimuths_at(sector.start_ns)
            if sector.start_ns == self._edge[0]:
                taken = self._edge[2]
                start[: len(taken)] = np.where(np.isnan(taken), start[: len(taken)], taken)
        self._edge = (sector.end_ns, version, end)
        return start, end

    def _azimuths_at(self, t_utc_ns: int) -> Floats:
        state = self._trajectories.state_at(t_utc_ns)
        azimuth_deg = np.full(len(self._trajectories.names), np.nan)
        azimuth_deg[state.drone] = self._azimuths(state)
        return azimuth_deg

    def _azimuths(self, state: TruthState) -> Floats:
        return enu_to_aer(self.frame.from_ecef(state.position_ecef_m))[0]

    def _targets(self, truth: TruthState) -> Targets:
        """The drones from here, as they are and as they are sensed."""
        true_position_enu_m = self.frame.from_ecef(truth.position_ecef_m)
        sensed, speed_m_s = truth, self.model.signal_speed_m_s
        position_enu_m = true_position_enu_m
        if speed_m_s is not None:
            sensed, position_enu_m = self._when_it_left(truth, position_enu_m, speed_m_s)
            true_position_enu_m = true_position_enu_m[np.isin(truth.drone, sensed.drone)]
        return Targets(
            drone=sensed.drone,
            t_utc_ns=truth.t_utc_ns[np.isin(truth.drone, sensed.drone)],
            position_enu_m=position_enu_m,
            true_position_enu_m=true_position_enu_m,
            signatures=self._trajectories.signatures,
        )

    def _when_it_left(
        self, truth: TruthState, position_enu_m: Floats, speed_m_s: float
    ) -> tuple[TruthState, Floats]:
        """The drones when what arrives now left them: t - d/c, where d is the distance then.

        Each step shrinks the error by the drone's speed over that of the signal.
        """
        sensed, arrival_ns = truth, truth.t_utc_ns
        for _ in range(TRAVEL_TIME_STEPS):
            travel_ns = np.linalg.norm(position_enu_m, axis=1) / speed_m_s * NS
            departure_ns = arrival_ns - np.rint(travel_ns).astype(np.int64)
            there = self._trajectories.state_at(departure_ns, sensed.drone)
            arrival_ns = arrival_ns[np.isin(sensed.drone, there.drone)]
            sensed = there
            position_enu_m = self.frame.from_ecef(sensed.position_ecef_m)
        return sensed, position_enu_m

    def _with_heights(self, plots: Plots) -> Plots:
        """Heights of plots that have a place in three dimensions; NaN for the others."""
        if not len(plots) or np.isnan(plots.elevation_deg).all() or np.isnan(plots.range_m).all():
            return plots
        measured_enu_m = aer_to_enu(plots.azimuth_deg, plots.elevation_deg, plots.range_m)
        return replace(plots, height_m=self.frame.to_geodetic(measured_enu_m)[2])

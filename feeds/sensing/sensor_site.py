"""Where a sensor stands: how the drones appear from there, and to its own clock and axes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from plotfeed.feeds.formats import FORMATS
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.effect_keys import readings_of
from plotfeed.feeds.scene.sensors.sensor_keys import SensorGeometry
from plotfeed.models.beam import CULLED_FROM
from plotfeed.models.chance import Chance
from plotfeed.models.effects.readings import Readings
from plotfeed.models.frames import LocalFrame, aer_to_enu, enu_to_aer
from plotfeed.models.sensors.sensor_model import SensorModel, Targets
from plotfeed.models.state import Floats, Ints, PlaceState, Plots, TruthState
from plotfeed.models.truth import Trajectories
from plotfeed.proto.utc import NS

TRAVEL_TIME_STEPS = 5
"""Of the fixed point for when a sound left: they leave 3 cm at 60 m/s and 1 km."""


WHILE_IT_TRAVELS = 1.5
"""By which a drone may be further away when its sound arrives: at half the speed of that."""


@dataclass(frozen=True, slots=True)
class SensorSite:
    """Where a sensor stands among the drones, and whose random numbers it has.

    `axes` are its own: another frame than `frame` only if it stands askew. `readings` are what it
    reads in place of what it finds, None if that is the same. Its clock may be ahead. `errs` says
    whether there is any of this; `tells_heights`, whether any of its formats has heights.
    """

    frame: LocalFrame
    axes: LocalFrame
    readings: Readings | None
    clock_ahead_ns: int
    reads_bistatic_ranges: bool
    errs: bool
    tells_heights: bool
    trajectories: Trajectories
    chance: Chance

    @classmethod
    def of(
        cls, sensor: Sensor, frame: LocalFrame, trajectories: Trajectories, chance: Chance
    ) -> Self:
        """The site of a sensor that stands at a frame's place, with its systematic errors."""
        return cls(
            frame=frame,
            axes=frame if sensor.bias is None else sensor.bias.axes(frame),
            readings=readings_of(sensor.bias, sensor.drift, chance, sensor.scan.period_ns),
            reads_bistatic_ranges=sensor.geometry is SensorGeometry.BISTATIC,
            clock_ahead_ns=0 if sensor.bias is None else round(sensor.bias.time_offset_s * NS),
            errs=sensor.bias is not None or sensor.drift is not None,
            tells_heights=any(FORMATS[name].facts.tells_heights for name in sensor.report),
            trajectories=trajectories,
            chance=chance,
        )

    def states_at(
        self, model: SensorModel, t_utc_ns: Ints | int, drones: Ints | None = None
    ) -> PlaceState:
        """What there is at a time, or of `drones` (m,) at times (m,), as far as the model asks."""
        if model.measures_range_rate:
            return self.trajectories.state_at(t_utc_ns, drones)
        return self.trajectories.places_at(t_utc_ns, drones)

    def targets(self, truth: PlaceState, model: SensorModel) -> Targets:
        """The drones within reach from here, as they are and as they are sensed."""
        truth = self._within_reach(truth, model)
        true_position_enu_m = self.frame.from_ecef(truth.position_ecef_m)
        sensed, t_utc_ns, position_enu_m = truth, truth.t_utc_ns, true_position_enu_m
        if model.signal_speed_m_s is not None:
            sensed, position_enu_m = self._when_it_left(
                truth, position_enu_m, model, model.signal_speed_m_s
            )
            there = np.isin(truth.drone, sensed.drone)
            t_utc_ns, true_position_enu_m = t_utc_ns[there], true_position_enu_m[there]
        if self.axes is not self.frame:
            position_enu_m = self.axes.from_ecef(sensed.position_ecef_m)
        velocity_enu_m_s = None
        if model.measures_range_rate and isinstance(sensed, TruthState):
            velocity_enu_m_s = self.frame.rotate_from_ecef(sensed.velocity_ecef_m_s)
        return Targets(
            drone=sensed.drone,
            t_utc_ns=t_utc_ns,
            position_enu_m=position_enu_m,
            true_position_enu_m=true_position_enu_m,
            signatures=self.trajectories.signatures,
            velocity_enu_m_s=velocity_enu_m_s,
            readings=self.readings,
        )

    def _within_reach(self, truth: PlaceState, model: SensorModel) -> PlaceState:
        """Drones that are near enough; of few of them the model itself finds out as fast."""
        if len(truth) < CULLED_FROM:
            return truth
        reach_m = model.range_max_m
        if model.signal_speed_m_s is not None:
            reach_m *= WHILE_IT_TRAVELS
        return truth.rows(self.frame.has_within(truth.position_ecef_m, reach_m))

    def apparent_at(self, t_utc_ns: int, drones: Ints) -> TruthState:
        """Where drones are at a time of the sensor's clock, by its own axes and readings.

        Errors of bistatic ranges are left out: the sensor's tracks take the place as it is.
        """
        truth = self.trajectories.state_at(t_utc_ns - self.clock_ahead_ns, drones)
        place_enu_m = self.axes.from_ecef(truth.position_ecef_m)
        if self.readings is not None:
            azimuth_deg, elevation_deg, range_m = enu_to_aer(place_enu_m)
            azimuth_deg = self.readings.azimuth_deg(azimuth_deg, truth.t_utc_ns)
            if not self.reads_bistatic_ranges:
                range_m = self.readings.range_m(range_m, truth.t_utc_ns)
            place_enu_m = aer_to_enu(np.nan_to_num(azimuth_deg), elevation_deg, range_m)
        velocity_enu_m_s = self.axes.rotate_from_ecef(truth.velocity_ecef_m_s)
        return replace(
            truth,
            position_ecef_m=self.frame.to_ecef(place_enu_m),
            velocity_ecef_m_s=self.frame.rotate_to_ecef(velocity_enu_m_s),
        )

    def _when_it_left(
        self, truth: PlaceState, position_enu_m: Floats, model: SensorModel, speed_m_s: float
    ) -> tuple[PlaceState, Floats]:
        """The drones when what arrives now left them: t - d/c, where d is the distance then.

        Each step shrinks the error by the drone's speed over that of the signal.
        """
        sensed, arrival_ns = truth, truth.t_utc_ns
        for _ in range(TRAVEL_TIME_STEPS):
            travel_ns = np.linalg.norm(position_enu_m, axis=1) / speed_m_s * NS
            departure_ns = arrival_ns - np.rint(travel_ns).astype(np.int64)
            there = self.states_at(model, departure_ns, sensed.drone)
            arrival_ns = arrival_ns[np.isin(sensed.drone, there.drone)]
            sensed = there
            position_enu_m = self.frame.from_ecef(sensed.position_ecef_m)
        return sensed, position_enu_m

    def with_heights(self, plots: Plots) -> Plots:
        """Heights of plots that have a place in three dimensions, if any format tells them."""
        return with_heights(plots, self.frame) if self.tells_heights and len(plots) else plots


def with_heights(plots: Plots, frame: LocalFrame) -> Plots:
    """Heights of plots of a sensor in that frame, if they have a place in three dimensions."""
    if not (plots.measures("elevation_deg") and plots.measures("range_m")):
        return plots
    height_m = frame.heights_m(plots.azimuth_deg, plots.elevation_deg, plots.range_m)
    return plots.but(height_m=height_m)

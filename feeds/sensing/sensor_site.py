"""Where a sensor stands: how the drones appear from there, and to its own clock and axes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np

from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.effect_keys import readings_of
from plotfeed.feeds.scene.sensors.mount_keys import mount_of
from plotfeed.feeds.scene.sensors.sensor_keys import SensorGeometry
from plotfeed.models.chance import Chance
from plotfeed.models.frames import Axes, LocalFrame, aer_to_enu, enu_to_aer
from plotfeed.models.state import Ints, Looks, PlaceState, Plots, TruthState
from plotfeed.models.truth import Trajectories
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from plotfeed.models.effects.decorrelation import TargetStrengths
    from plotfeed.models.effects.readings import Readings


@dataclass(frozen=True, slots=True)
class SensorSite:
    """Where a sensor stands among the drones.

    `axes` are its own: another frame than `frame` only if it stands askew. `readings` are what it
    reads in place of what it finds, None if that is the same, `strengths` those of targets where
    they last from scan to scan. Its clock may be ahead. `errs` says
    whether there is any of this; `tells_heights`, whether any of its formats has heights.
    """

    frame: LocalFrame
    axes: LocalFrame
    readings: Readings | None
    strengths: TargetStrengths | None
    clock_ahead_ns: int
    reads_bistatic_ranges: bool
    errs: bool
    tells_heights: bool
    is_steered: bool
    """Whether a mount turns it."""
    trajectories: Trajectories

    @classmethod
    def of(
        cls, sensor: Sensor, frame: LocalFrame, trajectories: Trajectories, chance: Chance
    ) -> Self:
        """The site of a sensor that stands at a frame's place, with its systematic errors."""
        return cls(
            frame=frame,
            axes=frame if sensor.bias is None else sensor.bias.axes(frame),
            readings=readings_of(sensor.bias, sensor.drift, chance, sensor.scan.period_ns),
            strengths=strengths_of(sensor, chance),
            reads_bistatic_ranges=sensor.geometry is SensorGeometry.BISTATIC,
            clock_ahead_ns=sensor.clock_ahead_ns,
            errs=sensor.bias is not None or sensor.drift is not None,
            tells_heights=any(REPORT_FORMATS[name].tells_heights for name in sensor.report),
            is_steered=mount_of(sensor) is not None,
            trajectories=trajectories,
        )

    def states_at(
        self, velocities: bool, t_utc_ns: Ints | int, drones: Ints | None = None
    ) -> PlaceState:
        """What there is at a time, or of `drones` (m,) at times (m,), with velocities if asked."""
        if velocities:
            return self.trajectories.state_at(t_utc_ns, drones)
        return self.trajectories.places_at(t_utc_ns, drones)

    def as_they_truly_were(self, looks: Looks) -> Looks:
        """Looks along the sensor's own axes, by true east, north and up."""
        own_enu_m = aer_to_enu(looks.azimuth_deg, looks.elevation_deg, looks.range_m)
        true_enu_m = self.frame.rotate_from_ecef(self.axes.rotate_to_ecef(own_enu_m))
        azimuth_deg, elevation_deg, _ = enu_to_aer(true_enu_m)
        return looks.but(azimuth_deg=azimuth_deg, elevation_deg=elevation_deg)

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


def strengths_of(sensor: Sensor, chance: Chance) -> TargetStrengths | None:
    """How strong targets are to a sensor for which they stay so for a while; None to others."""
    tau_s: float | None = getattr(sensor, "decorrelation_s", None)
    if tau_s is None:
        return None
    from plotfeed.models.effects.decorrelation import TargetStrengths

    return TargetStrengths(chance, step_ns=sensor.scan.period_ns, time_constant_ns=tau_s * NS)


def with_heights(plots: Plots, frames: Axes) -> Plots:
    """Heights of plots of sensors in those frames, if they have a place in three dimensions."""
    if not (plots.measures("elevation_deg") and plots.measures("range_m")):
        return plots
    height_m = frames.heights_m(plots.azimuth_deg, plots.elevation_deg, plots.range_m)
    return plots.but(height_m=height_m)

"""How a sensor looks at the drones: everywhere at once, or with a beam that turns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.models.scan import Sector
from plotfeed.models.sensor import SensorModel
from plotfeed.models.state import Floats, Looks, Plots, Targets, TruthState
from plotfeed.models.truth import NS, Trajectories

TRAVEL_TIME_STEPS = 5
"""Of the fixed point for the time at which a sound left: they leave 3 cm at 60 m/s and 1 km."""


class Eye(Protocol):
    """Looks at what there is in a sector."""

    model: SensorModel
    """May be changed: it counts from the next look on."""

    def look(self, sector: Sector) -> tuple[Looks, Plots]:
        """Whom it looked at, and what it measured in the order of time, with heights."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a sensor stands among the drones, and whose random numbers it has."""

    frame: LocalFrame
    trajectories: Trajectories
    chance: Chance

    def targets(self, truth: TruthState, signal_speed_m_s: float | None) -> Targets:
        """The drones from here, as they are and as they are sensed."""
        true_position_enu_m = self.frame.from_ecef(truth.position_ecef_m)
        sensed, t_utc_ns, position_enu_m = truth, truth.t_utc_ns, true_position_enu_m
        if signal_speed_m_s is not None:
            sensed, position_enu_m = self._when_it_left(truth, position_enu_m, signal_speed_m_s)
            there = np.isin(truth.drone, sensed.drone)
            t_utc_ns, true_position_enu_m = t_utc_ns[there], true_position_enu_m[there]
        return Targets(
            drone=sensed.drone,
            t_utc_ns=t_utc_ns,
            position_enu_m=position_enu_m,
            true_position_enu_m=true_position_enu_m,
            signatures=self.trajectories.signatures,
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
            there = self.trajectories.state_at(departure_ns, sensed.drone)
            arrival_ns = arrival_ns[np.isin(sensed.drone, there.drone)]
            sensed = there
            position_enu_m = self.frame.from_ecef(sensed.position_ecef_m)
        return sensed, position_enu_m

    def with_heights(self, plots: Plots) -> Plots:
        """Heights of plots that have a place in three dimensions; NaN for the others."""
        if not len(plots) or np.isnan(plots.elevation_deg).all() or np.isnan(plots.range_m).all():
            return plots
        measured_enu_m = aer_to_enu(plots.azimuth_deg, plots.elevation_deg, plots.range_m)
        return replace(plots, height_m=self.frame.to_geodetic(measured_enu_m)[2])


class StaringEye:
    """Everywhere at once, when a scan ends."""

    def __init__(self, model: SensorModel, place: Place) -> None:
        self.model = model
        self._place = place

    def look(self, sector: Sector) -> tuple[Looks, Plots]:
        """At all that is there."""
        truth, chance = self._place.trajectories.state_at(sector.end_ns), self._place.chance
        looks, detections = self.model.observe(
            self._place.targets(truth, self.model.signal_speed_m_s),
            chance.rng(Purpose.DETECTION, sector.scan),
        )
        alarms = self.model.draw_false_alarms(sector, chance.rng(Purpose.FALSE_ALARMS, sector.scan))
        plots = Plots.joined([detections, alarms]).in_order_of_time()
        return looks, self._place.with_heights(plots)

"""Sensors whose plots follow from all detections of a scan, joined to targets."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from plotfeed.models.beam import Sector
from plotfeed.models.sensors.sensor_model import NO_LOOKS, NO_PLOTS, SensorModel, Targets
from plotfeed.models.state import Looks, Plots

if TYPE_CHECKING:
    from plotfeed.models.dwell_agenda import Agenda, PointedBeams


@dataclass(frozen=True, kw_only=True)
class JointSensor(SensorModel, ABC):
    """A sensor that has a pass of its own, in which false alarms meet detections of targets.

    A plot that is made of detections of several targets, or of none, is a false alarm: a ghost.
    """

    @abstractmethod
    def observe_scan(
        self, targets: Targets, sector: Sector, rng: np.random.Generator
    ) -> tuple[Looks, Plots]:
        """Looks at the targets of a scan and all of its plots, ghosts among them."""

    @property
    def errs_as_stated(self) -> bool:
        """Not to more than first order, and not of what was joined wrongly."""
        return False

    def observe(self, targets: Targets, rng: np.random.Generator) -> tuple[Looks, Plots]:
        """Looks and plots of a scan that ends when the targets are looked at."""
        if not len(targets):
            return NO_LOOKS, NO_PLOTS
        end_ns = int(targets.t_utc_ns[0])
        sector = Sector(0, 0, end_ns, end_ns, 0.0, 360.0, stares=True)
        return self.observe_scan(targets, sector, rng)

    def draw_false_alarms(self, sector: Sector, rng: np.random.Generator) -> Plots:  # noqa: ARG002
        """None by themselves: they are among the plots of a scan."""
        return NO_PLOTS


@dataclass(frozen=True, kw_only=True)
class DwellingSensor(JointSensor, ABC):
    """A sensor that chooses where it looks next, by an agenda that goes from scan to scan."""

    @property
    @abstractmethod
    def among_all(self) -> SensorModel:
        """The sensor of one dwell, among what surrounds it."""

    @abstractmethod
    def observe_period(
        self, agenda: Agenda, targets: Targets, sector: Sector, rng: np.random.Generator
    ) -> tuple[Looks, Plots, Agenda]:
        """Looks and plots of a period, and what there is to do after it."""

    @abstractmethod
    def pointed(self, agenda: Agenda) -> PointedBeams:
        """Where the beams of the last period pointed, by the agenda after it."""

"""A beam that sees every drone at once, when a scan ends."""

from __future__ import annotations

from typing import Protocol

from plotfeed.feeds.sensing.sensor_site import SensorSite
from plotfeed.models.beam.scan import Sector
from plotfeed.models.chance import Purpose
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.sensors.sensor_model import SensorModel
from plotfeed.models.state import Looks, Plots


class Beam(Protocol):
    """What looks at the drones in a sector: everywhere at once, or as it turns."""

    model: SensorModel
    """May be changed: it counts from the next look on."""
    site: SensorSite
    """May be changed as the model."""

    def look(self, sector: Sector) -> tuple[Looks, Plots]:
        """Whom it looked at, and what it measured in the order of time, with heights."""


class StaringBeam:
    """Everywhere at once, when a scan ends."""

    def __init__(self, model: SensorModel, site: SensorSite) -> None:
        self.model = model
        self.site = site

    @nan_without_warnings
    def look(self, sector: Sector) -> tuple[Looks, Plots]:
        """Looks at all drones that are there, and what is measured of them."""
        truth, chance = self.site.states_at(self.model, sector.end_ns), self.site.chance
        looks, detections = self.model.observe(
            self.site.targets(truth, self.model),
            chance.rng(Purpose.DETECTION, sector.scan),
        )
        alarms = self.model.draw_false_alarms(sector, chance.rng(Purpose.FALSE_ALARMS, sector.scan))
        plots = Plots.joined([detections, alarms]).in_order_of_time()
        return looks, self.site.with_heights(plots)

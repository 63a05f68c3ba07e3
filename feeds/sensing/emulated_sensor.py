"""One sensor of a scene at its place: a sector of time in, its looks, plots and messages out.

Nothing here waits or sends. A sensor can be asked for any sector, in any order, unless it tracks.
"""

from __future__ import annotations

from plotfeed.feeds.formats import SceneFormats, Seen
from plotfeed.feeds.messages.sector_report import SectorReport
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.sensing.beams import Beam, RotatingBeam, StaringBeam
from plotfeed.feeds.sensing.sensor_site import SensorSite
from plotfeed.models.beam import Sector, Timetable
from plotfeed.models.chance import Chance
from plotfeed.models.state import Looks, Plots
from plotfeed.models.truth import Trajectories

NS_IN_MS = 1e6
AHEAD_NS = 10_000_000
"""A sector is worked out this long before its messages are due, so that only sending is left."""


class EmulatedSensor:
    """A sensor, where it stands and what it reports."""

    def __init__(self, scene: Scene, sensor: Sensor, trajectories: Trajectories) -> None:
        self.sensor = sensor
        self.frame = frame_at(scene.scene.site, sensor.position_enu_m)
        self.period_ns = sensor.scan.period_ns
        self.sectors = sensor.scan.sectors
        self._scene_site = scene.scene.site
        self._trajectories = trajectories
        self._formats = SceneFormats(scene.model_copy(update={"sensor": [sensor]}))
        self._chance = Chance(scene.scene.seed, sensor.id)
        jitter_ns = sensor.scan.jitter_ms * NS_IN_MS
        self._timetable = Timetable(self.period_ns, self.sectors, jitter_ns, self._chance)
        site = SensorSite.of(sensor, self.frame, trajectories, self._chance)
        model = sensor.model(self._scene_site)
        self._beam: Beam = (
            StaringBeam(model, site)
            if self.sectors == 1
            else RotatingBeam(model, site, self._timetable)
        )

    def change(self, sensor: Sensor) -> None:
        """Take on other values from the next sector on."""
        self.sensor = sensor
        self._beam.model = sensor.model(self._scene_site)
        self._beam.site = SensorSite.of(sensor, self.frame, self._trajectories, self._chance)

    def sector_at(self, t_utc_ns: int) -> Sector:
        """The sector under way at a time."""
        return self._timetable.sector_at(t_utc_ns)

    def next_sector(self, sector: Sector) -> Sector:
        """The one after it."""
        return self._timetable.next_sector(sector)

    def look(self, sector: Sector) -> tuple[Looks, Plots]:
        """Whom the sensor looks at in a sector, and what it measures, in the order of time."""
        return self._beam.look(sector)

    def report(self, sector: Sector) -> SectorReport:
        """Look at every drone when the beam is there, and say what was measured."""
        looks, plots = self.look(sector)
        seen = Seen.of_one(sector, plots, looks, self._trajectories.state_at)
        if self._beam.site.errs:
            seen = self._as_taken(sector, plots, looks)
        (messages,) = self._formats.messages(seen)
        return SectorReport(self.sensor.id, sector, looks, plots, messages)

    def _as_taken(self, sector: Sector, plots: Plots, looks: Looks) -> Seen:
        """What was seen by the sensor's own clock, and the truth as it appears to it."""
        site = self._beam.site
        told = plots.but(t_utc_ns=plots.t_utc_ns + site.clock_ahead_ns)
        return Seen.of_one(sector, told, looks, site.apparent_at)

"""One sensor by itself, asked for any sector in any order."""

from __future__ import annotations

from dataclasses import replace

from plotfeed.feeds.engine.emulated_sensors import EmulatedSensors
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.models.beam import Sector, Timetable
from plotfeed.models.chance import Chance
from plotfeed.models.truth import Trajectories
from plotfeed.proto.utc import NS_IN_MS


class Station:
    """A sensor, where it stands and what it reports."""

    def __init__(self, scene: Scene, sensor: Sensor, trajectories: Trajectories) -> None:
        self.sensor = sensor
        self.sectors = sensor.scan.sectors
        self.period_ns = sensor.scan.period_ns
        self.frame = frame_at(scene.scene.site, sensor.position_enu_m)
        self._scene, self._trajectories = scene, trajectories
        self._emulated = EmulatedSensors(scene, trajectories, [sensor])
        chance = Chance(scene.scene.seed, sensor.id)
        jitter_ns = sensor.scan.jitter_ms * NS_IN_MS
        self._timetable = Timetable(self.period_ns, self.sectors, jitter_ns, chance)

    def change(self, sensor: Sensor) -> None:
        """Be that one from the next sector on."""
        self.sensor = sensor
        self._emulated = EmulatedSensors(self._scene, self._trajectories, [sensor])

    def sector_at(self, t_utc_ns: int) -> Sector:
        return self._timetable.sector_at(t_utc_ns)

    def next_sector(self, sector: Sector) -> Sector:
        return self._timetable.next_sector(sector)

    def report(self, sector: Sector) -> Batch:
        self._emulated.upcoming.go_on_with(0, sector)
        [batch] = self._emulated.seen(sector.end_ns + 1)
        return replace(batch, messages=self._emulated.messages(batch))

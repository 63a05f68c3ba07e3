"""The false alarms of sensors, each in the sector in which it comes.

A rotating sensor's are drawn when a scan begins, all at once, and wait until the beam is there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from plotfeed.models.beam import Sector, Sectors, Timetable
from plotfeed.models.chance import NO_SCAN, Chance, Purpose
from plotfeed.models.sensors.polar_radar import PolarRadar
from plotfeed.models.sensors.sensor_model import NO_PLOTS, SensorModel
from plotfeed.models.state import Plots

if TYPE_CHECKING:
    from plotfeed.models.clutter import ClutterMap

OfSensor = tuple[int, Plots]
NONE_DUE_NS = np.iinfo(np.int64).max


class FalseAlarmsDue:
    """Draws false alarms, and keeps those that are not due yet, by the index of the sensor."""

    def __init__(self, chances: Sequence[Chance], timetables: Sequence[Timetable]) -> None:
        self._chances = chances
        self._timetables = timetables
        self._scan = np.full(len(chances), NO_SCAN, np.int64)
        """The last one of each sensor whose alarms are drawn."""
        self._next_ns = np.full(len(chances), NONE_DUE_NS, np.int64)
        self._due: dict[int, Plots] = {}
        self.clutter: dict[int, Sequence[ClutterMap]] = {}
        """Maps of sensors that see any, whose plots come as false alarms do."""

    def forget(self, sensor: int) -> None:
        """Draw those of the scan under way anew: the sensor's model is another one now."""
        self._scan[sensor] = NO_SCAN
        self._next_ns[sensor] = NONE_DUE_NS
        self._due.pop(sensor, None)

    def of_scans(self, sectors: Sectors, models: Mapping[int, SensorModel]) -> list[OfSensor]:
        """False alarms of scans of sensors that stare, by sensor."""
        found = []
        for row, sensor in enumerate(sectors.sensor.tolist()):
            alarms = self._drawn(sensor, int(sectors.scan[row]), sectors.one(row), models[sensor])
            if len(alarms):
                found.append((sensor, alarms))
        return found

    def of_turns(self, sectors: Sectors, models: Mapping[int, SensorModel]) -> list[OfSensor]:
        """False alarms within sectors of rotating sensors, of which each one's are in order."""
        begun = sectors.scan != self._scan[sectors.sensor]
        if begun.any():
            which = zip(sectors.sensor[begun].tolist(), sectors.scan[begun].tolist(), strict=True)
            for sensor, scan in dict.fromkeys(which):
                if scan != self._scan[sensor]:
                    self._draw(sensor, scan, models[sensor])
        is_due = self._next_ns[sectors.sensor] < sectors.end_ns
        if not is_due.any():
            return []
        due = np.unique(sectors.sensor[is_due])
        return [
            (sensor, alarms)
            for sensor in due.tolist()
            if len(alarms := self._taken(sensor, sectors))
        ]

    def _draw(self, sensor: int, scan: int, model: SensorModel) -> None:
        alarms = self._drawn(sensor, scan, self._timetables[sensor].turn(scan), model)
        self._scan[sensor] = scan
        self._keep(sensor, Plots.joined([self._due.get(sensor, NO_PLOTS), alarms]))

    def _drawn(self, sensor: int, scan: int, sector: Sector, model: SensorModel) -> Plots:
        """False alarms of a scan, and what clutter adds to them."""
        chance = self._chances[sensor]
        alarms = model.draw_false_alarms(sector, chance.rng(Purpose.FALSE_ALARMS, scan))
        if sensor not in self.clutter or not isinstance(model, PolarRadar):
            return alarms
        rng = chance.rng(Purpose.CLUTTER, scan)
        found = [each.plots(model, sector, rng) for each in self.clutter[sensor]]
        return Plots.joined([alarms, *found])

    def _taken(self, sensor: int, sectors: Sectors) -> Plots:
        of_sensor = sectors.sensor == sensor
        alarms, start_ns = self._due[sensor], sectors.start_ns[of_sensor][0]
        a, b = np.searchsorted(alarms.t_utc_ns, (start_ns, sectors.end_ns[of_sensor][-1]))
        self._keep(sensor, alarms.between(int(b), len(alarms)))
        return alarms.between(int(a), int(b))

    def _keep(self, sensor: int, alarms: Plots) -> None:
        if len(alarms):
            self._due[sensor] = alarms = alarms.in_order_of_time()
            self._next_ns[sensor] = alarms.t_utc_ns[0]
        else:
            self._due.pop(sensor, None)
            self._next_ns[sensor] = NONE_DUE_NS

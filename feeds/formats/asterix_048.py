"""ASTERIX as rotating radars speak it: categories 048 and 034."""

from __future__ import annotations

import numpy as np

from plotfeed.feeds.formats import (
    AsterixFormat,
    Blocks,
    Format,
    Sensors,
    among,
    limits_of,
    numbers_of,
    places_of,
    plots_in_asterix,
    sources_of,
)
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.frames import Axes, aer_to_enu
from plotfeed.models.state import Floats
from plotfeed.proto.asterix.cat048 import PlotEncoder048, north_markers, sector_crossings
from plotfeed.proto.asterix.codec.encode import Parts

ALL = slice(None)


class Asterix048(AsterixFormat):
    """Target reports of category 048, and service messages of 034 where a beam turns.

    A sector's target reports leave when its end is crossed, before the message that says so; the
    north marker comes before the crossing of sector 0.
    """

    def __init__(self, scene: Scene, sensors: Sensors) -> None:
        super().__init__(scene, sensors)
        self._plots = PlotEncoder048(*sources_of(sensors), max_octets=limits_of(scene, sensors))
        self._sea_level = scene.sea_level()
        places = [frame_at(scene.scene.site, s.position_enu_m) for s in sensors.values()]
        self._frames = Axes.of(places)
        turning = {i: sensor for i, sensor in sensors.items() if sensor.scan.rotates}
        self._turning = numbers_of(turning, len(self._numbers))
        self._all_turn = len(turning) == len(sensors)
        self._crossings = None
        if turning:
            source = sources_of(turning)
            self._crossings = sector_crossings(*source)
            self._north = north_markers(
                *source,
                antenna_period_s=[sensor.scan.period_s for sensor in turning.values()],
                place=places_of(scene, turning),
            )

    def blocks(self, batch: Batch) -> list[Blocks]:
        """Blocks of category 048, then those of category 034."""
        sectors = batch.sectors
        parts = Parts(batch.plots_by, self._numbers[sectors.sensor])
        # Height of mean sea level above the ellipsoid where the plots are.
        undulation_m: Floats | float = self._sea_level.level_m or 0.0
        if batch.plots.measures("height_m") and self._sea_level.level_m is None:
            there = batch.plots.azimuth_deg, batch.plots.elevation_deg, batch.plots.range_m
            frames = self._frames.rows(parts.of_rows())
            latitude_deg, longitude_deg, _ = frames.to_geodetic(aer_to_enu(*there))
            undulation_m = self._sea_level.undulation_m(latitude_deg, longitude_deg)
        plots = self._plots.blocks_by(batch.plots, parts, undulation_m)
        if self._crossings is None:
            return [(48, plots)]
        turning = self._turning[sectors.sensor]
        which = ALL if self._all_turn else np.flatnonzero(turning >= 0)
        end_ns, end_deg, turning = sectors.end_ns[which], sectors.end_deg[which], turning[which]
        crossings = self._crossings.one_each(end_ns, turning, {"I034/020": end_deg % 360.0})
        service = [[block] for block in crossings]
        north = np.flatnonzero(end_deg >= 360.0)
        if len(north):
            markers = self._north.one_each(end_ns[north], turning[north])
            for i, block in zip(north.tolist(), markers, strict=True):
                service[i].insert(0, block)
        if isinstance(which, slice):
            return [(48, plots), (34, service)]
        return [(48, plots), (34, among(len(batch), which, service))]


FORMAT = Format(facts=REPORT_FORMATS["asterix-048"], maker=Asterix048, plots_in=plots_in_asterix)

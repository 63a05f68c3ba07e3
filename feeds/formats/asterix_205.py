"""ASTERIX as radio direction finders speak it: categories 205 and 025."""

from __future__ import annotations

from plotfeed.feeds.formats import (
    AsterixFormat,
    Blocks,
    Format,
    Sensors,
    numbers_of,
    plots_in_asterix,
    sources_of,
)
from plotfeed.feeds.formats.asterix_015 import Status025
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.proto.asterix.cat205 import BearingEncoder205
from plotfeed.proto.asterix.codec.encode import Parts

# Numbers set aside for the reports of a scan, so that they do not depend on earlier ones.
REPORTS_A_SCAN = 16


class Asterix205(AsterixFormat):
    """Sensor data of 205, a block a bearing, and 025 of sensors that 015 does not bring it of."""

    def __init__(self, scene: Scene, sensors: Sensors) -> None:
        super().__init__(scene, sensors)
        self._numbers = numbers_of(sensors)
        places = [frame_at(scene.scene.site, s.position_enu_m) for s in sensors.values()]
        self._bearings = BearingEncoder205(
            *sources_of(sensors),
            latitude_deg=[place.latitude_deg for place in places],
            longitude_deg=[place.longitude_deg for place in places],
        )
        told_by_015 = {i for i, sensor in sensors.items() if "asterix-015" in sensor.report}
        self._status = Status025(
            scene, {i: sensor for i, sensor in sensors.items() if i not in told_by_015}
        )

    def blocks(self, batch: Batch) -> list[Blocks]:
        """Blocks of category 205, then 025 where it is due."""
        sectors = batch.sectors
        parts = Parts(batch.plots_by, self._numbers[sectors.sensor])
        first = sectors.scan * REPORTS_A_SCAN
        bearings = self._bearings.blocks_by(batch.plots, parts, sectors.end_ns, first)
        return [(205, bearings), *self._status.blocks(sectors)]


FORMAT = Format(facts=REPORT_FORMATS["asterix-205"], maker=Asterix205, plots_in=plots_in_asterix)

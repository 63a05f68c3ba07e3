"""ASTERIX as radio direction finders speak it: categories 205 and 025."""

from __future__ import annotations

from plotfeed.feeds.formats.asterix_015 import Status025
from plotfeed.feeds.formats.message_format import Seen, Topics
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.proto.asterix.cat205 import BearingEncoder205

REPORTS_A_SCAN = 16
"""Numbers set aside for the reports of a scan, so that they do not depend on earlier ones."""


class Asterix205:
    """Sensor data of 205, a block a bearing, and 025."""

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        self._topics = Topics(scene, sensor)
        place = frame_at(scene.scene.site, sensor.position_enu_m)
        self._bearings = BearingEncoder205(
            sensor.sac,
            sensor.sic,
            latitude_deg=place.latitude_deg,
            longitude_deg=place.longitude_deg,
        )
        self._status = Status025(scene, sensor)

    def messages(self, seen: Seen) -> list[Message]:
        """Blocks of category 205, then 025 if it is due."""
        sector = seen.sector
        first = sector.scan * REPORTS_A_SCAN
        bearings = self._bearings.blocks(seen.plots, sector.end_ns, first_report=first)
        blocks = [(205, block) for block in bearings]
        return self._topics.asterix(sector, [*blocks, *self._status.blocks(sector)])

"""ASTERIX as rotating radars speak it: categories 048 and 034."""

from __future__ import annotations

from plotfeed.feeds.formats.message_format import Seen, Topics, max_block_octets
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.proto.asterix.cat048 import PlotEncoder048, ServiceEncoder034


class Asterix048:
    """Target reports of category 048, and service messages of 034 where a beam turns.

    A sector's target reports leave when its end is crossed, before the message that says so; the
    north marker comes before the crossing of sector 0.
    """

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        self._topics = Topics(scene, sensor)
        self._plots = PlotEncoder048(
            sensor.sac,
            sensor.sic,
            geoid_undulation_m=scene.telemetry.geoid_undulation_m or 0.0,
            max_octets=max_block_octets(scene, sensor),
        )
        self._service = None
        if sensor.scan.rotates:
            self._service = ServiceEncoder034(
                sensor.sac, sensor.sic, antenna_period_s=sensor.scan.period_s
            )

    def messages(self, seen: Seen) -> list[Message]:
        """Blocks of category 048, then those of category 034."""
        sector = seen.sector
        blocks = [(48, block) for block in self._plots.blocks(seen.plots)]
        if self._service is not None:
            if sector.end_deg >= 360.0:
                blocks.append((34, self._service.north_marker(sector.end_ns)))
            crossed_deg = sector.end_deg % 360.0
            blocks.append((34, self._service.sector_crossing(sector.end_ns, crossed_deg)))
        return self._topics.asterix(sector, blocks)

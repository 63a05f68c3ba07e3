"""plotfeed's own protobuf."""

from __future__ import annotations

from plotfeed.feeds.formats.message_format import Seen, Topics
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.proto.batch import plot_batch

FACTS = REPORT_FORMATS["plots"]


class PlotBatches:
    """One message a sector; an empty one says that nothing was found."""

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        self._topics = Topics(scene, sensor)
        self._sensor = sensor.id

    def messages(self, seen: Seen) -> list[Message]:
        """The batch of the sector."""
        sector = seen.sector
        batch = plot_batch(self._sensor, sector.scan, sector.index, seen.plots)
        return [self._topics.message(FACTS.topic, FACTS.content_type, batch, sector)]

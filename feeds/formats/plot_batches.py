"""plotfeed's own protobuf."""

from __future__ import annotations

from plotfeed.feeds.formats.message_format import Topics
from plotfeed.feeds.messages.message import PROTOBUF, Message
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.models.beam.scan import Sector
from plotfeed.models.state import Plots
from plotfeed.proto.batch import plot_batch

CONTENT_TYPE = f"{PROTOBUF}; messageType=plotfeed.v1.PlotBatch"


class PlotBatches:
    """One message a sector; an empty one says that nothing was found."""

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        self._topics = Topics(scene, sensor)
        self._sensor = sensor.id

    def messages(self, sector: Sector, plots: Plots) -> list[Message]:
        """That message."""
        batch = plot_batch(self._sensor, sector.scan, sector.index, plots)
        return [self._topics.message("plots", CONTENT_TYPE, batch, sector)]

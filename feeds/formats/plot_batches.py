"""The plainest of formats: plotfeed's own batches in protobuf."""

from __future__ import annotations

from plotfeed.feeds.formats import Format, Sensors, addresses_in
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message, SectorMessage
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.proto.plot_messages import plot_batches, plots_in_batch

PLOTS = REPORT_FORMATS["plots"]


class PlotBatches:
    """plotfeed's own protobuf, one message a sector; an empty one says that nothing was found."""

    def __init__(self, scene: Scene, sensors: Sensors) -> None:
        self._names = {i: sensor.id for i, sensor in sensors.items()}
        self._addresses = addresses_in(scene, sensors, PLOTS)

    def messages(self, batch: Batch) -> list[list[Message]]:
        """The batch of each sector."""
        sectors, stamps = batch.sectors, batch.stamps
        sensors = sectors.sensor.tolist()
        batches = plot_batches(
            [self._names[sensor] for sensor in sensors],
            [stamp.scan for stamp in stamps],
            [stamp.index for stamp in stamps],
            batch.plots,
            batch.plots_by.tolist(),
        )
        every = zip(sensors, batches, stamps, strict=True)
        return [[SectorMessage(self._addresses[i], batch, stamp)] for i, batch, stamp in every]


FORMAT = Format(facts=REPORT_FORMATS["plots"], maker=PlotBatches, plots_in=plots_in_batch)

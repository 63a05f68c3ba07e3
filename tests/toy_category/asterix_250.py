"""The second file: category 250 as a format that sensors report in."""

from __future__ import annotations

from toy_category.cat250 import CAT250, PlotEncoder250

from plotfeed.feeds.formats import Batch, Format, SectorFormat
from plotfeed.feeds.formats.message_format import max_block_octets
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.report_formats import SentCategory, asterix
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.proto.asterix.decode_plots import PlotItems, plots_in_asterix


class Asterix250(SectorFormat):
    """Plots of category 250, and nothing besides."""

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        super().__init__(scene, sensor)
        most = max_block_octets(scene, sensor)
        self._plots = PlotEncoder250(sensor.sac, sensor.sic, max_octets=most)

    def messages_of(self, batch: Batch) -> list[Message]:
        """Blocks of category 250."""
        blocks = [(250, block) for block in self._plots.blocks(batch.plots)]
        return self.topics.asterix(batch.stamp, blocks)


FORMAT = Format(
    facts=asterix({250: SentCategory("plots of a radar that does not exist")}, range_step_m=1.0),
    maker=Asterix250.of_sensors,
    plots_in=plots_in_asterix,
    layouts=(CAT250,),
    plot_items=PlotItems(
        time="I250/020",
        columns={
            "range_m": "I250/030/R",
            "azimuth_deg": "I250/030/AZ",
            "elevation_deg": "I250/040",
        },
    ),
)

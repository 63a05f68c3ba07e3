"""From plots to messages: one file for each format that a sensor can report in."""

from __future__ import annotations

from plotfeed.feeds.formats.asterix_015 import Asterix015
from plotfeed.feeds.formats.asterix_048 import Asterix048
from plotfeed.feeds.formats.asterix_205 import Asterix205
from plotfeed.feeds.formats.base import Format, FormatMaker
from plotfeed.feeds.formats.plot_batches import PlotBatches
from plotfeed.feeds.sapient_extra import reports as sapient_reports
from plotfeed.feeds.scene import Scene
from plotfeed.feeds.sensors import Sensor

MAKERS: dict[str, FormatMaker] = {
    "asterix-015": Asterix015,
    "asterix-048": Asterix048,
    "asterix-205": Asterix205,
    "plots": PlotBatches,
    "sapient": sapient_reports,
}


def formats_of(scene: Scene, sensor: Sensor) -> list[Format]:
    """The formats that the scene asks of a sensor, each once."""
    return [MAKERS[name](scene, sensor) for name in dict.fromkeys(sensor.report)]


__all__ = ["MAKERS", "Format", "formats_of"]

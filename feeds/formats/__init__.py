"""From plots to messages: one file for each format that a sensor can report in."""

from __future__ import annotations

from plotfeed.feeds.formats.asterix_015 import Asterix015
from plotfeed.feeds.formats.asterix_048 import Asterix048
from plotfeed.feeds.formats.asterix_062 import Asterix062
from plotfeed.feeds.formats.asterix_205 import Asterix205
from plotfeed.feeds.formats.message_format import FormatMaker, Reporter, TrackFormatMaker
from plotfeed.feeds.formats.plot_batches import PlotBatches
from plotfeed.feeds.formats.sapient.extra import reports as sapient_reports
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor

MAKERS: dict[str, FormatMaker] = {
    "asterix-015": Asterix015,
    "asterix-048": Asterix048,
    "asterix-205": Asterix205,
    "plots": PlotBatches,
    "sapient": sapient_reports,
}
TRACK_MAKERS: dict[str, TrackFormatMaker] = {"asterix-062": Asterix062}


def reporters_of(scene: Scene, sensor: Sensor) -> list[Reporter]:
    """The formats that the scene asks of a sensor, each once."""
    return [_reporter(name, scene, sensor) for name in dict.fromkeys(sensor.report)]


def _reporter(name: str, scene: Scene, sensor: Sensor) -> Reporter:
    """A format, told the truth only if it is one of tracks."""
    if name in TRACK_MAKERS:
        return TRACK_MAKERS[name](scene, sensor).messages
    plot_format = MAKERS[name](scene, sensor)
    return lambda seen: plot_format.messages(seen.sector, seen.plots)


__all__ = ["MAKERS", "TRACK_MAKERS", "reporters_of"]

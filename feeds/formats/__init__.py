"""Formats, from plots to messages and back, and `FORMATS`, their one table.

A new category of ASTERIX is its layout, its encoder and its format, all in one file, and a line:
`register(FORMAT, ActiveRadarKeys)`, after which scenes may ask for it. One that comes with plotfeed
is a file in `proto.asterix`, a row of `ASTERIX_FORMATS` there, how sensors speak it here, a row of
`FORMATS`, and its name among the `formats` of the sensors that report in it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from plotfeed.feeds.formats.asterix_015 import Asterix015
from plotfeed.feeds.formats.asterix_048 import Asterix048
from plotfeed.feeds.formats.asterix_062 import Asterix062
from plotfeed.feeds.formats.asterix_205 import Asterix205
from plotfeed.feeds.formats.message_format import (
    Announcer,
    Format,
    MessageFormat,
    SectorFormat,
)
from plotfeed.feeds.formats.plot_batches import PlotBatches
from plotfeed.feeds.formats.sapient import FORMAT as SAPIENT
from plotfeed.feeds.formats.sensor_tracks import SceneTracks
from plotfeed.feeds.formats.track_messages import TRACK_ROWS
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor, SensorKeys
from plotfeed.proto.asterix.categories import know
from plotfeed.proto.asterix.decode_plots import plots_in_asterix
from plotfeed.proto.plot_messages import plots_in_batch

FORMATS: dict[str, Format] = {
    row.name: row
    for row in (
        Format(facts=REPORT_FORMATS["plots"], maker=PlotBatches, plots_in=plots_in_batch),
        Format(facts=REPORT_FORMATS["asterix-015"], maker=Asterix015, plots_in=plots_in_asterix),
        Format(facts=REPORT_FORMATS["asterix-048"], maker=Asterix048, plots_in=plots_in_asterix),
        Format(facts=REPORT_FORMATS["asterix-205"], maker=Asterix205, plots_in=plots_in_asterix),
        Format(facts=REPORT_FORMATS["asterix-062"], maker=Asterix062, plots_in=None),
        SAPIENT,
        *TRACK_ROWS,
    )
}
"""By the name that scenes have for it; the first are those that say most of plots."""


def register(row: Format, *sensors: type[SensorKeys]) -> None:
    """Let scenes ask those sensors for another format, and everything read what it brings."""
    if row.name in FORMATS:
        raise ValueError(f"there is a format {row.name} already")
    FORMATS[row.name], REPORT_FORMATS[row.name] = row, row.facts
    know(row.facts)
    for keys in sensors:
        keys.formats += (row.name,)


def carries_plots(topic: str) -> bool:
    """Whether messages of a topic hold a sector's plots or tracks."""
    return any(topic.endswith(f"/{row.facts.topic}") for row in FORMATS.values())


def in_time(scene: Scene) -> Callable[[Message, int], Message | None]:
    """The rule for messages that leave late: as they may leave at a time, or None."""
    rules = {f"/{row.facts.topic}": row.late for row in FORMATS.values() if row.late is not None}

    def check(message: Message, t_utc_ns: int) -> Message | None:
        for end, late in rules.items():
            if message.topic.endswith(end):
                return late(scene, message, t_utc_ns)
        return message

    return check


class SceneFormats:
    """What makes the messages of a scene's sensors, in all formats that the scene asks of them."""

    def __init__(self, scene: Scene) -> None:
        """Raises `PlotfeedError` if an extra is missing."""
        asked = [tuple(dict.fromkeys(sensor.report)) for sensor in scene.sensor]
        self._reports = list(dict.fromkeys(asked))
        self._report = np.array([self._reports.index(names) for names in asked], np.int64)
        wanted = dict.fromkeys(name for names in self._reports for name in names)
        self._formats = {name: FORMATS[name].make(scene) for name in wanted}
        self._tracks = SceneTracks(scene)

    def messages(self, batch: Batch) -> list[list[Message]]:
        """Messages of each sector, due when it ends, in the order in which they are to leave."""
        batch = self._tracks.tracked(batch)
        if len(self._reports) == 1:
            return self._in_formats(0, batch)
        return batch.in_groups(self._report[batch.sectors.sensor], self._in_formats)

    def _in_formats(self, report: int, batch: Batch) -> list[list[Message]]:
        """Messages of sensors that report in the same formats."""
        made = [self._formats[name].messages(batch) for name in self._reports[report]]
        if len(made) == 1:
            return made[0]
        if not made:
            return [[] for _ in range(len(batch))]
        return [[m for messages in each for m in messages] for each in zip(*made, strict=True)]


def announcer_of(scene: Scene, sensor: Sensor) -> Announcer | None:
    """Whatever announces a sensor in a format that wants that; raises `PlotfeedError`."""
    makers = (FORMATS[name].announcer for name in sensor.report)
    return next((maker(scene, sensor) for maker in makers if maker is not None), None)


def inboxes_of(scene: Scene) -> dict[str, str]:
    """Topics on which sensors may be asked something in a format that they report in: whose."""
    return {
        f"{scene.mqtt.prefix}/{sensor.id}/{FORMATS[name].facts.inbox}": sensor.id
        for sensor in scene.sensor
        for name in sensor.report
        if FORMATS[name].facts.inbox
    }


__all__ = [
    "FORMATS",
    "Announcer",
    "Batch",
    "Format",
    "MessageFormat",
    "SceneFormats",
    "SectorFormat",
    "announcer_of",
    "carries_plots",
    "in_time",
    "inboxes_of",
    "register",
]

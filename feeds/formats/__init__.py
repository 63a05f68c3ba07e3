"""Formats, from plots to messages and back, and `FORMATS`, their one table.

A new category of ASTERIX is its layout, its encoder and its format, all in one file, and a line:
`register(FORMAT, ActiveRadarKeys)`, after which scenes may ask for it. One that comes with plotfeed
is a file in `proto.asterix`, a row of `ASTERIX_FORMATS` there, how sensors speak it here, a row of
`FORMATS`, and its name among the `formats` of the sensors that report in it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from plotfeed.feeds.formats.message_format import (
    Announcer,
    Format,
    MessageFormat,
    SectorFormat,
)
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.loaded_on_use import LoadedOnUse
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor, SensorKeys

if TYPE_CHECKING:
    from plotfeed.feeds.formats.sensor_tracks import SceneTracks

# By the name that scenes have for it; the first are those that say most of plots. Formats that no
# scene asks for are not loaded.
FORMATS: LoadedOnUse[Format] = LoadedOnUse(
    {
        name: f"plotfeed.feeds.formats.{home}"
        for name, home in (
            ("plots", "plot_batches:FORMAT"),
            ("asterix-015", "asterix_015:FORMAT"),
            ("asterix-048", "asterix_048:FORMAT"),
            ("asterix-205", "asterix_205:FORMAT"),
            ("asterix-062", "asterix_062:FORMAT"),
            ("sapient", "sapient:FORMAT"),
            *(
                (name, "track_messages:TRACK_ROWS")
                for name, facts in REPORT_FORMATS.items()
                if facts.tells_tracks and not facts.categories
            ),
        )
    }
)


def register(row: Format, *sensors: type[SensorKeys]) -> None:
    """Let scenes ask those sensors for another format, and everything read what it brings."""
    if row.name in FORMATS:
        raise ValueError(f"there is a format {row.name} already")
    FORMATS[row.name], REPORT_FORMATS[row.name] = row, row.facts
    from plotfeed.proto.asterix.categories import know

    know(row.facts)
    for keys in sensors:
        keys.formats += (row.name,)


def carries_plots(topic: str) -> bool:
    """Whether messages of a topic hold a sector's plots or tracks."""
    return any(topic.endswith(f"/{facts.topic}") for facts in REPORT_FORMATS.values())


def in_time(scene: Scene) -> Callable[[Message, int], Message | None]:
    """The rule for messages that leave late: as they may leave at a time, or None."""
    asked = {name: FORMATS[name] for sensor in scene.sensor for name in sensor.report}
    rules = {f"/{row.facts.topic}": row.late for row in asked.values() if row.late is not None}

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
        self._tracks: SceneTracks | None = None
        if any(REPORT_FORMATS[name].tells_tracks for name in wanted):
            from plotfeed.feeds.formats.sensor_tracks import SceneTracks

            self._tracks = SceneTracks(scene)

    def messages(self, batch: Batch) -> list[list[Message]]:
        """Messages of each sector, due when it ends, in the order in which they are to leave."""
        if self._tracks is not None:
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

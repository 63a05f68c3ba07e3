"""The keys of sensors as a recording tells of them: whoever was told of a change can look it up."""

from __future__ import annotations

import json
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from operator import itemgetter
from typing import Self

from plotfeed.feeds.changes import sensor_in
from plotfeed.feeds.scene import Scene
from plotfeed.feeds.sensors import Sensor
from plotfeed.replay.log_reader import LogReader
from plotfeed.replay.recorded import Recorded, Stage

MAX_CHANGES = 10_000
"""Of each sensor; later ones are not known."""


class RecordedSettings:
    """Sensors by time. Until a recording tells of one, it is as in the scene."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._changes: dict[str, list[tuple[int, Sensor]]] = {s.id: [] for s in scene.sensor}

    @classmethod
    def read(cls, scene: Scene, log: LogReader) -> Self:
        """From all of a recording."""
        found = cls(scene)
        topics = {f"{scene.mqtt.prefix}/{sensor.id}/settings" for sensor in scene.sensor}
        for message in log.messages(topics=topics, stages=(Stage.AFTER, Stage.RECEIVED)):
            found._take(message)
        return found

    def at(self, t_utc_ns: int) -> Mapping[str, Sensor]:
        """All of them, by id, as they were then."""
        return {sensor.id: self._at(sensor, t_utc_ns) for sensor in self._scene.sensor}

    def changed_between(self, after_utc_ns: int, until_utc_ns: int) -> Iterator[str]:
        """The ids of sensors that were told of later than that, and until then."""
        for sensor, changes in self._changes.items():
            first, end = (
                bisect_right(changes, t, key=itemgetter(0)) for t in (after_utc_ns, until_utc_ns)
            )
            if first < end:
                yield sensor

    def _at(self, sensor: Sensor, t_utc_ns: int) -> Sensor:
        changes = self._changes[sensor.id]
        number = bisect_right(changes, t_utc_ns, key=itemgetter(0))
        return changes[number - 1][1] if number else sensor

    def _take(self, message: Recorded) -> None:
        """What is no change of such a sensor is none."""
        try:
            sensor = sensor_in(json.dumps(json.loads(message.payload)["in_force"]))
        except (ValueError, KeyError, TypeError, RecursionError):  # pydantic's are ValueErrors
            return
        changes = self._changes.get(sensor.id)
        own = next((s for s in self._scene.sensor if s.id == sensor.id), None)
        if changes is not None and type(sensor) is type(own) and len(changes) < MAX_CHANGES:
            changes.append((message.log_time_ns, sensor))

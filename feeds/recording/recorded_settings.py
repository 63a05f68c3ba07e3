"""Sensors of a recorded session by time, as its settings messages tell of them."""

from __future__ import annotations

import json
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from operator import itemgetter
from typing import Any, Self

from plotfeed.feeds.scene.changes import changed, in_force, instants_ns
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor, sensor_of
from plotfeed.proto.errors import PlotfeedError
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import WHAT_LEFT

MAX_CHANGES = 10_000  # Of each sensor that are known; of later ones nothing is told


class RecordedSettings:
    """Sensors by time, as settings messages tell of them; before the first, as in the scene."""

    def __init__(self, scene: Scene) -> None:
        self._sensors = {sensor.id: sensor for sensor in scene.sensor}
        self._told: dict[str, list[tuple[int, Sensor]]] = {name: [] for name in self._sensors}
        self._controlled: dict[str, list[tuple[int, Mapping[str, Any]]]] = {
            name: [] for name in self._sensors
        }
        self._instants_ns = {s.id: instants_ns(s.event) for s in scene.sensor}
        self._worked_out: dict[tuple[str, int, int], Sensor | None] = {}

    @classmethod
    def read(cls, scene: Scene, log: McapReader) -> Self:
        """Read all that a recording tells."""
        found = cls(scene)
        topics = {f"{scene.mqtt.prefix}/{name}/settings": name for name in found._sensors}
        for message in log.messages(topics=set(topics), stages=WHAT_LEFT):
            found.take(topics[message.topic], message.payload, message.log_time_ns)
        return found

    def take(self, sensor: str, payload: bytes, t_utc_ns: int) -> None:
        """Note what a message tells of a sensor from that time on; what tells nothing is none."""
        try:
            told = json.loads(payload)
            controlled = told.get("controlled")
        except (ValueError, AttributeError, RecursionError):
            return
        if isinstance(controlled, dict) and len(self._controlled[sensor]) <= MAX_CHANGES:
            self._controlled[sensor].append((t_utc_ns, controlled))
        try:
            now = sensor_of(told["in_force"])
        except (ValueError, KeyError, TypeError, RecursionError):  # pydantic's are ValueErrors
            return
        is_it = now.id == sensor and type(now) is type(self._sensors[sensor])
        if is_it and len(self._told[sensor]) < MAX_CHANGES:
            self._told[sensor].append((t_utc_ns, now))

    def told_at(self, t_utc_ns: int) -> dict[str, Sensor]:
        """Sensors by id, as the last messages until then had them."""
        found = dict(self._sensors)
        for name, told in self._told.items():
            number = _until(told, t_utc_ns)
            if number:
                found[name] = told[number - 1][1]
        return found

    def told_between(self, after_utc_ns: int, until_utc_ns: int) -> Iterator[str]:
        """The ids of sensors of which a message told later than that, and until then."""
        for sensor, told in self._told.items():
            if _until(told, after_utc_ns) < _until(told, until_utc_ns):
                yield sensor

    def worked_out(self, sensor: str, t_utc_ns: int, start_utc_ns: int) -> Sensor | None:
        """A sensor as the script of its scene and control had it then; None if that is not known.

        The session began at `start_utc_ns`. It is the same object for as long as nothing changes.
        """
        elapsed_ns = max(t_utc_ns - start_utc_ns, 0)
        commands = _until(self._controlled[sensor], t_utc_ns)
        state = (sensor, bisect_right(self._instants_ns[sensor], elapsed_ns), commands)
        if state not in self._worked_out:
            own, self._worked_out[state] = self._sensors[sensor], None
            controlled = self._controlled[sensor][commands - 1][1] if commands else {}
            if commands <= MAX_CHANGES:
                with suppress(PlotfeedError):
                    found = changed(own, *in_force(own.event, elapsed_ns), controlled)
                    self._worked_out[state] = found
        return self._worked_out[state]


def _until(by_time: Sequence[tuple[int, Any]], t_utc_ns: int) -> int:
    """Count what there was until then."""
    return bisect_right(by_time, t_utc_ns, key=itemgetter(0))

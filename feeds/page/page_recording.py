"""Recordings as a page can show them: those of its folder."""

from __future__ import annotations

import json
import os
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from itertools import count
from operator import itemgetter
from pathlib import Path
from typing import Self

from plotfeed.feeds.recording.recorder import SCENE_NAME
from plotfeed.feeds.replaying.replay_settings import Selection
from plotfeed.feeds.scene.scene import Scene, parsed
from plotfeed.feeds.scene.sensors import Sensor, sensor_of
from plotfeed.feeds.telemetry.position_report import LATEST_UTC_NS
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.replay.mcap.channels import ChannelKey
from plotfeed.replay.mcap.contents import library_of
from plotfeed.replay.mcap.mcap_reader import McapReader, McapSummary
from plotfeed.replay.recorded import Recorded, Stage

MAX_CHANGES = 10_000
"""Of each sensor; later ones are not known."""


class RecordedSettings:
    """Sensors by time. Until a recording tells of one, it is as in the scene."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._changes: dict[str, list[tuple[int, Sensor]]] = {s.id: [] for s in scene.sensor}

    @classmethod
    def read(cls, scene: Scene, log: McapReader) -> Self:
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
            sensor = sensor_of(json.loads(message.payload)["in_force"])
        except (ValueError, KeyError, TypeError, RecursionError):  # pydantic's are ValueErrors
            return
        changes = self._changes.get(sensor.id)
        own = next((s for s in self._scene.sensor if s.id == sensor.id), None)
        if changes is not None and type(sensor) is type(own) and len(changes) < MAX_CHANGES:
            changes.append((message.log_time_ns, sensor))


SUFFIX = ".mcap"
LIBRARY = "plotfeed "
"""What those of plotfeed say that they were written by, before its version."""
MAX_LISTED = 50
MAX_LOOKED_AT = 500
"""Files, the newest first, of which it is found out whose they are."""


def recordings_in(folder: Path) -> dict[str, Path]:
    """Files by name, the newest first, at most `MAX_LISTED`; none if the folder cannot be read."""
    found: dict[str, Path] = {}
    for path in _newest_first(folder)[:MAX_LOOKED_AT]:
        if len(found) < MAX_LISTED and _is_ours(path):
            found[path.name] = path
    return found


def new_path(folder: Path, scene: str, at: datetime) -> Path:
    """The name of a recording of that scene from then on, in UTC; numbered if there is one."""
    stem = f"{scene}-{at:%Y%m%dT%H%M%SZ}"
    names = (f"{stem}-{number}" if number > 1 else stem for number in count(1))
    return next(path for name in names if not (path := folder / f"{name}{SUFFIX}").exists())


def _newest_first(folder: Path) -> list[Path]:
    times: dict[Path, int] = {}
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name.endswith(SUFFIX) and entry.name.isprintable() and entry.is_file():
                    times[Path(entry.path)] = entry.stat().st_mtime_ns
    except OSError:
        pass
    return sorted(times, key=lambda path: (-times[path], path.name))


def _is_ours(path: Path) -> bool:
    try:
        return library_of(path).startswith(LIBRARY)
    except (DecodeError, OSError):
        return False


CARRIERS = ("plots", "asterix/048", "asterix/015", "asterix/205")
"""The ends of topics whose messages bring plots that can be read; the first of them counts."""
LEFT = (Stage.AFTER, Stage.RECEIVED)


@dataclass(frozen=True, slots=True, kw_only=True)
class PageRecording:
    """Where it is, what it is of, and what of it is shown."""

    path: Path
    scene: Scene
    start_ns: int
    """Log time of its first message."""
    end_ns: int
    ledger: str | None
    """The topic of the ledger; None if it holds none."""
    carriers: Mapping[str, str]
    """Sensors, by the topics from which their plots are taken."""
    carried: tuple[Stage, ...]
    """The stages at which they are."""
    settings: RecordedSettings
    notes: tuple[str, ...]
    """Sentences on what of it is not shown."""

    @classmethod
    def open(cls, path: Path) -> Self:
        """Read it to its end; raises `PlotfeedError` in one line if it cannot be shown."""
        try:
            with McapReader(path) as log:
                return cls._of(path, log)
        except OSError as error:
            raise PlotfeedError(f"{path.name}: {error.strerror or error}") from None
        except PlotfeedError as error:
            line = str(error).partition("\n")[0].removeprefix(f"{path}: ")
            raise PlotfeedError(f"{path.name}: {line}") from None

    @classmethod
    def _of(cls, path: Path, log: McapReader) -> Self:
        summary = log.summary()
        scene = _scene(path, log)
        series = summary.counts.keys()
        if summary.start_ns is None or summary.end_ns is None or not any(map(_is_sent, series)):
            raise PlotfeedError("expected messages that sensors sent; it holds none")
        if summary.end_ns > LATEST_UTC_NS:
            raise PlotfeedError("expected times before the year 2262")
        ledger = f"{scene.mqtt.prefix}/truth"
        has_ledger = any(s.topic == ledger and s.stage in LEFT for s in series)
        carried = (Stage.BEFORE,) if has_ledger and _has_before(summary) else LEFT
        carriers = _carriers(scene, (s.topic for s in series if s.stage in carried))
        if not has_ledger and not carriers:
            raise PlotfeedError(
                f"no plots to show: expected the ledger, {scene.mqtt.prefix}/SENSOR/plots, "
                "or ASTERIX 048, 015 or 205"
            )
        settings = RecordedSettings.read(scene, log)  # to the end, so that damage is known
        return cls(
            path=path,
            scene=scene,
            start_ns=summary.start_ns,
            end_ns=summary.end_ns,
            ledger=ledger if has_ledger else None,
            carriers=carriers,
            carried=carried,
            settings=settings,
            notes=tuple(_notes(scene, carriers, len(log.damage), has_ledger=has_ledger)),
        )


def _scene(path: Path, log: McapReader) -> Scene:
    attachment = log.attachment(SCENE_NAME)
    if attachment is None:
        raise PlotfeedError("it holds no scene, which says where sensors stand: plotfeed replay")
    return parsed(attachment.data, path)


def _is_sent(series: ChannelKey) -> bool:
    return Selection().takes(series.topic, series.content_type, series.stage)


def _has_before(summary: McapSummary) -> bool:
    return any(series.stage is Stage.BEFORE for series in summary.counts)


def _carriers(scene: Scene, topics: Iterable[str]) -> dict[str, str]:
    there, found = set(topics), {}
    for sensor in scene.sensor:
        of_sensor = (f"{scene.mqtt.prefix}/{sensor.id}/{end}" for end in CARRIERS)
        topic = next((topic for topic in of_sensor if topic in there), None)
        if topic is not None:
            found[topic] = sensor.id
    return found


def _notes(
    scene: Scene, carriers: Mapping[str, str], damaged: int, *, has_ledger: bool
) -> Iterable[str]:
    if damaged:
        yield f"Damaged places that are left out: {damaged}."
    if not has_ledger:
        yield "It holds no ledger: no truth, and nothing of what was lost, is known of it."
    silent = [sensor.id for sensor in scene.sensor if sensor.id not in carriers.values()]
    if silent:
        yield f"It holds no plots of {', '.join(silent)} that can be read."

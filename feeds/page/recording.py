"""A recording as a page can show it: looked through once, before anything is ended for it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from plotfeed.feeds.page.recorded_settings import RecordedSettings
from plotfeed.feeds.recorder import SCENE_NAME
from plotfeed.feeds.replay_settings import Selection
from plotfeed.feeds.report import LATEST_UTC_NS
from plotfeed.feeds.scene import Scene, parsed
from plotfeed.proto.errors import PlotfeedError
from plotfeed.replay.log_channels import Series
from plotfeed.replay.log_reader import LogReader, LogSummary
from plotfeed.replay.recorded import Stage

CARRIERS = ("plots", "asterix/048", "asterix/015", "asterix/205")
"""The ends of topics whose messages bring plots that can be read; the first of them counts."""
LEFT = (Stage.AFTER, Stage.RECEIVED)


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
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
            with LogReader(path) as log:
                return cls._of(path, log)
        except OSError as error:
            raise PlotfeedError(f"{path.name}: {error.strerror or error}") from None
        except PlotfeedError as error:
            line = str(error).partition("\n")[0].removeprefix(f"{path}: ")
            raise PlotfeedError(f"{path.name}: {line}") from None

    @classmethod
    def _of(cls, path: Path, log: LogReader) -> Self:
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


def _scene(path: Path, log: LogReader) -> Scene:
    attachment = log.attachment(SCENE_NAME)
    if attachment is None:
        raise PlotfeedError("it holds no scene, which says where sensors stand: plotfeed replay")
    return parsed(attachment.data, path)


def _is_sent(series: Series) -> bool:
    return Selection().takes(series.topic, series.content_type, series.stage)


def _has_before(summary: LogSummary) -> bool:
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

"""The record of a session, to be run again: its scene, and what came in, at the same times."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from plotfeed.feeds.recording.recorder import SCENE_NAME, files_of
from plotfeed.feeds.scene.scene import Scene, parsed
from plotfeed.feeds.session.observer import Observer, RunningSession
from plotfeed.proto.errors import PlotfeedError
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.recorded import Recorded, Stage

SESSION_TOPIC = "/session"
CONTROL_TOPIC = "/control"
MAX_SUFFIX = 16  # Characters: by it the format of a flight is known


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionRecord:
    """A session's record, to be run again."""

    path: Path
    start_utc_ns: int
    end_utc_ns: int
    # Whether its session went by ticks, as sessions do now: only then telemetry counts in the same
    # sectors again.
    has_ticks: bool = True

    @classmethod
    def open(cls, path: Path) -> SessionRecord:
        """Raises `PlotfeedError` if it is not the record of a session."""
        with McapReader(path) as mcap:
            summary = mcap.summary()
            for message in mcap.messages():
                if message.topic.endswith(SESSION_TOPIC) and message.stage is Stage.AFTER:
                    break
            else:
                raise PlotfeedError(
                    f"{path}: expected the record of a session, made by run --record"
                )
        try:
            told = json.loads(message.payload)
            start_utc_ns, has_ticks = int(told["start_utc_ns"]), "tick_ms" in told
        except (ValueError, KeyError, TypeError):
            raise PlotfeedError(f"{path}: its session does not say when it began") from None
        return cls(
            path=path,
            start_utc_ns=start_utc_ns,
            end_utc_ns=summary.end_ns or start_utc_ns,
            has_ticks=has_ticks,
        )

    def scene(self, folder: Path) -> Scene:
        """The scene that ran, with its files unpacked into a folder; raises `PlotfeedError`.

        Whoever wrote the recording says neither where files are nor where anything is sent.
        """
        files: dict[str, Path] = {}
        with McapReader(self.path) as mcap:
            if mcap.attachment(SCENE_NAME) is None:
                raise PlotfeedError(f"{self.path}: holds no scene; give the scene and --telemetry")
            scene = recorded_scene(self.path, mcap)
            for number, name in enumerate(files_of(scene)):
                found = mcap.attachment(name)
                if found is not None:
                    files[name] = folder / f"{number}{Path(name).suffix[:MAX_SUFFIX]}"
                    files[name].write_bytes(found.data)
        return scene.enclosed(files)


def recorded_scene(path: Path, log: McapReader) -> Scene:
    """The scene that a recording has with it, which reads no file; raises `PlotfeedError`."""
    attachment = log.attachment(SCENE_NAME)
    if attachment is None:
        raise PlotfeedError("it holds no scene, which says where sensors stand: plotfeed replay")
    return parsed(attachment.data, path).enclosed({})


class RecordedTelemetry(Observer):
    """What came in to a session, taken in by another at the same times of its clock."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def begun(self, session: RunningSession) -> None:
        """Read from the beginning."""
        self._session = session
        self._mcap = McapReader(self._path)
        self._tracker = session.scene.page.tracks_topic
        self._messages = self._mcap.messages(stages=[Stage.TELEMETRY])
        self._next: Recorded | None = None
        self._turn()

    def next_input_ns(self) -> int | None:
        """Time as of which the next message had been taken in."""
        return None if self._next is None else self._next.log_time_ns

    def before_due(self, due_utc_ns: int) -> None:
        """All that had been taken in before then, together what was, no commands to the clock."""
        while self._next is not None and self._next.log_time_ns < due_utc_ns:
            t_utc_ns, together = self._next.log_time_ns, []
            while self._next is not None and self._next.log_time_ns == t_utc_ns:
                message = self._next
                self._turn()
                if message.topic != self._tracker and not _is_of_clock(message):
                    together.append((message.topic, message.payload, message.content_type or None))
            self._session.receive(together, t_utc_ns)

    def ended(self) -> None:
        """The file is needed no more."""
        self._mcap.close()

    def _turn(self) -> None:
        self._next = next(self._messages, None)


def _is_of_clock(message: Recorded) -> bool:
    """Whether it would hold or hurry the clock: the record has all of its time already."""
    if not message.topic.endswith(CONTROL_TOPIC):
        return False
    try:
        command = json.loads(message.payload)
    except ValueError:
        return False
    return isinstance(command, dict) and "clock" in command

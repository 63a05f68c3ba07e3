"""Recorders: a file that takes messages without delaying anyone, and a session's record, run again.

Messages are put together where they come in, which takes microseconds. Compressing a chunk and
writing it, which takes a millisecond and on a slow disk any time, is done by a thread in between.
A session's record, with its ledger and its scene, can be run again: what came in, when it did.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from io import BufferedWriter
from pathlib import Path
from typing import Self

from plotfeed.feeds.console.process import new_file
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene, parsed
from plotfeed.feeds.scene.world_keys import HORIZONS
from plotfeed.feeds.session.observer import Observer, RunningSession
from plotfeed.proto.content_types import ASTERIX
from plotfeed.proto.errors import PlotfeedError
from plotfeed.replay.mcap import McapReader, McapWriter
from plotfeed.replay.recorded import SCENE_NAME, Attachment, Recorded, Stage

FLUSH_EVERY_S = 0.25
# Of 256 KiB, for a disk that stands still; then messages are dropped, and counted.
MAX_WAITING_CHUNKS = 64


class Recorder:
    """A file that takes messages until it is closed. A full disk ends it, not the session."""

    def __init__(
        self,
        path: Path,
        *,
        attachments: Iterable[Attachment] = (),
        force: bool = False,
        waits: bool = False,
    ) -> None:
        """`force` replaces a file; `waits` says to wait for a slow disk rather than to drop.

        Its owner alone may read it: what was recorded may have been behind a password.

        Raises `PlotfeedError`, and `OSError` if the file cannot be written.
        """
        self.path = path
        self.failure = ""  # Why the file is not whole; empty while it is
        self.messages = 0
        self.octets = 0  # Of payloads
        self.dropped = 0  # Messages that came while the disk stood still
        self.refused = 0  # Messages that such a file cannot hold
        self._waits = waits
        self._closed = False
        self._given = self._done = 0
        self._room = threading.Semaphore(MAX_WAITING_CHUNKS)
        self._file = new_file(path, force=force, is_private=True)
        self._thread = ThreadPoolExecutor(1, "record")
        try:
            self._mcap = McapWriter(
                self._file,
                attachments=attachments,
                library=f"plotfeed {version('plotfeed')}",
                run=self._later,
            )
        except BaseException:
            self._release()
            raise

    def write(self, recorded: Recorded) -> None:
        """Take a message, or drop it; nothing once the file has failed or is closed."""
        if self.failure or self._closed:
            return
        if not self._waits and self._given - self._done >= MAX_WAITING_CHUNKS:
            self.dropped += 1
            return
        if self._mcap.write(recorded) is not None:
            self.refused += 1
            return
        self.messages += 1
        self.octets += len(recorded.payload)

    async def run(self) -> None:
        """See to it that what is recorded is soon in the file; returns when no more is."""
        while not self._closed and not self.failure:
            await asyncio.sleep(FLUSH_EVERY_S)
            if not self._closed and self._given - self._done < MAX_WAITING_CHUNKS:
                self._mcap.flush()

    def close(self) -> None:
        """End the file with its index, and wait until it is written."""
        if not self._closed:
            self._closed = True
            self._end()

    async def stop(self) -> None:
        """Close the file while others work."""
        if not self._closed:
            self._closed = True
            await asyncio.to_thread(self._end)

    def losses(self) -> Iterator[str]:
        """Lines on what is missing in the file."""
        for many, why in (
            (self.dropped, "messages were dropped: the disk is slower"),
            (self.refused, "messages were not recorded: no such file can hold them"),
        ):
            if many:
                yield f"{self.path}: {many} {why}"
        if self.failure:
            yield self.failure

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _later(self, work: Callable[[], None]) -> None:
        """Hand a chunk to the thread; waits for room only where nothing may be dropped."""
        self._room.acquire()
        self._given += 1
        self._thread.submit(self._do, work)

    def _do(self, work: Callable[[], None]) -> None:
        """Compress and write a chunk, in the thread."""
        try:
            work()
        except Exception as error:  # noqa: BLE001 - whatever it is, it ends the recording alone
            what = getattr(error, "strerror", None) or error
            self.failure = f"{self.path}: {what}; what came after is not in the file"
        finally:
            self._done += 1
            self._room.release()

    def _end(self) -> None:
        self._mcap.close()
        self._release()

    def _release(self) -> None:
        self._thread.shutdown(wait=True)
        with contextlib.suppress(OSError):
            self._file.close()


class SessionRecorder(Observer):
    """Records a session from within."""

    def __init__(self, recorder: Recorder, *, ledger_is_sent: bool) -> None:
        """`ledger_is_sent` says that the ledger is among the messages that leave."""
        self.recorder = recorder
        self._ledger_is_sent = ledger_is_sent
        self._session: RunningSession | None = None
        self._flushing: asyncio.Task[None] | None = None

    def begun(self, session: RunningSession) -> None:
        """Keep the file up to date from now on."""
        self._session = session
        self._flushing = asyncio.create_task(self.recorder.run(), name="record")

    def received(self, topic: str, payload: bytes, content_type: str | None, t_utc_ns: int) -> None:
        """Telemetry and commands, as of the time that counts."""
        self.recorder.write(
            Recorded(topic, payload, t_utc_ns, t_utc_ns, content_type or "", stage=Stage.TELEMETRY)
        )

    def tracked(self, topic: str, payload: bytes, content_type: str | None, t_utc_ns: int) -> None:
        """Tracks of a foreign tracker; those of a sensor are recorded as they leave."""
        if self._session is None:
            return
        scene = self._session.scene
        if not topic.startswith(tuple(f"{scene.mqtt.prefix}/{s.id}/" for s in scene.sensor)):
            self.received(topic, payload, content_type, t_utc_ns)

    def before_link(self, message: Message) -> None:
        """A message is handed to the link when it is due there."""
        self._write(message, message.due_utc_ns, Stage.BEFORE)

    def after_link(self, message: Message, sent_utc_ns: int) -> None:
        """A message has left."""
        self._write(message, sent_utc_ns, Stage.AFTER)

    def ledger(self, message: Message) -> None:
        """The ledger, as if it were published where it is not."""
        if not self._ledger_is_sent and self._session is not None:
            self._write(message, self._session.clock.now_ns(), Stage.AFTER)

    def ended(self) -> None:
        """There is no more."""
        if self._flushing is not None:
            self._flushing.cancel()

    def _write(self, message: Message, at_utc_ns: int, stage: Stage) -> None:
        self.recorder.write(
            Recorded(  # in their order, which takes half as long as by their names
                message.topic,
                message.payload,
                at_utc_ns,
                message.due_utc_ns,
                message.content_type,
                tuple(message.properties),
                message.retain,
                message.qos,
                stage,
            )
        )


class RawFile(Observer):
    """Writes the ASTERIX among the messages, raw. A full disk ends the file, not the session."""

    def __init__(self, path: Path, *, force: bool = False) -> None:
        """`force` replaces a file; raises `PlotfeedError` and `OSError`."""
        self.path = path
        self.failure = ""  # Why the file is not whole; empty while it is
        self._file = BufferedWriter(new_file(path, force=force))

    def after_link(self, message: Message, _sent_utc_ns: int) -> None:
        """Take what is ASTERIX."""
        if not self.failure and message.content_type.startswith(ASTERIX):
            try:
                self._file.write(message.payload)
            except OSError as error:
                self._failed(error)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._file.close()
        except OSError as error:
            self._failed(error)

    def _failed(self, error: OSError) -> None:
        if not self.failure:
            self.failure = f"{self.path}: {error.strerror}; what came after is not in the file"
        with contextlib.suppress(OSError):
            self._file.close()


def attachments_of(scene: Scene, now_utc_ns: int) -> Iterator[Attachment]:
    """The scene's text, and the files that it reads, by the names that it knows them by."""
    attached = partial(Attachment, log_time_ns=now_utc_ns)
    if scene.text:
        data = scene.text.encode()
        yield attached(name=SCENE_NAME, media_type="application/toml", data=data)
    for name in files_of(scene):
        from plotfeed.feeds.engine.terrain_files import horizons_of

        data = horizons_of(scene) if name == HORIZONS else scene.file(name).read_bytes()
        yield attached(name=name, media_type="application/octet-stream", data=data)


def files_of(scene: Scene) -> Iterable[str]:
    """The names of a scene's flights, map, geoid and horizons: what its record has with it."""
    names = [drone.flight.file for drone in scene.fleet.kinds if drone.flight is not None]
    basemap = scene.page.basemap
    if basemap is not None:
        names.append(basemap if isinstance(basemap, str) else basemap.image)
    if scene.telemetry.geoid_grid is not None:
        names.append(scene.telemetry.geoid_grid)
    if scene.terrain is not None:
        names.append(HORIZONS)
    return dict.fromkeys(names)


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
            times_ns = mcap.times_ns
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
            end_utc_ns=times_ns[1] if times_ns else start_utc_ns,
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
            self._session.intake.receive(together, t_utc_ns)

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

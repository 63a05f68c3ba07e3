"""Sessions and replays one after the other: what viewers ask of them, and what the page is told.

A session is restarted, one of another scene begins, one is recorded, a recording is replayed.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plotfeed.feeds.engine.change_control import told
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.page.scene_outline import Basemap, pointing_of
from plotfeed.feeds.page.view import MAX_REASON, View
from plotfeed.feeds.scene.changes import Command
from plotfeed.feeds.scene.examples import summaries
from plotfeed.feeds.scene.scene import Scene, example, load
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.observer import Observer, RunningSession
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.replay.recorded import SUFFIX

if TYPE_CHECKING:
    from plotfeed.feeds.page.page_replay import PageReplay
    from plotfeed.feeds.page.recorded_sectors import RecordedSession
    from plotfeed.feeds.recording.recorder import SessionRecorder

# Recordings and replays are loaded once there is one.

MAX_MARKS = 100  # The newest are kept
TRUTH_EVERY_S = 0.1
CLOCK_CONTROLS = ("pause", "step", "speed")
REAL_TIME = "Pause, step and speed need a simulated clock: real time cannot be held or hurried."
NO_PACE = "A run as fast as possible has no pace to control."


def _recorded(method: str) -> Callable[..., None]:
    """A method of an observer that hands on what it is told to a recording, if one runs."""

    def tell(self: PageSessions, *told: Any) -> None:
        if self._recorder is not None:
            getattr(self._recorder, method)(*told)

    return tell


class PageSessions(Observer):
    """Follows one session after the other, tells what changes when, and does as viewers ask."""

    def __init__(self, scene: Scene, view: View, folder: Path) -> None:
        """Recordings are those in `folder`; scenes to choose from are those beside this one."""
        self.scene = scene  # Of the session that runs, or ran before the replay that does
        self.basemap: Basemap | None = None  # Of the next session
        self.replaying: PageReplay | None = None  # The replay that runs in place of a session
        self.ending = asyncio.Event()  # Set when the session that runs shall end
        self.goes_on = True  # Whether another one follows then
        self._view = view
        self._folder = folder
        self._scenes = _scenes_beside(scene)
        self._asked: RecordedSession | None = None
        self._notes: list[str] = []
        self._session: RunningSession | None = None
        self._recorder: SessionRecorder | None = None
        self._record_since_s = 0.0
        self._refusal = ""
        self._now_ns = 0
        self._marks: deque[dict[str, Any]] = deque(maxlen=MAX_MARKS)
        # Sensors that are otherwise, and since when, of which no command has told yet.
        self._unexplained: dict[str, int] = {}
        self._would_undo = ""

    def begin(self) -> RecordedSession | None:
        """A session, or that replay, is about to run: the last one, unless another is wanted."""
        self.ending.clear()
        self.goes_on = False
        asked, self._asked = self._asked, None
        return asked

    async def replay(
        self,
        recording: RecordedSession,
        addresses: Sequence[BrokerAddress],
        basemap: Basemap | None,
    ) -> None:
        """Replay it until something else is wanted; if it fails, a session is."""
        from plotfeed.feeds.page.page_replay import PageReplay

        self.replaying = PageReplay(recording, self._view)
        self._tell_choice()
        try:
            await self.replaying.run(addresses, basemap, self.ending)
        except (PlotfeedError, OSError) as error:
            self._notes = [f"The replay has ended: {one_line(error)}"]
            self.goes_on = True
        finally:
            self.replaying = None

    # What the session tells.

    def begun(self, session: RunningSession) -> None:
        """The session stands, and its time begins."""
        self._session = session
        self._refusal = ""
        self._view.scene(session.scene, self.basemap)
        self._view.unseen(session.totals.unseen)
        for task in session.sensors.values():
            self._view.settings(task.sensor, self.now_utc_ns())
        self._marks.clear()
        self._unexplained.clear()
        self._tell_stories(session)
        self._tell_clock()
        self._tell_choice()
        self._view.session({"replay": {}, "record": {"on": False}, "notes": self._notes})

    def ended(self) -> None:
        """The session is over, and with it its recording; the page shows what there was."""
        self._now_ns = self.now_utc_ns()
        self._session = None
        if self._recorder is not None:
            self._recorder.ended()
            self._recorder.recorder.close()
            self._recorder = None

    received, before_link, after_link, ledger = map(
        _recorded, ("received", "before_link", "after_link", "ledger")
    )

    def settled(self, batch: Batch, sent: Sequence[pb.Sent]) -> None:
        """A sector's messages have their fates."""
        self._view.settled(batch, sent)

    def settings(self, sensor: Sensor) -> None:
        """The sensor is so from now on."""
        self._unexplained[sensor.id] = self.now_utc_ns()
        self._view.settings(sensor, self.now_utc_ns())

    def obeyed(self, command: Command, t_utc_ns: int) -> None:
        """What a command asked for is in force."""
        if self._session is not None and command.clock is None:
            kind = "change" if command.story is None else "story"
            self._mark(kind, self._words(self._session, command), t_utc_ns)
            self._unexplained.clear()
            self._tell_stories(self._session)

    # What the page asks.

    def now_utc_ns(self) -> int:
        """The time that is shown: of the session or replay, or the last one when none runs."""
        if self.replaying is not None:
            return self.replaying.now_utc_ns
        return self._now_ns if self._session is None else self._session.clock.now_ns()

    async def apply(self, command: dict[str, Any]) -> Mapping[str, Any]:
        """Do as a viewer asks."""
        if "session" in command:
            return self._another(command["session"])
        if "replay" in command:
            return await self._replay(command["replay"])
        if self.replaying is not None:
            return self._in_replay(self.replaying, command)
        if self._session is None:
            raise PlotfeedError("no session runs")
        if "record" in command:
            return await self._record(command["record"], self._session)
        in_force = self._session.command(command)
        self._tell_clock()
        return in_force

    async def follow(self) -> None:
        """Tell the view what changes without anybody saying so, until cancelled."""
        while True:
            await asyncio.sleep(TRUTH_EVERY_S)
            if self._session is not None:
                self._look_at(self._session)

    def _look_at(self, session: RunningSession) -> None:
        now_ns = session.clock.now_ns()
        trajectories = session.trajectories
        state, classes = trajectories.state_at(now_ns), trajectories.signatures.target_class
        self._view.truth(now_ns, state, trajectories.names, classes)
        self._view.totals(session.totals)
        for sensor, at_utc_ns in self._unexplained.items():  # or by a task of SAPIENT
            self._mark("script", f"{sensor}: by its script", at_utc_ns)
        if self._unexplained:
            self._unexplained.clear()
            self._tell_stories(session)
        self._view.pointing(
            {
                name: pointing_of(task.sensor, pointed)
                for name, task in session.sensors.items()
                if (pointed := task.pointed) is not None
            }
        )
        if session.totals.last_refusal != self._refusal:
            self._refusal = session.totals.last_refusal
            self._view.tell(refusal=self._refusal[:MAX_REASON])
        if self._recorder is not None:
            file = self._recorder.recorder.path.name
            seconds = round(time.monotonic() - self._record_since_s)
            self._view.session({"record": {"on": True, "file": file, "seconds": seconds}})
        self._tell_clock()

    def _tell_clock(self) -> None:
        """The clock's state, which control may have changed from elsewhere, for what is news."""
        if self._session is None:
            return
        clock, state = self._session.clock, {"kind": "instant", "paused": False, "speed": 1.0}
        refusals = dict.fromkeys(CLOCK_CONTROLS, NO_PACE)
        if isinstance(clock, WallClock):
            kind = "wall" if clock.is_real else "simulated"
            state = {"kind": kind, "paused": clock.is_paused, "speed": clock.speed}
            refusals = dict.fromkeys(CLOCK_CONTROLS, REAL_TIME) if clock.is_real else {}
        self._view.session({"clock": state, "refuses": refusals})

    def _mark(self, kind: str, words: str, at_utc_ns: int) -> None:
        self._marks.append({"t_utc_ms": at_utc_ns / 1e6, "kind": kind, "words": words})
        self._view.tell(marks=list(self._marks))

    def _words(self, session: RunningSession, command: Command) -> str:
        if command.undo:
            return f"Undone: {self._would_undo}"
        if command.story is not None:
            titles = {story.id: story.title for story, _ in session.changes.stories}
            words = titles.get(command.story) or command.story
            return f"{words}, taken back" if command.reset else words
        if command.drone is not None:
            happens = command.contingency.kind if command.contingency else "claim"
            return f"{command.drone}: {'as in the scene' if command.reset else happens}"
        return f"{command.sensor}: {told(command.set) if command.set else 'as in the scene'}"

    def _tell_stories(self, session: RunningSession) -> None:
        self._would_undo = session.changes.undoes
        stories = [
            {
                "id": story.id,
                "title": story.title or story.id,
                "text": story.text,
                "sensors": list(story.sets),
                "since_utc_ms": None if since_ns is None else since_ns / 1e6,
            }
            for story, since_ns in session.changes.stories
        ]
        self._view.tell(stories=stories, undoes=self._would_undo)

    def _another(self, asked: object) -> Mapping[str, Any]:
        """End the session that runs, for the same scene again or for another one."""
        if not isinstance(asked, dict) or not ({"restart", "scene"} & asked.keys()):
            raise PlotfeedError("session: expected restart or scene")
        if "scene" in asked:
            if (name := str(asked["scene"])) not in self._scenes:
                raise PlotfeedError(f"session.scene: there is no {name!r}")
            try:
                self.scene = self._scenes[name]()
            except (PlotfeedError, OSError) as error:
                raise PlotfeedError(one_line(error)) from None
        self._end_for(None)
        return {"scene": self.scene.scene.name}

    async def _replay(self, asked: object) -> Mapping[str, Any]:
        """Replay a recording, or do something with the replay that runs."""
        if isinstance(asked, dict) and "load" in asked:
            return await self._load(asked["load"])
        if self.replaying is None:
            from plotfeed.feeds.page.page_replay import EXPECTED, REPLAY_CONTROLS

            known = isinstance(asked, dict) and not asked.keys().isdisjoint(
                {*REPLAY_CONTROLS, "stop"}
            )
            raise PlotfeedError("replay: none runs" if known else EXPECTED)
        if isinstance(asked, dict) and asked.get("stop"):
            return self._another({"restart": True})
        return self.replaying.apply(asked)

    async def _load(self, name: object) -> Mapping[str, Any]:
        """End what runs for that recording, once it is known that it can be shown."""
        recordings = self._tell_choice()
        if not isinstance(name, str) or name not in recordings:
            raise PlotfeedError(f"replay.load: there is no recording {str(name)[:80]!r}")
        from plotfeed.feeds.page.recorded_sectors import RecordedSession

        recording = await asyncio.to_thread(RecordedSession.open, recordings[name])
        self._end_for(recording)
        return {"file": name}

    def _in_replay(self, replay: PageReplay, command: dict[str, Any]) -> Mapping[str, Any]:
        """What is meant for a session: its clock is that of the replay."""
        from plotfeed.feeds.page.page_replay import REFUSES

        subject = next(
            key for key in ("sensor", "story", "undo", "clock", "record") if key in command
        )
        if subject != "clock":
            raise PlotfeedError(REFUSES[subject])
        asked = command["clock"]
        if isinstance(asked, dict) and "step_s" in asked:
            raise PlotfeedError(REFUSES["step"])
        return replay.apply(asked)

    def _end_for(self, recording: RecordedSession | None) -> None:
        """End what runs for a replay of that one, or for a session."""
        self._asked, self._notes = recording, []
        self.goes_on = True
        self.ending.set()

    def _tell_choice(self) -> Mapping[str, Path]:
        """Scenes and recordings to choose from, as they are now; the latter."""
        recordings = recordings_in(self._folder)
        if self._recorder is not None:
            recordings.pop(self._recorder.recorder.path.name, None)
        self._view.session({"scenes": list(self._scenes), "recordings": list(recordings)})
        return recordings

    async def _record(self, asked: object, session: RunningSession) -> Mapping[str, Any]:
        """Begin or end a recording of the session that runs."""
        if not isinstance(asked, dict) or not ({"start", "stop"} & asked.keys()):
            raise PlotfeedError("record: expected start or stop")
        if asked.get("stop"):
            return await self._stop_recording()
        if self._recorder is not None:
            raise PlotfeedError("record: it runs already")
        from plotfeed.feeds.recording.recorder import Recorder, SessionRecorder, attachments_of

        path = new_path(self._folder, self.scene.scene.name, datetime.now(UTC))
        try:
            recorder = Recorder(
                path, attachments=attachments_of(self.scene, session.clock.now_ns())
            )
        except (PlotfeedError, OSError) as error:
            raise PlotfeedError(f"record: {error}") from None
        observer = SessionRecorder(recorder, ledger_is_sent=self.scene.mqtt.truth)
        observer.begun(session)
        for task in session.sensors.values():
            for message in (task.settings, task.description):
                observer.after_link(message, session.clock.now_ns())
        self._recorder, self._record_since_s = observer, time.monotonic()
        return {"file": path.name}

    async def _stop_recording(self) -> Mapping[str, Any]:
        observer, self._recorder = self._recorder, None
        if observer is None:
            raise PlotfeedError("record: none runs")
        observer.ended()
        await observer.recorder.stop()
        self._view.session({"record": {"on": False, "file": observer.recorder.path.name}})
        self._tell_choice()
        if observer.recorder.failure:
            raise PlotfeedError(observer.recorder.failure)
        return {"file": observer.recorder.path.name}


def one_line(error: Exception) -> str:
    """The first line of what went wrong."""
    why = error.strerror if isinstance(error, OSError) else None
    return (why or str(error)).partition("\n")[0]


def _scenes_beside(scene: Scene) -> dict[str, Callable[[], Scene]]:
    """Scenes by name: those that come with plotfeed, and files beside the one that runs."""
    found: dict[str, Callable[[], Scene]] = {
        name: (lambda name=name: example(name))  # type: ignore[misc]
        for name in summaries()
    }
    if scene.text:
        files: Sequence[Path] = sorted(scene.folder.glob("*.toml"))[:100]
        found |= {path.stem: (lambda path=path: load(path)) for path in files}  # type: ignore[misc]
    return found


LIBRARY = "plotfeed "  # What those of plotfeed say that they were written by, before its version
MAX_LISTED = 50
MAX_LOOKED_AT = 500  # Files, the newest first, of which it is found out whose they are


def recordings_in(folder: Path) -> dict[str, Path]:
    """Files by name, the newest first, at most `MAX_LISTED`; none if the folder cannot be read."""
    from plotfeed.replay.mcap import library_of

    times: dict[Path, int] = {}
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith(SUFFIX) and entry.name.isprintable() and entry.is_file():
                times[Path(entry.path)] = entry.stat().st_mtime_ns
    newest_first = sorted(times, key=lambda path: (-times[path], path.name))
    found: dict[str, Path] = {}
    for path in newest_first[:MAX_LOOKED_AT]:
        with contextlib.suppress(DecodeError, OSError):
            if len(found) < MAX_LISTED and library_of(path).startswith(LIBRARY):
                found[path.name] = path
    return found


def new_path(folder: Path, scene: str, at: datetime) -> Path:
    """The name of a recording of that scene from then on, in UTC; numbered if there is one."""
    stem = f"{scene}-{at:%Y%m%dT%H%M%SZ}"
    names = (f"{stem}-{number}" if number > 1 else stem for number in count(1))
    return next(path for name in names if not (path := folder / f"{name}{SUFFIX}").exists())

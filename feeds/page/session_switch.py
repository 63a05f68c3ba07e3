"""Sessions one after the other under one page: restarted, of another scene, recorded, replayed."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plotfeed.feeds.page.scene_outline import Basemap
from plotfeed.feeds.page.view import View
from plotfeed.feeds.scene.examples import summaries
from plotfeed.feeds.scene.scene import Scene, example, load
from plotfeed.feeds.session.observer import Observer, RunningSession
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.replay.recorded import SUFFIX

if TYPE_CHECKING:
    from plotfeed.feeds.page.page_replay import PageReplay
    from plotfeed.feeds.page.recorded_sectors import RecordedSession
    from plotfeed.feeds.recording.recorder import SessionRecorder

# Recordings and replays are loaded once there is one.

TELL_EVERY_S = 0.5


def _recorded(method: str) -> Callable[..., None]:
    """A method of an observer that hands on what it is told to a recording, if one runs."""

    def tell(self: SessionSwitch, *told: Any) -> None:
        if self._recorder is not None:
            getattr(self._recorder, method)(*told)

    return tell


class SessionSwitch(Observer):
    """Takes a viewer's commands that concern whole sessions, and records the one that runs."""

    def __init__(self, scene: Scene, view: View, folder: Path) -> None:
        """Recordings are those in `folder`; scenes to choose from are those beside this one."""
        self.scene = scene  # Of the session that runs, or ran before the replay that does
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
        self._telling: asyncio.Task[None] | None = None

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

    async def apply(self, command: dict[str, Any]) -> Mapping[str, Any]:
        """Do as a viewer asks; commands for a session's sensor or clock come without a session."""
        if "session" in command:
            return self._another(command["session"])
        if "replay" in command:
            return await self._replay(command["replay"])
        if self.replaying is not None:
            return self._in_replay(self.replaying, command)
        if "record" in command:
            return await self._record(command["record"])
        raise PlotfeedError("no session runs")

    # What the session tells.

    def begun(self, session: RunningSession) -> None:
        """The session stands, and its time begins."""
        self._session = session
        self._tell_choice()
        self._view.session({"replay": {}, "record": {"on": False}, "notes": self._notes})
        self._telling = asyncio.create_task(self._tell(), name="page-record")

    def ended(self) -> None:
        """The session is over, and with it its recording."""
        self._session = None
        if self._telling is not None:
            self._telling.cancel()
        if self._recorder is not None:
            self._recorder.ended()
            self._recorder.recorder.close()
            self._recorder = None

    received, before_link, after_link, ledger = map(
        _recorded, ("received", "before_link", "after_link", "ledger")
    )

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

    async def _record(self, asked: object) -> Mapping[str, Any]:
        if not isinstance(asked, dict) or not ({"start", "stop"} & asked.keys()):
            raise PlotfeedError("record: expected start or stop")
        if asked.get("stop"):
            return await self._stop_recording()
        if self._session is None or self._recorder is not None:
            raise PlotfeedError("record: it runs already" if self._session else "no session runs")
        from plotfeed.feeds.recording.recorder import Recorder, SessionRecorder, attachments_of

        path = new_path(self._folder, self.scene.scene.name, datetime.now(UTC))
        try:
            recorder = Recorder(
                path, attachments=attachments_of(self.scene, self._session.clock.now_ns())
            )
        except (PlotfeedError, OSError) as error:
            raise PlotfeedError(f"record: {error}") from None
        observer = SessionRecorder(recorder, ledger_is_sent=self.scene.mqtt.truth)
        observer.begun(self._session)
        for task in self._session.sensors.values():
            for message in (task.settings, task.description):
                observer.after_link(message, self._session.clock.now_ns())
        self._recorder = observer
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

    async def _tell(self) -> None:
        """Tell how far the recording is."""
        loop, began_s = asyncio.get_running_loop(), 0.0
        while True:
            await asyncio.sleep(TELL_EVERY_S)
            if self._recorder is None:
                began_s = 0.0
                continue
            began_s = began_s or loop.time()
            recorder = self._recorder.recorder
            told = {
                "on": True,
                "file": recorder.path.name,
                "octets": recorder.octets,
                "seconds": round(loop.time() - began_s),
            }
            self._view.session({"record": told})


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

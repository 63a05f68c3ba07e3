"""One session after the other under one page: restarted, of another scene, recorded for a while."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plotfeed.feeds.message import Message
from plotfeed.feeds.observers import Observer
from plotfeed.feeds.page.controls import refused
from plotfeed.feeds.page.view import View
from plotfeed.feeds.recorder import Recorder
from plotfeed.feeds.scene import Scene, example, load
from plotfeed.feeds.session_record import SessionRecorder, attachments_of
from plotfeed.proto.errors import PlotfeedError

if TYPE_CHECKING:
    from plotfeed.feeds.session import Session

TELL_EVERY_S = 0.5
EXAMPLES = ("section-4",)
REPLAYED_BY_COMMAND = "Recordings are replayed by the command: plotfeed replay FILE URL."


class Stage(Observer):
    """Takes a viewer's wishes that concern whole sessions, and records the one that runs."""

    def __init__(self, scene: Scene, view: View, folder: Path) -> None:
        """Recordings go to `folder`; scenes to choose from are those beside this one."""
        self.scene = scene
        self.ending = asyncio.Event()
        """Set when the session that runs shall end."""
        self.goes_on = True
        """Whether another one follows then."""
        self._view = view
        self._folder = folder
        self._scenes = _scenes_beside(scene)
        self._session: Session | None = None
        self._recorder: SessionRecorder | None = None
        self._telling: asyncio.Task[None] | None = None

    def begin(self) -> None:
        """A session is about to run; it is the last one, unless somebody wants another."""
        self.ending.clear()
        self.goes_on = False

    async def apply(self, command: dict[str, Any]) -> Mapping[str, Any]:
        """Do as a viewer asks."""
        if "session" in command:
            return self._another(command["session"])
        if "record" in command:
            return await self._record(command["record"])
        return refused(REPLAYED_BY_COMMAND)

    # What the session tells.

    def begun(self, session: Session) -> None:
        """It stands, and its time begins."""
        self._session = session
        self._view.session({"scenes": list(self._scenes), "recordings": []})
        self._view.session({"replay": {}, "record": {"on": False}})
        self._telling = asyncio.create_task(self._tell(), name="page-record")

    def ended(self) -> None:
        """It is over, and with it its recording."""
        self._session = None
        if self._telling is not None:
            self._telling.cancel()
        if self._recorder is not None:
            self._recorder.ended()
            self._recorder.recorder.close()
            self._recorder = None

    def took(self, topic: str, payload: bytes, content_type: str | None, t_utc_ns: int) -> None:
        """Recorded, if a recording runs; as all that follows."""
        if self._recorder is not None:
            self._recorder.took(topic, payload, content_type, t_utc_ns)

    def before(self, message: Message) -> None:
        """On its way into a link."""
        if self._recorder is not None:
            self._recorder.before(message)

    def after(self, message: Message, sent_utc_ns: int) -> None:
        """On its way out."""
        if self._recorder is not None:
            self._recorder.after(message, sent_utc_ns)

    def ledger(self, message: Message) -> None:
        """An entry is complete."""
        if self._recorder is not None:
            self._recorder.ledger(message)

    def _another(self, wish: object) -> Mapping[str, Any]:
        """End the session that runs, for the same scene again or for another one."""
        if not isinstance(wish, dict) or not ({"restart", "scene"} & wish.keys()):
            return refused("session: expected restart or scene")
        try:
            if "scene" in wish:
                name = str(wish["scene"])
                if name not in self._scenes:
                    return refused(f"session.scene: there is no {name!r}")
                self.scene = self._scenes[name]()
        except (PlotfeedError, OSError) as error:
            return refused(str(error).partition("\n")[0])
        self.goes_on = True
        self.ending.set()
        return {"ok": True, "in_force": {"scene": self.scene.scene.name}}

    async def _record(self, wish: object) -> Mapping[str, Any]:
        if not isinstance(wish, dict) or not ({"start", "stop"} & wish.keys()):
            return refused("record: expected start or stop")
        if wish.get("stop"):
            return await self._stop_recording()
        if self._session is None or self._recorder is not None:
            return refused("record: it runs already" if self._session else "no session runs")
        path = self._folder / f"{self.scene.scene.name}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.mcap"
        try:
            recorder = Recorder(
                path, attachments=attachments_of(self.scene, self._session.clock.now_ns())
            )
        except (PlotfeedError, OSError) as error:
            return refused(f"record: {error}")
        observer = SessionRecorder(recorder, ledger_is_sent=self.scene.mqtt.truth)
        observer.begun(self._session)
        self._recorder = observer
        return {"ok": True, "in_force": {"file": path.name}}

    async def _stop_recording(self) -> Mapping[str, Any]:
        observer, self._recorder = self._recorder, None
        if observer is None:
            return refused("record: none runs")
        observer.ended()
        await observer.recorder.stop()
        self._view.session({"record": {"on": False, "file": observer.recorder.path.name}})
        if observer.recorder.failure:
            return refused(observer.recorder.failure)
        return {"ok": True, "in_force": {"file": observer.recorder.path.name}}

    async def _tell(self) -> None:
        """How far the recording is."""
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


def _scenes_beside(scene: Scene) -> dict[str, Callable[[], Scene]]:
    """Scenes by name: those that come with plotfeed, and files beside the one that runs."""
    found: dict[str, Callable[[], Scene]] = {
        name: (lambda name=name: example(name))  # type: ignore[misc]
        for name in EXAMPLES
    }
    if scene.text:
        files: Sequence[Path] = sorted(scene.folder.glob("*.toml"))[:100]
        found |= {path.stem: (lambda path=path: load(path)) for path in files}  # type: ignore[misc]
    return found

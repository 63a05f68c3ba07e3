"""A recording replayed in place of a session: over its brokers, and on the view."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

from plotfeed.feeds.page.recorded_view import RecordedView
from plotfeed.feeds.page.scene_outline import Basemap
from plotfeed.feeds.page.tracker_tracks import TrackNews
from plotfeed.feeds.page.view import View
from plotfeed.feeds.page.viewers import refused
from plotfeed.feeds.recording.recorded_session import RecordedSession
from plotfeed.feeds.replaying.control import ReplayControl
from plotfeed.feeds.replaying.destinations import Destinations, open_transports
from plotfeed.feeds.replaying.replay_settings import Moment, ReplaySettings, Stamps
from plotfeed.feeds.replaying.replayer import replay
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.proto.utc import NS
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.pacing import speed_of

LOOK_EVERY_S = 0.1
MOST_S = 1e9
EXPECTED = "replay: expected load, stop, or some of paused, speed, position_s and skip_s"
NOT_NOW = "A replay is not changed, stepped or recorded: Stop or Restart ends it."
REFUSES = dict.fromkeys(("sensor", "step", "record"), NOT_NOW)
"""Controls that do not work meanwhile, and why."""
WHOSE_TIME = "Times are those of the recording; its messages leave with those of now."


class PageReplay:
    """A replay from its beginning until it is stopped; at its end it stands."""

    def __init__(self, recording: RecordedSession, view: View) -> None:
        self.recording = recording
        self._view = view
        self._shown = RecordedView(recording, view)
        self._control = ReplayControl()
        self._leapt_from_ns: int | None = None
        """The time that is shown until the view has followed a leap."""
        self._leaps = 0

    async def run(
        self,
        addresses: Sequence[BrokerAddress],
        basemap: Basemap | None,
        ending: asyncio.Event,
    ) -> None:
        """Replay it until told to end; raises `PlotfeedError` and `OSError`."""
        self._view.scene(self.recording.scene, basemap)
        settings = ReplaySettings(
            start=Moment(utc_ns=self.recording.start_ns),
            stands_at_ns=self.recording.end_ns,
            stamps=Stamps(to_now=True),
        )
        to = Destinations(brokers=tuple(addresses))
        path = self.recording.path
        with (  # which takes its time where a file has no index
            await asyncio.to_thread(McapReader, path) as sent,
            await asyncio.to_thread(McapReader, path) as shown,
        ):
            self._shown.open(shown)
            self._tell()
            async with open_transports(to, waits=False) as outs:
                await self._play(replay(sent, outs, settings, control=self._control), ending)

    async def _play(self, replaying: Coroutine[Any, Any, object], ending: asyncio.Event) -> None:
        """Replay until told to end; raises what goes wrong."""
        work = asyncio.create_task(replaying, name="page-replay")
        following = asyncio.create_task(self._follow(), name="page-follow-replay")
        waiting = asyncio.create_task(ending.wait(), name="page-replay-end")
        tasks = (work, following, waiting)
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            if following.done():
                following.result()
            self._control.stop()
            await work
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    @property
    def now_utc_ns(self) -> int:
        """The recorded time that it has reached, as far as it is shown."""
        return self._reached_ns if self._leapt_from_ns is None else self._leapt_from_ns

    def shown_tracks(self, tracks: TrackNews) -> TrackNews:
        """Tracks with the times at which what was sent then had been recorded."""
        pace = self._control.pace
        if pace is None:
            return tracks
        recorded = tracks.t_utc_ns.copy()
        recorded[:] = [pace.position(t_utc_ns) for t_utc_ns in tracks.t_utc_ns.tolist()]
        return replace(tracks, t_utc_ns=recorded)

    def apply(self, asked: object) -> Mapping[str, Any]:
        """Pause, go on, hurry, or go elsewhere."""
        if not isinstance(asked, dict) or not asked or not asked.keys() <= REPLAY_CONTROLS.keys():
            return refused(EXPECTED)
        if self._control.pace is None:
            return refused("replay: it has not begun yet")
        wanted = {}
        for name, value in asked.items():
            try:
                wanted[name] = REPLAY_CONTROLS[name](value)
            except ValueError as error:
                return refused(f"replay.{name}: {error}")
        self._obey(wanted)
        self._tell()
        return {"ok": True, "in_force": self._state()}

    def _obey(self, wanted: Mapping[str, Any]) -> None:
        """A position comes before a pause, so that it is there that it ends."""
        if "speed" in wanted:
            self._control.set_speed(wanted["speed"])
        if "position_s" in wanted:
            self._seek(self.recording.start_ns + round(wanted["position_s"] * NS))
        if "skip_s" in wanted:
            self._seek(self._reached_ns + round(wanted["skip_s"] * NS))
        if "paused" in wanted:
            self._pause(wanted["paused"])

    def _pause(self, paused: bool) -> None:
        if paused:
            self._control.pause()
        elif self._control.is_paused:
            if self._reached_ns >= self.recording.end_ns:
                self._seek(self.recording.start_ns)
            self._control.resume()

    def _seek(self, recorded_ns: int) -> None:
        self._leapt_from_ns, self._leaps = self.now_utc_ns, self._leaps + 1
        self._control.seek(min(max(recorded_ns, self.recording.start_ns), self.recording.end_ns))

    @property
    def _reached_ns(self) -> int:
        if self._control.pace is None:
            return self.recording.start_ns
        _, position_ns = self._control.position
        return min(max(position_ns, self.recording.start_ns), self.recording.end_ns)

    async def _follow(self) -> None:
        """Keep the view where the replay is, until cancelled."""
        with ThreadPoolExecutor(1, thread_name_prefix="page-replay") as thread:
            while True:
                await asyncio.sleep(LOOK_EVERY_S)
                leaps, leap = self._leaps, self._leapt_from_ns is not None
                await self._shown.go_to(self._reached_ns, thread, leap=leap)
                if leaps == self._leaps:  # else there was another one meanwhile
                    self._leapt_from_ns = None
                self._tell()

    def _state(self) -> dict[str, Any]:
        return {
            "file": self.recording.path.name,
            "position_s": round((self._reached_ns - self.recording.start_ns) / NS, 1),
            "duration_s": round((self.recording.end_ns - self.recording.start_ns) / NS, 1),
            "paused": self._control.is_paused,
        }

    def _tell(self) -> None:
        control = self._control
        clock = {"kind": "replay", "paused": control.is_paused, "speed": float(control.speed)}
        notes = [*self.recording.notes, WHOSE_TIME]
        self._view.session({"clock": clock, "replay": self._state(), "record": {"on": False}})
        self._view.session({"refuses": REFUSES, "notes": notes})


def _truth_in(value: object) -> bool:
    if value is True or value is False:
        return value
    raise ValueError(f"expected true or false, not {str(value)[:40]!r}")


def _number_in(value: object) -> float:
    """Read a number of seconds, or of times its own speed."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= MOST_S:
        raise ValueError(f"expected a number, not {str(value)[:40]!r}")
    return float(value)


REPLAY_CONTROLS: Mapping[str, Callable[[object], Any]] = {
    "paused": _truth_in,
    "speed": lambda value: speed_of(_number_in(value)),
    "position_s": _number_in,
    "skip_s": _number_in,
}
"""What may be asked of a replay, and how it is read; raises `ValueError`."""

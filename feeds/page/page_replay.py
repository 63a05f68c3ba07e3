"""A recording replayed in place of a session: over its brokers, and on the view."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.link.uplink import json_of
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.page.recorded_sectors import (
    DroneNumbers,
    RecordedSectors,
    RecordedSession,
    SeenDrones,
    Told,
)
from plotfeed.feeds.page.scene_outline import Basemap
from plotfeed.feeds.page.view import View
from plotfeed.feeds.replaying.replay_settings import Moment, ReplaySettings, Stamps
from plotfeed.feeds.replaying.replayer import Replayer
from plotfeed.feeds.replaying.routes import Destinations, open_transports
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.models.state import TruthState
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.pacing import speed_of

# Plots are read from so long before those that are to be shown: the ledger tells of them later.
LEAD_NS = 2 * NS
# Of recorded time between two looks; of more, what has not faded is shown and the rest is not.
MOST_READ_NS = 60 * NS


class RecordedView:
    """Shows one recording, from wherever its replay goes."""

    def __init__(self, recording: RecordedSession, view: View) -> None:
        self._recording = recording
        self._view = view
        self._glow_ns = round(recording.scene.page.afterglow_s * NS)
        self._drones = DroneNumbers()
        self._seen = SeenDrones(recording.scene)
        self._totals = SessionCounters()
        self._told_ns = recording.start_ns

    def open(self, log: McapReader) -> None:
        """Read from the beginning."""
        self._log = log
        self._sectors = self._from(self._recording.start_ns)
        self._begin(self._recording.start_ns)

    async def go_to(self, t_ns: int, thread: ThreadPoolExecutor, *, leap: bool) -> None:
        """Show what there is then; after a leap, with what has not faded from before it."""
        loop = asyncio.get_running_loop()
        found, drones = await loop.run_in_executor(thread, partial(self._read, t_ns, leap=leap))
        if leap:
            self._view.clear()
            self._begin(t_ns)
        self._tell_changes(t_ns)
        for batch, sent in found:
            self._tell(batch, sent, leap=leap)
        self._totals.drones = len(self._drones)
        self._view.truth(t_ns, drones, tuple(self._drones))
        self._view.totals(self._totals)

    def _read(self, t_ns: int, *, leap: bool) -> tuple[list[Told], TruthState]:
        """What is new then, and where the drones are; in a thread, as it takes a while."""
        if leap:
            self._seen = SeenDrones(self._recording.scene)
        if leap or t_ns - self._sectors.read_ns > MOST_READ_NS:
            self._sectors = self._from(t_ns - self._glow_ns - LEAD_NS)
        found = self._sectors.until(t_ns)
        self._seen.take(batch for batch, _ in found)
        return found, self._seen.state_at(t_ns)

    def _from(self, from_ns: int) -> RecordedSectors:
        first_ns = max(from_ns, self._recording.start_ns)
        return RecordedSectors(self._log, self._recording, self._drones, first_ns)

    def _begin(self, t_ns: int) -> None:
        """Count anew from then on."""
        self._totals = SessionCounters()
        self._told_ns = t_ns
        for sensor in self._recording.settings.told_at(t_ns).values():
            self._view.settings(sensor, t_ns)

    def _tell(self, batch: Batch, sent: Sequence[pb.Sent], *, leap: bool) -> None:
        if not leap:
            if self._recording.ledger is not None and batch.sensor in self._view.in_force:
                self._tell_link(self._view.in_force[batch.sensor], batch, sent)
            self._count(batch, sent)
        self._view.settled(batch, sent, is_counted=not leap)

    def _tell_changes(self, t_ns: int) -> None:
        """Show keys of sensors that changed, but for links: of those the ledger tells."""
        now = self._recording.settings.told_at(t_ns)
        for sensor in self._recording.settings.told_between(self._told_ns, t_ns):
            after = now[sensor]
            if self._recording.ledger is not None:
                after = after.model_copy(update={"link": self._view.in_force[sensor].link})
            self._view.settings(after, t_ns)
        self._told_ns = max(self._told_ns, t_ns)

    def _tell_link(self, before: Sensor, batch: Batch, sent: Sequence[pb.Sent]) -> None:
        """Show a sector's link, if it is another than that of the one before."""
        (keys,) = batch.links
        if keys == json_of(before.link):
            return
        try:
            link = LinkSettings.model_validate_json(keys) if keys else None
        except ValueError:
            return
        since_ns = min((one.due_utc_ns for one in sent), default=batch.due_utc_ns)
        self._view.settings(before.model_copy(update={"link": link}), since_ns)

    def _count(self, batch: Batch, sent: Sequence[pb.Sent]) -> None:
        self._totals.add(batch.counts)
        for one in sent:
            late_ns = one.sent_utc_ns - (one.link_due_utc_ns or one.due_utc_ns)
            self._totals.settle(one.fate, one.copy, late_ns, one.octets)


LOOK_EVERY_S = 0.1
MOST_S = 1e9
EXPECTED = "replay: expected load, stop, or some of paused, speed, position_s and skip_s"
NOT_NOW = "A replay is not changed, stepped or recorded: Stop or Restart ends it."
# Controls that do not work meanwhile, and why.
REFUSES = dict.fromkeys(("sensor", "story", "undo", "step", "record"), NOT_NOW)
WHOSE_TIME = "Times are those of the recording; its messages leave with those of now."


class PageReplay:
    """A replay from its beginning until it is stopped; at its end it stands."""

    def __init__(self, recording: RecordedSession, view: View) -> None:
        self.recording = recording
        self._view = view
        self._shown = RecordedView(recording, view)
        self._replayer = Replayer(
            ReplaySettings(
                start=Moment(utc_ns=recording.start_ns),
                stands_at_ns=recording.end_ns,
                stamps=Stamps(to_now=True),
            )
        )
        # The time that is shown until the view has followed a leap.
        self._leapt_from_ns: int | None = None
        self._leaps = 0

    async def run(
        self, addresses: Sequence[BrokerAddress], basemap: Basemap | None, ending: asyncio.Event
    ) -> None:
        """Replay it until told to end; raises `PlotfeedError` and `OSError`."""
        self._view.scene(self.recording.scene, basemap)
        to = Destinations(brokers=tuple(addresses))
        path = self.recording.path
        with (  # which takes its time where a file has no index
            await asyncio.to_thread(McapReader, path) as sent,
            await asyncio.to_thread(McapReader, path) as shown,
        ):
            self._shown.open(shown)
            self._tell()
            async with open_transports(to, waits=False) as outs:
                await self._play(self._replayer.run(sent, outs), ending)

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
            self._replayer.stop()
            await work
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    @property
    def now_utc_ns(self) -> int:
        """The recorded time that it has reached, as far as it is shown."""
        return self._reached_ns if self._leapt_from_ns is None else self._leapt_from_ns

    def recorded_ns(self, t_utc_ns: int) -> int:
        """When what was sent at a time had been recorded."""
        pace = self._replayer.pace
        return t_utc_ns if pace is None else pace.position(t_utc_ns)

    def apply(self, asked: object) -> Mapping[str, Any]:
        """Pause, go on, hurry, or go elsewhere."""
        if not isinstance(asked, dict) or not asked or not asked.keys() <= REPLAY_CONTROLS.keys():
            raise PlotfeedError(EXPECTED)
        if self._replayer.pace is None:
            raise PlotfeedError("replay: it has not begun yet")
        wanted = {}
        for name, value in asked.items():
            try:
                wanted[name] = REPLAY_CONTROLS[name](value)
            except ValueError as error:
                raise PlotfeedError(f"replay.{name}: {error}") from None
        self._obey(wanted)
        self._tell()
        return self._state()

    def _obey(self, wanted: Mapping[str, Any]) -> None:
        """A position comes before a pause, so that it is there that it ends."""
        if "speed" in wanted:
            self._replayer.set_speed(wanted["speed"])
        if "position_s" in wanted:
            self._seek(self.recording.start_ns + round(wanted["position_s"] * NS))
        if "skip_s" in wanted:
            self._seek(self._reached_ns + round(wanted["skip_s"] * NS))
        if wanted.get("paused"):
            self._replayer.pause()
        elif "paused" in wanted and self._replayer.is_paused:
            if self._reached_ns >= self.recording.end_ns:
                self._seek(self.recording.start_ns)
            self._replayer.resume()

    def _seek(self, recorded_ns: int) -> None:
        self._leapt_from_ns, self._leaps = self.now_utc_ns, self._leaps + 1
        self._replayer.seek(min(max(recorded_ns, self.recording.start_ns), self.recording.end_ns))

    @property
    def _reached_ns(self) -> int:
        if self._replayer.pace is None:
            return self.recording.start_ns
        _, position_ns = self._replayer.position
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
            "paused": self._replayer.is_paused,
        }

    def _tell(self) -> None:
        replayer = self._replayer
        clock = {"kind": "replay", "paused": replayer.is_paused, "speed": float(replayer.speed)}
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


# What may be asked of a replay, and how it is read; raises `ValueError`.
REPLAY_CONTROLS: Mapping[str, Callable[[object], Any]] = {
    "paused": _truth_in,
    "speed": lambda value: speed_of(_number_in(value)),
    "position_s": _number_in,
    "skip_s": _number_in,
}

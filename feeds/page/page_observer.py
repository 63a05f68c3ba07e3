"""Ties a running session to the page: what happens goes to the view, what is asked comes back."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Coroutine, Mapping, Sequence
from typing import Any

import numpy as np

from plotfeed.feeds.impairment.delays import DelayLaw
from plotfeed.feeds.messages.sector_report import SectorReport
from plotfeed.feeds.page.scene_outline import Basemap
from plotfeed.feeds.page.view import View
from plotfeed.feeds.page.viewers import Controls, NoControls
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.observer import Observer, RunningSession
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.proto import plotfeed_pb2 as pb

TRUTH_EVERY_S = 0.1
PROBABILITIES = np.linspace(0, 1, 1001)
CLOCK_CONTROLS = ("pause", "step", "speed")
REAL_TIME = "Pause, step and speed need a simulated clock: real time cannot be held or hurried."
NO_PACE = "A run as fast as possible has no pace to control."


class PageObserver(Observer):
    """Follows one session after the other, and controls the one that runs."""

    def __init__(self, view: View, others: Controls | None = None) -> None:
        """`others` take commands that are not for a session's sensor or clock."""
        self._view = view
        self._others = others or NoControls()
        self._session: RunningSession | None = None
        self._basemap: Basemap | None = None
        self._before: tuple[Sensor, ...] = ()
        self._refusal = ""
        self._now_ns = 0

    def scene(self, basemap: Basemap | None) -> None:
        """The next session has that basemap."""
        self._basemap = basemap

    # What the session tells.

    def begun(self, session: RunningSession) -> None:
        """The session stands, and its time begins."""
        self._session = session
        self._refusal = ""
        self._view.scene(session.scene, self._basemap)
        self._before = tuple(task.sensor for task in session.sensor_tasks.values())
        for sensor in self._before:
            self._tell_settings(sensor, new_model=True)
        self._tell_clock()

    def ended(self) -> None:
        """The session is over; the page shows what there was."""
        self._now_ns = self.now_utc_ns()
        self._session = None

    def report(self, report: SectorReport) -> None:
        """A sector is reported now."""
        self._view.report(report)

    def settled(self, report: SectorReport, sent: Sequence[pb.Sent]) -> None:
        """A sector's messages have their fates."""
        self._view.settled(report, sent)

    def settings(self, sensor: Sensor) -> None:
        """The sensor is so from now on."""
        before = next((s for s in self._before if s.id == sensor.id), None)
        self._before = tuple(sensor if s.id == sensor.id else s for s in self._before)
        self._tell_settings(sensor, new_model=before is None or model_differs(before, sensor))

    # What the page asks.

    def now_utc_ns(self) -> int:
        """The session's time; the last one when none runs."""
        return self._now_ns if self._session is None else self._session.clock.now_ns()

    async def apply(self, command: dict[str, Any]) -> Mapping[str, Any]:
        """Do as a viewer asks."""
        if self._session is None or ("sensor" not in command and "clock" not in command):
            return await self._others.apply(command)
        in_force = self._session.command(command)
        self._tell_clock()
        return {"ok": True, "in_force": in_force}

    async def follow(self) -> None:
        """Tell the view what changes without anybody saying so, until cancelled."""
        while True:
            await asyncio.sleep(TRUTH_EVERY_S)
            if self._session is not None:
                self._look_at(self._session)

    def _look_at(self, session: RunningSession) -> None:
        now_ns = session.clock.now_ns()
        trajectories = session.trajectories
        self._view.truth(now_ns, trajectories.state_at(now_ns), trajectories.names)
        self._view.totals(session.totals)
        if session.totals.last_refusal != self._refusal:
            self._refusal = session.totals.last_refusal
            self._view.refusal(self._refusal)
        self._tell_clock()

    def _tell_clock(self) -> None:
        """The clock's state, which control may have changed from elsewhere, for what is news."""
        if self._session is not None:
            self._view.session(clock_state(self._session))

    def _tell_settings(self, sensor: Sensor, *, new_model: bool) -> None:
        tell_settings(self._view, sensor, self.now_utc_ns(), new_model=new_model)


def tell_settings(view: View, sensor: Sensor, since_utc_ns: int, *, new_model: bool) -> None:
    """Show a sensor as it is since then, and the delays that its link is to make."""
    law = DelayLaw.of(sensor.link or LinkSettings())
    view.settings(
        sensor.id,
        sensor.model_dump(mode="json", exclude_unset=True, exclude={"event", "scan"}),
        asked_latency_ms=law.quantile_ms(PROBABILITIES),
        since_utc_ns=since_utc_ns,
        new_model=new_model,
    )


def clock_state(session: RunningSession) -> dict[str, Any]:
    """What of the clock a page shows, and which of its controls work."""
    clock = session.clock
    if isinstance(clock, WallClock):
        state = {
            "kind": "wall" if clock.is_real else "simulated",
            "paused": clock.is_paused,
            "speed": clock.speed,
        }
        refusals = dict.fromkeys(CLOCK_CONTROLS, REAL_TIME) if clock.is_real else {}
    else:
        state = {"kind": "instant", "paused": False, "speed": 1.0}
        refusals = dict.fromkeys(CLOCK_CONTROLS, NO_PACE)
    return {"clock": state, "refuses": refusals}


@contextlib.asynccontextmanager
async def alongside(work: Coroutine[Any, Any, None], name: str) -> AsyncIterator[None]:
    """Do that work for as long as this lasts."""
    task = asyncio.create_task(work, name=name)
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


def model_differs(before: Sensor, now: Sensor) -> bool:
    """Tell whether anything but the link is different."""
    link = {"link", "event"}
    return before.model_dump(exclude=link) != now.model_dump(exclude=link)

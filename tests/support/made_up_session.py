"""A session for the page to show, without sockets: an engine that is given time by hand."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from support.every_kind import MICROPHONES, RF

from plotfeed import testing
from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.formats.told_tracks import ToldTrack
from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import HELD_NS, Message, records
from plotfeed.feeds.page.page_sessions import PageSessions
from plotfeed.feeds.page.scene_outline import Basemap
from plotfeed.feeds.page.view import View
from plotfeed.feeds.scene.changes import ClockCommand, command_of, joined
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.models.frames import ecef_to_geodetic
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS

TRUTH_EVERY_NS = NS // 10
MOST_AT_ONCE_S = 0.25
OF_SESSION = frozenset({"sensor", "clock", "story", "undo"})  # Commands that the session takes
TRACKED = 24  # Drones that the imagined tracker has a track of


def sensors(range_max_m: float = 8000.0) -> list[dict[str, Any]]:
    """One of each kind, about the site."""
    polar = testing.radar(
        scan=testing.rotating(period_s=2.0, sectors=32),
        range_max_m=range_max_m,
        range_min_m=150.0,
        receive_beams=32,
        gain_rx_dbi=None,
        elevation_min_deg=-5.0,
        elevation_max_deg=60.0,
        pfa=1e-5,
        power_w=8.0,
        link={"latency_ms": 120.0, "jitter_ms": 25.0},
    )
    bursts = {"kind": "gilbert-elliott", "mean_loss": 0.05, "mean_burst": 3.0}
    mimo = polar | {
        "id": "gate",
        "type": "mimo_radar",
        "report": ["asterix-015", "plots"],
        "scan": testing.staring(),
        "power_w": None,
        "receive_beams": None,
        "frequency_hz": 15e9,
        "gain_tx_dbi": 11.6,
        "gain_rx_dbi": 14.0,
        "position_enu_m": [2600.0, -1900.0, 12.0],
        "range_max_m": 0.5 * range_max_m,
        "azimuth_min_deg": 60.0,
        "azimuth_max_deg": 200.0,
        "transmitters": [
            {"power_w": 2000.0, "east_m": 2600.0 + e, "north_m": -1900.0 + n, "above_site_m": 12.0}
            for e, n in ((0.0, 60.0), (52.0, -30.0), (-52.0, -30.0))
        ],
        "link": {"latency_ms": 60.0, "jitter_ms": 10.0, "loss": bursts},
    }
    microphone = MICROPHONES | {
        "id": "microphones",
        "position_enu_m": [-1500.0, 900.0, 3.0],
        "microphones": 8,
        "azimuth_beamwidth_deg": 4.4,
        "elevation_beamwidth_deg": None,
        "sensitivity_db": 3.0,
        "absorption_db_per_km": 5.0,
        "range_max_m": 1500.0,
    }
    receiver = RF | {
        "id": "receiver",
        "position_enu_m": [-2800.0, -2400.0, 20.0],
        "channel_bandwidth_hz": 1e7,
        "range_max_m": 6000.0,
        "azimuth_beamwidth_deg": 10.0,
        "azimuth_floor_deg": None,
        "baseline_m": 0.3,
        "duty_cycle": 0.5,
        "scan": testing.staring(2.0),
    }
    return [polar, mimo, microphone, receiver]


def drones(count: int, radius_m: float = 7500.0, emitting: int = 12) -> list[dict[str, Any]]:
    """Straight lines this way and that; the first few talk to their pilots."""
    rng = np.random.default_rng(8)
    found = []
    for i in range(count):
        (a0, a1), (r0, r1) = rng.uniform(0, 2 * np.pi, 2), radius_m * np.sqrt(rng.uniform(size=2))
        up_m = float(rng.uniform(60, 400))
        path = [
            {"east_m": r * np.sin(a), "north_m": r * np.cos(a), "above_site_m": up_m}
            for a, r in ((a0, r0), (a1, r1))
        ]
        emitters = [{"frequency_hz": 2.45e9, "bandwidth_hz": 1e7, "eirp_dbm": 20.0}]
        found.append(
            testing.flown(
                f"drone-{i:03}",
                *path,
                speed_m_s=float(rng.uniform(8, 25)),
                rcs_m2=float(rng.choice([0.02, 0.05, 0.1])),
                emitters=emitters if i < emitting else [],
            )
        )
    return found


def scene(count: int = 40, **more: Any) -> Scene:
    return testing.scene(sensors(), drones(count), seed=8, **more)


class HandClock(WallClock):
    """Shows the time that it is given, back or forth; its pace is for whoever gives it."""

    def __init__(self, at_ns: int) -> None:
        super().__init__(at_ns)
        self.at_ns = at_ns
        self.start()

    def now_ns(self) -> int:
        return self.at_ns

    @property
    def is_paused(self) -> bool:
        return self.stands_before(1 << 63)


class MadeUpSession:
    """The page's controls, and what drives it: `advance` as far as a time.

    It is the running session that the page's observer knows.
    """

    def __init__(
        self,
        view: View | None,
        shown: Scene,
        start_ns: int = testing.START_NS,
        basemap: Basemap | None = None,
    ) -> None:
        """Without a view, the same work is done and shown to nobody."""
        self.view = view
        self.scene = shown
        self.commands: list[dict[str, Any]] = []
        self.messages: deque[Message] = deque(maxlen=5000)
        self.clock = HandClock(start_ns)
        self.totals = SessionCounters(drones=len(shown.drone))
        self.session: dict[str, Any] = {
            "record": {"on": False},
            "replay": {},
            "scenes": ["section-4", shown.scene.name],
            "recordings": ["morning.mcap", "field-day.mcap"],
        }
        self._engine = Engine(shown, start_ns)
        self._engine.control_clock = self._control_clock
        self.trajectories, self.changes = self._engine.trajectories, self._engine.changes
        self.sensors = {s.id: SimpleNamespace(sensor=s, pointed=None) for s in shown.sensor}
        self._rng = np.random.default_rng(1)
        self._truth_due_ns = self._tracks_due_ns = start_ns
        self._observer = None if view is None else PageSessions(shown, view, Path("nowhere"))
        if self._observer is not None and view is not None:
            self._observer.basemap = basemap
            self._observer.begun(self)  # type: ignore[arg-type]
            view.session(self.session)

    @property
    def now_ns(self) -> int:
        return self.clock.at_ns

    @now_ns.setter
    def now_ns(self, t_utc_ns: int) -> None:
        self.clock.at_ns = t_utc_ns

    async def run(self, seconds: float | None = None) -> None:
        """As fast as the wall clock, at the speed that was asked for."""
        loop = asyncio.get_running_loop()
        before_s = end_s = loop.time()
        end_s += seconds or 1e9
        while before_s < end_s:
            await asyncio.sleep(0.1 if self.clock.is_paused else 0.02)
            at_s = loop.time()
            pace = 0.0 if self.clock.is_paused else self.clock.speed
            # On a machine that is too busy for it, time is lost, not made up for.
            self.advance(self.now_ns + round(min(at_s - before_s, MOST_AT_ONCE_S) * pace * NS))
            before_s = at_s

    def advance(self, to_ns: int) -> None:
        """Every sector that ends until then, and where the drones are."""
        for batch in self._engine.until(to_ns):
            for row in range(len(batch)):
                self._report(batch.one(row))
        self.now_ns = to_ns
        if self._observer is not None and to_ns >= self._truth_due_ns:
            self._truth_due_ns = to_ns + TRUTH_EVERY_NS
            self._observer._look_at(self)  # type: ignore[arg-type]
        if to_ns >= self._tracks_due_ns:
            self._tracks_due_ns = to_ns + NS
            self._tell_tracks()

    def stand(self, *, paused: bool = True) -> None:
        """Let its time stand still, or go on."""
        (self.clock.pause if paused else self.clock.resume)()
        if self._observer is not None:
            self._observer._tell_clock()

    async def apply(self, command: dict[str, Any]) -> Mapping[str, Any]:
        self.commands.append(command)
        if self._observer is not None and not command.keys().isdisjoint(OF_SESSION):
            return await self._observer.apply(command)
        for key in ("record", "replay"):
            if key in command:
                self._change_session(key, command[key])
        return {}

    def command(self, command: dict[str, Any]) -> dict[str, Any]:
        """As a session does, whose page's observer asks for it."""
        asked = command_of(command)
        in_force = self._engine.obey(asked, self.now_ns)
        assert self._observer is not None
        known = list(self.sensors)
        for name in self.changes.take_changed():
            layers = joined(self.changes.layers[name])
            sensor = self._engine.sensors.as_of(known.index(name), layers, self.now_ns)
            self.sensors[name].sensor = sensor
            self._observer.settings(sensor)
        self._observer.obeyed(asked, self.now_ns)
        return in_force

    def _control_clock(self, asked: ClockCommand) -> dict[str, Any]:
        if asked.speed is not None:
            self.clock.set_speed(asked.speed)
        if asked.paused is not None:
            self.stand(paused=asked.paused)
        if asked.step_s is not None:
            self.stand()
            self.advance(self.now_ns + round(asked.step_s * NS))
        return {"paused": self.clock.is_paused, "speed": self.clock.speed}

    def _change_session(self, key: str, change: dict[str, Any]) -> None:
        state = dict(self.session[key])
        if key == "record":
            state = {"on": "start" in change, "file": "stage.mcap", "seconds": 0.0}
        elif "stop" in change:
            state = {}
        elif "load" in change:
            state = {"file": change["load"], "position_s": 0.0, "duration_s": 90.0, "paused": False}
        elif "skip_s" in change:
            state["position_s"] += change["skip_s"]
        else:
            state |= change
        self.session[key] = state
        if self.view is not None:
            self.view.session({key: state})

    def _tell_tracks(self) -> None:
        state = self.trajectories.state_at(self.now_ns)
        state = state.rows(np.arange(min(TRACKED, len(state))))
        noise_m = self._rng.normal(0, 8.0, state.position_ecef_m.shape)
        places = np.stack(ecef_to_geodetic(state.position_ecef_m + noise_m), axis=-1).tolist()
        velocity = testing.SITE.rotate_from_ecef(state.velocity_ecef_m_s).tolist()
        if self.view is None or not len(state):
            return
        self.view.tracks(
            [
                ToldTrack(
                    name=str(drone + 1),
                    t_utc_ns=t_utc_ns,
                    latitude_deg=place[0],
                    longitude_deg=place[1],
                    height_m=place[2],
                    velocity_enu_m_s=velocity_m_s,
                    coasted=drone % 11 == 3,
                )
                for drone, t_utc_ns, place, velocity_m_s in zip(
                    state.drone.tolist(), state.t_utc_ns.tolist(), places, velocity, strict=True
                )
            ]
        )

    def _report(self, report: Batch) -> None:
        """A sector; what its links let go leaves a little late, as from a real machine."""
        [messages] = report.messages
        self.totals.add(report.counts)
        self.messages += [one for one in messages if not one.copy]
        for one in messages:
            if one.leaves_utc_ns == HELD_NS:
                continue
            if not one.fate:
                late_ns = int(self._rng.gamma(2, 20_000))
                one.fate, one.sent_utc_ns = pb.SENT, one.leaves_utc_ns + late_ns
            self.totals.settle(one.fate, one.copy, 0, 0)
        if self._observer is not None:
            self._observer.settled(report, records(messages))

"""A session for the page to show, without sockets: real sensors, a link that is made up, controls.

Reports come from the stations themselves; what becomes of their messages is drawn here.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from support.station import Station

from plotfeed import testing
from plotfeed.feeds.engine.scene_drones import launch
from plotfeed.feeds.lab.track_reports import ToldTrack
from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.page.scene_outline import Basemap
from plotfeed.feeds.page.view import View
from plotfeed.feeds.scene.changes import ControlError, changed
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.models.frames import ecef_to_geodetic
from plotfeed.models.truth import Trajectories
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS

TRUTH_EVERY_NS = NS // 10
MOST_AT_ONCE_S = 0.25
TRACKED = 24  # Drones that the imagined tracker has a track of


def sensors(range_max_m: float = 8000.0) -> list[dict[str, Any]]:
    """One of each kind, about the site."""
    polar = testing.radar(
        id="radar",
        report=["asterix-048", "plots"],
        scan=testing.rotating(period_s=2.0, sectors=32),
        range_max_m=range_max_m,
        range_min_m=150.0,
        receive_beams=32,
        elevation_min_deg=-5.0,
        elevation_max_deg=60.0,
        pfa=1e-5,
        power_w=8.0,
        link={"latency_ms": 120.0, "jitter_ms": 25.0},
    )
    del polar["gain_rx_dbi"]
    mimo = {k: v for k, v in polar.items() if k not in ("power_w", "receive_beams", "link")} | {
        "id": "gate",
        "type": "mimo_radar",
        "report": ["asterix-015", "plots"],
        "scan": testing.staring(),
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
        "link": {
            "latency_ms": 60.0,
            "jitter_ms": 10.0,
            "loss": {"kind": "gilbert-elliott", "mean_loss": 0.05, "mean_burst": 3.0},
        },
    }
    microphone = {
        "id": "microphones",
        "type": "acoustic",
        "position_enu_m": [-1500.0, 900.0, 3.0],
        "height_above_ground_m": 1.5,
        "microphones": 8,
        "azimuth_beamwidth_deg": 4.4,
        "noise_db": 0.0,
        "sensitivity_db": 3.0,
        "absorption_db_per_km": 5.0,
        "directivity_db": 3.0,
        "barrier_db": 3.0,
        "misc_db": 3.0,
        "range_max_m": 1500.0,
        "scan": testing.staring(),
    }
    receiver = {
        "id": "receiver",
        "type": "rf",
        "position_enu_m": [-2800.0, -2400.0, 20.0],
        "frequency_min_hz": 2.4e9,
        "frequency_max_hz": 2.5e9,
        "channel_bandwidth_hz": 1e7,
        "integration_s": 1e-3,
        "range_max_m": 6000.0,
        "azimuth_beamwidth_deg": 10.0,
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


class MadeUpSession:
    """The controls of a view, and what drives it: `advance` as far as a time."""

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
        self.now_ns = start_ns
        self.totals = SessionCounters()
        self.session: dict[str, Any] = {
            "clock": {"kind": "simulated", "paused": False, "speed": 1.0},
            "refuses": {},
            "record": {"on": False},
            "replay": {},
            "scenes": ["section-4", shown.scene.name],
            "recordings": ["morning.mcap", "field-day.mcap"],
        }
        self._own: dict[str, Sensor] = {sensor.id: sensor for sensor in shown.sensor}
        self._changes: dict[str, dict[str, Any]] = {}
        self.sensors = dict(self._own)
        # Since when those are on that are, UTC in milliseconds.
        self._stories: dict[str, float | None] = dict.fromkeys(shown.stories)
        self._marks: list[dict[str, Any]] = []
        self._trajectories = Trajectories(stale_after_s=3.0)
        launch(shown, self._trajectories, start_ns)
        self._stations = [Station(shown, sensor, self._trajectories) for sensor in shown.sensor]
        self._next = {s.sensor.id: s.next_sector(s.sector_at(start_ns)) for s in self._stations}
        self._numbers = dict.fromkeys(self._own, 0)
        self._bad = dict.fromkeys(self._own, False)
        self._rng = np.random.default_rng(1)
        self._truth_due_ns = self._tracks_due_ns = start_ns
        self.totals.drones = len(shown.drone)
        if view is not None:
            view.scene(shown, basemap)
            view.session(self.session)
            for sensor in shown.sensor:
                self._tell_settings(sensor)
            self._tell_stories()

    async def run(self, seconds: float | None = None) -> None:
        """As fast as the wall clock, at the speed that was asked for."""
        loop = asyncio.get_running_loop()
        before_s = end_s = loop.time()
        end_s += seconds or 1e9
        while before_s < end_s:
            await asyncio.sleep(0.1 if self.session["clock"]["paused"] else 0.02)
            at_s, clock = loop.time(), self.session["clock"]
            pace = 0.0 if clock["paused"] else clock["speed"]
            # On a machine that is too busy for it, time is lost, not made up for.
            self.advance(self.now_ns + round(min(at_s - before_s, MOST_AT_ONCE_S) * pace * NS))
            before_s = at_s

    def advance(self, to_ns: int) -> None:
        """Every sector that ends until then, and where the drones are."""
        for station in self._stations:
            sector = self._next[station.sensor.id]
            while sector.end_ns <= to_ns:
                if self.sensors[station.sensor.id].enabled:
                    self._report(station.report(sector))
                sector = station.next_sector(sector)
            self._next[station.sensor.id] = sector
        self.now_ns = to_ns
        if to_ns >= self._truth_due_ns:
            self._truth_due_ns = to_ns + TRUTH_EVERY_NS
            self._tell_truth()
        if to_ns >= self._tracks_due_ns:
            self._tracks_due_ns = to_ns + NS
            self._tell_tracks()

    def stand(self, *, paused: bool = True) -> None:
        """Let its time stand still, or go on."""
        self._change_session("clock", {"paused": paused})

    async def apply(self, command: dict[str, Any]) -> Mapping[str, Any]:
        self.commands.append(command)
        name = command.get("sensor")
        if name is not None:
            return self._change(name, command)
        if "story" in command:
            self._tell_story(command)
        for key in ("clock", "record", "replay"):
            if key in command:
                self._change_session(key, command[key])
        return {}

    def _change(self, name: str, command: dict[str, Any]) -> dict[str, Any]:
        if name not in self._own:
            raise ControlError(f"sensor: there is no {name!r}")
        changes = {} if command.get("reset") else self._changes.get(name, {}) | command["set"]
        sensor = changed(self._own[name], changes)
        self._changes[name] = changes
        self.sensors[name] = sensor
        (station,) = (s for s in self._stations if s.sensor.id == name)
        station.change(sensor)
        self._tell_settings(sensor)
        return sensor.model_dump(mode="json", exclude_unset=True)

    def _tell_story(self, command: dict[str, Any]) -> None:
        story = self.scene.stories[command["story"]]
        for sensor, keys in story.sets.items():
            self._change(sensor, {"reset": True} if command.get("reset") else {"set": keys})
        self._stories[story.id] = None if command.get("reset") else self.now_ns / 1e6
        words = f"{story.title}{', taken back' if command.get('reset') else ''}"
        self._marks.append({"t_utc_ms": self.now_ns / 1e6, "kind": "story", "words": words})
        self._tell_stories(words)

    def _tell_stories(self, undoes: str = "") -> None:
        if self.view is None:
            return
        told = [
            {
                "id": story.id,
                "title": story.title,
                "text": story.text,
                "sensors": list(story.sets),
                "since_utc_ms": self._stories[story.id],
            }
            for story in self.scene.stories.values()
        ]
        self.view.tell(stories=told, undoes=undoes)
        self.view.tell(marks=list(self._marks))

    def _change_session(self, key: str, change: dict[str, Any]) -> None:
        state = dict(self.session[key])
        if key == "record":
            state = {"on": "start" in change, "file": "stage.mcap", "seconds": 0.0}
        elif key == "replay" and "stop" in change:
            state = {}
        elif key == "replay" and "load" in change:
            state = {"file": change["load"], "position_s": 0.0, "duration_s": 90.0, "paused": False}
        elif "skip_s" in change:
            state["position_s"] += change["skip_s"]
        elif "step_s" in change:
            state["paused"] = True
            self.advance(self.now_ns + round(change["step_s"] * NS))
        else:
            state |= change
        self.session[key] = state
        if self.view is not None:
            self.view.session({key: state})

    def _tell_settings(self, sensor: Sensor) -> None:
        if self.view is None:
            return
        link = sensor.link
        asked = np.zeros(0)
        if link is not None:
            normal = np.random.default_rng(0).standard_normal(4000)
            asked = np.maximum(link.latency_ms + link.jitter_ms * normal, 0)
        in_force = sensor.model_dump(mode="json", exclude_unset=True, exclude={"event"})
        self.view.settings(sensor.id, in_force, asked_latency_ms=asked)

    def _tell_truth(self) -> None:
        state = self._trajectories.state_at(self.now_ns)
        if self.view is not None:
            self.view.truth(self.now_ns, state, self._trajectories.names)
            self.view.totals(self.totals)

    def _tell_tracks(self) -> None:
        state = self._trajectories.state_at(self.now_ns)
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
        [counts], [outgoing] = report.counts, report.messages
        messages = [one.handed for one in outgoing]
        self.totals.add([counts])
        self.messages += messages
        sent = [self._sent(report, message.topic) for message in messages]
        if self.view is not None:
            self.view.report(report)
            self.view.settled(report, sent)

    def _sent(self, report: Batch, topic: str) -> pb.Sent:
        link = self.sensors[report.sensor].link
        number = self._numbers[report.sensor]
        self._numbers[report.sensor] += 1
        due_ns = report.sector.end_ns
        lost = link is not None and link.loss is not None and self._lose(report.sensor, link.loss)
        self.totals.lost += lost
        self.totals.messages += not lost
        delay_ms = 0.0
        if link is not None:
            delay_ms = max(link.latency_ms + link.jitter_ms * self._rng.standard_normal(), 0.0)
        leaves_ns = due_ns + round(delay_ms * 1e6)
        return pb.Sent(
            topic=topic,
            due_utc_ns=due_ns,
            link_due_utc_ns=leaves_ns,
            sent_utc_ns=0 if lost else leaves_ns + int(self._rng.gamma(2, 20_000)),
            delivered=not lost,
            fate=pb.LOST if lost else pb.SENT,
            number=number,
        )

    def _lose(self, sensor: str, loss: Any) -> bool:
        if loss.kind == "random":
            return bool(self._rng.random() < loss.probability)
        p, r, good, bad = loss.probabilities
        change = self._rng.random() < (r if self._bad[sensor] else p)
        self._bad[sensor] ^= bool(change)
        return bool(self._rng.random() < (bad if self._bad[sensor] else good))

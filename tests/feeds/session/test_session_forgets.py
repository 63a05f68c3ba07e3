"""A session into which new drones come all the time: flat, and those that stay as they were."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import numpy as np
from support.held_sizes import held
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.page.view import View
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.session.observer import Observer, RunningSession
from plotfeed.feeds.session.session import run
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.models.state import AltitudeReference
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import entries_in
from plotfeed.proto.utc import NS

FAR = -1  # A place on the other half of the Earth
FORGET = "forget_after_s = 5\nstale_after_s = 1"
REPORTED = 'report = ["asterix-048", "asterix-062", "plots"]'
SENSORS = radar("alone", sectors=4, more=REPORTED) + "".join(
    radar(f"radar{i}", sectors=4, more='report = ["asterix-048", "plots"]') for i in range(3)
)


def scene_of(folder: Path) -> Scene:
    text = scene_text(
        start_utc="2026-01-01T12:00:00Z", telemetry=FORGET, sensors=SENSORS, drones="", port=1883
    )
    return load(scene_file(folder, text))


def report(t_utc_ns: int, place: int) -> bytes:
    return PositionReport.to_protobuf(
        PositionReport(
            t_utc_ns=t_utc_ns,
            latitude_deg=-40.0 if place == FAR else 40.46 + 1e-4 * (place % 50),
            longitude_deg=-3.72 + 1e-4 * (place // 50 % 50),
            altitude_m=900.0,
            altitude_reference=AltitudeReference.ELLIPSOID,
            velocity_enu_m_s=(0.0, 0.0, 0.0),
        )
    )


class Traffic(Observer):
    """Four times a second reports of drones that are named by the time since the beginning."""

    wants_ledger = True

    def __init__(self, drones_at: Callable[[float], list[tuple[str, int]]]) -> None:
        self._drones_at = drones_at
        self.messages: list[tuple[str, int, bytes]] = []
        self.entries: list[pb.Ledger] = []
        self.sizes: list[int] = []
        self.known: list[int] = []
        self.view = View()

    def begun(self, session: RunningSession) -> None:
        self._session = session
        self._begin_ns = self._next_ns = session.clock.now_ns()
        self.view.scene(session.scene)

    def next_input_ns(self) -> int:
        return self._next_ns

    def before_due(self, due_utc_ns: int) -> None:
        while self._next_ns < due_utc_ns:
            now_ns, self._next_ns = self._next_ns, self._next_ns + NS // 4
            since_s = (now_ns - self._begin_ns) / NS
            inputs = [
                (f"plotfeed/telemetry/{drone}", report(now_ns, place), None)
                for drone, place in self._drones_at(since_s)
            ]
            if inputs:
                self._session.receive(inputs, now_ns)
            if since_s % 5.0 == 0.0:
                trajectories = self._session.trajectories
                state = trajectories.state_at(now_ns)
                self.view.truth(now_ns, state, trajectories.names)
                self.view.update(now_ns, since_s)
                self.known.append(len(trajectories))
                self.sizes.append(held(self._session, self.view))

    def after_link(self, message: Message, sent_utc_ns: int) -> None:
        if not message.topic.endswith("/status"):  # which counts drones
            self.messages.append((message.topic, sent_utc_ns, message.payload))

    def ledger(self, message: Message) -> None:
        self.entries += entries_in(message.payload)


def flown(scene: Scene, traffic: Traffic, seconds: float) -> SessionCounters:
    clock = InstantClock(scene.scene.start_utc_ns)
    return asyncio.run(
        run(scene, clock=clock, broker="none", duration_s=seconds, observers=[traffic])
    )


def test_hundreds_of_names_that_come_and_go_leave_a_session_and_its_page_as_they_were(
    tmp_path: Path,
) -> None:
    """Ten new drones a second for 30 s, each for a second, and then none but one."""

    def drones_at(since_s: float) -> list[tuple[str, int]]:
        if since_s >= 30.0:
            return [("stays", 0)]
        second = int(since_s)
        return [("stays", 0), *((f"d{second}-{i}", 10 * second + i) for i in range(10))]

    traffic = Traffic(drones_at)
    totals = flown(scene_of(tmp_path), traffic, 45.0)
    assert totals.forgotten == 300
    assert totals.drones == 1
    assert max(traffic.known) < 100
    quiet = Traffic(lambda _: [("stays", 0)])
    flown(scene_of(tmp_path), quiet, 45.0)
    steady = traffic.sizes[2:6]
    assert max(steady) < 1.3 * np.median(steady), "flat, but for buffers that fill and empty"
    assert traffic.sizes[-1] < 1.2 * quiet.sizes[-1]
    # Whose plots and looks they were is told by the names that they had then.
    told = {look.drone for entry in traffic.entries for look in entry.looks}
    assert "" not in told
    assert len(told) == 301
    last_s = {}
    for entry in traffic.entries:
        for look in entry.looks:
            last_s[look.drone] = look.time_utc_ns
    start_ns = scene_of(tmp_path).scene.start_utc_ns
    assert start_ns is not None
    for drone, t_utc_ns in last_s.items():
        if drone != "stays":
            second = int(drone[1:].partition("-")[0])
            assert second <= (t_utc_ns - start_ns) / NS <= second + 2.0


def test_the_bytes_of_drones_that_stay_are_the_same_whether_others_are_forgotten_or_never_came(
    tmp_path: Path,
) -> None:
    """Those that go are out of every sensor's reach, so that only their rows might tell."""

    def drones_at(others: int, since_s: float) -> list[tuple[str, int]]:
        found = [("stays", 7), ("too", 99)]
        if since_s < 3.0:
            return found
        return found + [(f"far{int(since_s / 3)}-{i}", FAR) for i in range(others)]

    alone = Traffic(lambda since_s: drones_at(0, since_s))
    among = Traffic(lambda since_s: drones_at(40, since_s))
    scene = scene_of(tmp_path)
    flown(scene, alone, 20.0)
    totals = flown(scene, among, 20.0)
    assert totals.forgotten > 100
    assert len(alone.messages) > 300
    assert among.messages == alone.messages

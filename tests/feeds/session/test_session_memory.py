"""What a session keeps does not grow with its hours, nor with drones that come all the time."""

from __future__ import annotations

import asyncio
import gc
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
from support.held_sizes import held
from support.scene_files import radar, scene_file, scene_text
from support.sessions import AtWork, simulated

from plotfeed.feeds.page.view import View
from plotfeed.feeds.recording.recorder import Recorder, SessionRecorder
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.session.observer import Observer, RunningSession
from plotfeed.feeds.session.session import run
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.utc import NS

FAR = -1  # A place on the other half of the Earth
FORGET = "forget_after_s = 5\nstale_after_s = 1"
REPORTED = 'report = ["asterix-048", "asterix-062", "plots"]'
PLOTS = 'report = ["asterix-048", "plots"]'
SENSORS = radar("alone", sectors=4, more=REPORTED) + "".join(
    radar(f"radar{i}", sectors=4, more=PLOTS) for i in range(3)
)


def scene_of(folder: Path, sensors: str = SENSORS, telemetry: str = FORGET) -> Scene:
    text = {"sensors": sensors, "telemetry": telemetry, "drones": ""}
    return load(scene_file(folder, scene_text(start_utc="2026-01-01T12:00:00Z", port=1883, **text)))


def report(t_utc_ns: int, place: int) -> bytes:
    """Of a drone that stands there."""
    latitude_deg = -40.0 if place == FAR else 40.46 + 1e-4 * (place % 50)
    at = latitude_deg, -3.72 + 1e-4 * (place // 50 % 50), 900.0, AltitudeReference.ELLIPSOID
    return PositionReport(t_utc_ns, *at, (0.0, 0.0, 0.0)).to_protobuf()


Named = Callable[[float], list[tuple[str, int]]]  # Drones and their places at a time


class Sizes(Observer):
    """What a session and its page hold, every two seconds and a half."""

    def __init__(self) -> None:
        self.sizes: list[int] = []
        self.known: list[int] = []
        self.view = View()

    def begun(self, session: RunningSession) -> None:
        self._session = session
        self._begin_ns = self._next_ns = session.clock.now_ns()
        self.view.scene(session.scene)

    def before_due(self, due_utc_ns: int) -> None:
        while self._next_ns < due_utc_ns:
            now_ns, self._next_ns = self._next_ns, self._next_ns + 5 * NS // 2
            trajectories = self._session.trajectories
            self.view.truth(now_ns, trajectories.state_at(now_ns), trajectories.names)
            self.view.update(now_ns, (now_ns - self._begin_ns) / NS)
            self.known.append(len(trajectories))
            self.sizes.append(held(self._session, self.view))


def flown(scene: Scene, drones_at: Named, seconds: float) -> tuple[AtWork, Sizes]:
    """With reports of drones four times a second."""
    start_ns, sizes = scene.scene.start_utc_ns or 0, Sizes()
    times_s = [quarter / 4 for quarter in range(round(4 * seconds))]
    asked = [
        (at_s, f"plotfeed/telemetry/{drone}", report(start_ns + round(at_s * NS), place))
        for at_s in times_s
        for drone, place in drones_at(at_s)
    ]
    return simulated(scene, seconds, asked, sizes), sizes


def test_hundreds_of_names_that_come_and_go_leave_a_session_and_its_page_as_they_were(
    tmp_path: Path,
) -> None:
    """Ten new drones a second for 20 s, each for a second, and then none but one."""

    def drones_at(since_s: float) -> list[tuple[str, int]]:
        if since_s >= 20.0:
            return [("stays", 0)]
        second = int(since_s)
        return [("stays", 0), *((f"d{second}-{i}", 10 * second + i) for i in range(10))]

    (ran, traffic), (_, quiet) = (
        flown(scene_of(tmp_path), of, 32.0) for of in (drones_at, lambda _: [("stays", 0)])
    )
    assert (ran.totals.forgotten, ran.totals.drones) == (200, 1)
    assert max(traffic.known) < 100
    steady = traffic.sizes[4:8]
    assert max(steady) < 1.3 * np.median(steady), "flat, but for buffers that fill and empty"
    assert traffic.sizes[-1] < 1.2 * quiet.sizes[-1]
    # Whose plots and looks they were is told by the names that they had then.
    last_s = {
        look.drone: (look.time_utc_ns - ran.start_ns) / NS
        for entry in ran.entries
        for look in entry.looks
    }
    assert "" not in last_s
    assert len(last_s) == 201
    for drone, at_s in last_s.items():
        if drone != "stays":
            second = int(drone[1:].partition("-")[0])
            assert second <= at_s <= second + 2.0


def test_the_bytes_of_drones_that_stay_are_the_same_whether_others_are_forgotten_or_never_came(
    tmp_path: Path,
) -> None:
    """Those that go are out of every sensor's reach, so that only their rows might tell."""

    def drones_at(others: int, since_s: float) -> list[tuple[str, int]]:
        found = [("stays", 7), ("too", 99)]
        if since_s < 3.0:
            return found
        return found + [(f"far{int(since_s / 3)}-{i}", FAR) for i in range(others)]

    scene = scene_of(tmp_path)
    alone, among = (
        flown(scene, lambda since_s, others=others: drones_at(others, since_s), 14.0)[0]  # type: ignore[misc]
        for others in (0, 40)
    )
    assert among.totals.forgotten >= 40
    said = [
        [(m.topic, t_ns, m.payload) for m, t_ns in ran.said if not m.topic.endswith("/status")]
        for ran in (alone, among)
    ]
    assert len(said[0]) > 200
    assert said[0] == said[1]


# Objects that a session keeps are counted, stretch after stretch.

STRETCH_S, STRETCHES, WARM = 40, 4, 2  # A drone's track is kept for a minute
DRONES, TELEMETRY_HZ = 4, 5
LINK = """
[sensor.link]
latency_ms = 50.0
jitter_ms = 10.0
duplicate = 0.05
loss = { kind = "random", probability = 0.05 }
"""


class Census(Observer):
    """Flies drones by telemetry, one report in fifty garbage, and counts objects now and then."""

    def __init__(self) -> None:
        # The least of each stretch: a chunk of a recording is kept until it is written.
        self.blocks: list[int] = []
        self.objects: list[Counter[type]] = []
        self.entries = 0

    def begun(self, session: RunningSession) -> None:
        self._session = session
        self._telemetry_ns = session.clock.now_ns()
        self._count_ns = self._telemetry_ns + STRETCH_S * NS
        self._least = sys.maxsize
        self._reports = 0

    def settled(self, *_: object) -> None:
        self.entries += 1

    def before_due(self, due_utc_ns: int) -> None:
        while self._telemetry_ns < due_utc_ns:
            for drone in range(DRONES):
                self._reports += 1
                is_garbage = self._reports % 50 == 0
                said = b"garbage" if is_garbage else report(self._telemetry_ns, drone)
                told = f"plotfeed/telemetry/d{drone}", said, None
                self._session.intake.receive([told], self._telemetry_ns)
            self._telemetry_ns += NS // TELEMETRY_HZ
            self._least = min(self._least, sys.getallocatedblocks())
        if due_utc_ns >= self._count_ns:
            self._count_ns += STRETCH_S * NS
            gc.collect()
            self.objects.append(Counter(type(each) for each in gc.get_objects()))
            self.blocks.append(self._least)
            self._least = sys.maxsize


def test_time_leaves_nothing_behind(tmp_path: Path) -> None:
    """In a session, or in who records it."""
    sensors = "".join(radar(f"radar{i}", more=PLOTS) + LINK for i in range(2))
    what, census, for_s = scene_of(tmp_path, sensors, ""), Census(), STRETCH_S * STRETCHES + 2.0
    with Recorder(tmp_path / "session.mcap") as recorder:
        observers = [census, SessionRecorder(recorder, ledger_is_sent=True)]
        clock = InstantClock(what.scene.start_utc_ns)
        running = run(what, clock=clock, broker="none", duration_s=for_s, observers=observers)
        totals = asyncio.run(running)
    assert census.entries > 10 * STRETCH_S * STRETCHES
    assert totals.telemetry > 0.9 * STRETCH_S * STRETCHES * DRONES * TELEMETRY_HZ
    assert totals.refused > 30
    assert len(census.blocks) == STRETCHES
    # What is kept up to a bound grows by the scan: 1,400 to 3,300 blocks, in four runs. By the
    # sector or message nothing does, which would add a block for each at the least.
    grown = census.objects[-1] - census.objects[WARM - 1]
    sectors = census.entries * (STRETCHES - WARM) // STRETCHES
    assert census.blocks[-1] - census.blocks[WARM - 1] < 0.9 * sectors
    assert max(grown.values(), default=0) < 0.1 * sectors, grown.most_common(8)

"""How names come in and go: no flood of them keeps others out, and none is held for ever."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.held_sizes import held
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.engine.scene_drones import trajectories_of
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.telemetry.fair_queue import FairQueue
from plotfeed.feeds.telemetry.position_report import PositionReport, Reason
from plotfeed.feeds.telemetry.receiver import TelemetryReceiver, look_back_s
from plotfeed.models.state import AltitudeReference

S, TICK_NS = 1_000_000_000, 10_000_000
NOW = 1_767_268_800 * S


def report(t_utc_ns: int) -> bytes:
    return PositionReport.to_protobuf(
        PositionReport(
            t_utc_ns=t_utc_ns,
            latitude_deg=40.46,
            longitude_deg=-3.72,
            altitude_m=900.0,
            altitude_reference=AltitudeReference.ELLIPSOID,
            velocity_enu_m_s=(0.0, 0.0, 0.0),
        )
    )


class Door:
    """What takes telemetry in, with a queue before it, tick by tick."""

    def __init__(self, scene: Scene) -> None:
        self.trajectories, self.queue = trajectories_of(scene), FairQueue()
        self.receiver = TelemetryReceiver(scene, self.trajectories)
        self.receiver.welcome, self.receiver.part_with = self.queue.know, self.queue.forget
        self.now_ns, self.told = NOW, list[dict[str, str]]()

    def tick(self, *drones: str) -> None:
        """A report of each comes, and is taken in."""
        self.now_ns += TICK_NS
        for drone in drones:
            self.queue.put(f"plotfeed/telemetry/{drone}", report(self.now_ns - 1), None)
        while self.queue:
            for refusal in self.receiver.take_together(self.queue.take(128), self.now_ns):
                self.told.append(json.loads(refusal.payload))

    def wait(self, seconds: float) -> None:
        self.now_ns += round(seconds * S)
        self.receiver.forget_gone(self.now_ns)

    @property
    def known(self) -> set[str]:
        return {name for name in self.trajectories.names if name}


def scene_of(folder: Path, telemetry: str = "") -> Scene:
    sensors = radar(period_s=1.0, sectors=32)
    text = scene_text(telemetry=telemetry, port=1883, drones="", sensors=sensors)
    return load(scene_file(folder, text))


def test_a_drone_without_news_is_forgotten_after_the_time_that_the_scene_says(
    tmp_path: Path,
) -> None:
    door = Door(scene_of(tmp_path, "forget_after_s = 20"))
    door.tick("a", "once")
    door.tick("a")
    door.wait(8.0)
    assert door.known == {"a"}, "one that reported once goes when no sensor can see it"
    door.wait(11.0)
    assert door.known == {"a"}
    door.wait(2.0)
    assert door.known == set()
    assert door.receiver.forgotten == 2
    door.tick("a")
    assert door.known == {"a"}, "and may come again"


def test_no_drone_is_forgotten_that_some_sensor_can_still_see(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, "forget_after_s = 1\nstale_after_s = 10")
    door = Door(scene)
    door.tick("a")
    door.tick("a")
    door.wait(10.0 + look_back_s(scene) - 0.1)
    assert door.known == {"a"}


@pytest.mark.parametrize("names_per_tick", [15, 60])
def test_a_flood_of_names_that_report_once_locks_nobody_out(
    tmp_path: Path, names_per_tick: int
) -> None:
    """Drones at 10 Hz that were there stay, those that come get in, with room for a hundred."""
    door, came_in_s = Door(scene_of(tmp_path, "max_drones = 100")), list[float]()
    door.tick("before")
    for tick in range(200):
        flood = [f"flood{tick} {i}" for i in range(names_per_tick)]
        if tick % 10 == 0:
            half = names_per_tick // 2
            flood[half:half] = ["before", "late"] if tick >= 80 else ["before"]
        door.tick(*flood)
        assert len(door.known) <= 100
        assert "before" in door.known
        if "late" in door.known:
            came_in_s.append((tick - 80) / 100)
    assert came_in_s[0] <= 1.0
    assert "late" in door.known
    assert door.receiver.refusals[Reason.TOO_MANY_NEW_DRONES] > 100


def test_after_as_many_names_in_a_second_as_there_is_room_a_new_drone_gets_in_at_once(
    tmp_path: Path,
) -> None:
    door = Door(scene_of(tmp_path, "max_new_drones_per_s = 1000000\nmax_drones = 1000"))
    for first in range(0, 1000, 50):
        door.tick(*(f"d{i}" for i in range(first, first + 50)))
    assert len(door.known) == 1000
    door.tick("new")
    assert "new" in door.known
    assert "d0" not in door.known, "the first of those that reported once gives way"
    door.wait(30.0)
    assert door.known == set()
    assert len(door.trajectories.names) == 0


def test_where_all_are_established_and_there_a_new_drone_waits_until_one_is_gone(
    tmp_path: Path,
) -> None:
    door = Door(scene_of(tmp_path, "max_drones = 3"))
    for _ in range(2):
        door.tick("a", "b", "c")
    door.tick("d")
    assert door.known == {"a", "b", "c"}
    assert door.told[-1]["reason"] == "too_many_drones"
    for _ in range(60):
        door.now_ns += S // 10
        door.tick("a", "b")
    door.tick("d")
    assert door.known == {"a", "b", "d"}, "c was gone, if not forgotten yet"


def test_names_beyond_the_rate_get_in_as_they_come_again(tmp_path: Path) -> None:
    door = Door(scene_of(tmp_path, "max_new_drones_per_s = 20"))
    swarm = [f"d{i}" for i in range(120)]
    for _ in range(45):
        door.now_ns += S // 10 - TICK_NS
        door.tick(*swarm)
    assert door.known == set(swarm)
    assert 20 * 5 - 20 < door.receiver.refusals[Reason.TOO_MANY_NEW_DRONES] < 120 * 45


def test_hours_of_new_names_leave_nothing_behind(tmp_path: Path) -> None:
    """Whatever the intake holds: names, courses, samples, queues, refusals."""
    door, sizes = Door(scene_of(tmp_path)), []
    for hour in range(12):
        for quarter in range(4):
            names = [f"{hour}-{quarter}-{i}" for i in range(100)]
            for _ in range(2 if hour % 2 else 1):
                door.tick(*names, "stays")
            door.wait(899.0)
        sizes.append(held(door.receiver, door.trajectories, door.queue))
    assert door.receiver.taken > 4800
    assert len(door.known) == 0
    assert max(sizes[2:]) <= 1.05 * np.median(sizes[:4])
    assert door.receiver.forgotten == 12 * 4 * 101

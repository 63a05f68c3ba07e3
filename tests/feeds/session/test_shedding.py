"""More to do than there is time for: whole scans are left out in turn, the rest is on time."""

from __future__ import annotations

import asyncio
import json
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.proto.utc import NS

START = "2026-01-01T12:00:00Z"
IN_STEP = "".join(radar(f"r{i:02}", period_s=1.0, sectors=32) for i in range(12))
QUICK = "".join(radar(f"r{i:02}", period_s=0.2, sectors=4) for i in range(12))
PERIODS = "".join(radar(f"r{i:02}", period_s=1.0 + 0.13 * i, sectors=16) for i in range(12))


class Machine(InstantClock):
    """Time goes by while sectors are worked out, and only then; for a while three times as fast.

    With a swing, what each batch costs is log-normal, with that standard deviation.
    """

    leaps = False

    def __init__(
        self,
        start_utc_ns: int,
        cost_ns: int,
        monkeypatch: pytest.MonkeyPatch,
        slow_s: tuple[float, float] = (0.0, 0.0),
        swing: float = 0.0,
    ) -> None:
        super().__init__(start_utc_ns)
        until = Engine.until
        rng = np.random.default_rng(1)

        def costly(engine: Engine, t_utc_ns: int) -> Iterator[Batch]:
            for batch in until(engine, t_utc_ns):
                is_slow = slow_s[0] <= (self.now_ns() - start_utc_ns) / NS < slow_s[1]
                times = rng.lognormal(0.0, swing) * (3 if is_slow else 1)
                self.jump(self.now_ns() + round(cost_ns * len(batch) * times))
                yield batch

        monkeypatch.setattr(Engine, "until", costly)


class Sent(Observer):
    """What was sent of each scan, how late, and what sensors say that they missed."""

    def __init__(self, clock: InstantClock) -> None:
        self.clock = clock
        self.late_ns: list[int] = []
        self.sectors: dict[str, Counter[int]] = defaultdict(Counter)
        self.missed: dict[str, int] = {}

    def report(self, batch: Batch) -> None:
        self.sectors[batch.sensor][batch.sector.scan] += 1
        self.late_ns.append(self.clock.now_ns() - batch.due_utc_ns)

    def after_link(self, message: Message, _sent_utc_ns: int) -> None:
        if message.topic.endswith("/status"):
            told = json.loads(message.payload)
            self.missed[told["sensor"]] = int(told["missed_scans"])


def loaded(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    sensors: str,
    times: float,
    duration_s: float,
    *,
    slow_s: tuple[float, float] = (0.0, 0.0),
    swing: float = 0.0,
) -> tuple[Sent, SessionCounters]:
    """A session that has so many times as much to do as it can, and more for a while."""
    text = scene_text(start_utc=START, sensors=sensors, port=1, drones="")
    scene = load(scene_file(folder, text))
    per_s = sum(s.scan.sectors / s.scan.period_s for s in scene.sensor)
    cost_ns = round(times * NS / per_s)
    clock = Machine(scene.scene.start_utc_ns or 0, cost_ns, monkeypatch, slow_s, swing)
    sent = Sent(clock)
    running = run(scene, clock=clock, broker="none", duration_s=duration_s, observers=[sent])
    return sent, asyncio.run(running)


@pytest.mark.parametrize(("sensors", "times"), [(IN_STEP, 5.0), (QUICK, 1.3), (PERIODS, 2.0)])
def test_whole_scans_are_left_out_in_turn_and_what_is_sent_is_on_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sensors: str, times: float
) -> None:
    sent, totals = loaded(tmp_path, monkeypatch, sensors, times, 30.0)
    assert float(np.median(sent.late_ns)) <= 0.05 * NS
    # It is told, and nobody has lost more than two or three scans beyond the share that all lose.
    assert sum(sent.missed.values()) == totals.missed_scans > 0
    sensors_of = load(tmp_path / "scene.toml").sensor
    scans = {s.id: 30.0 / s.scan.period_s for s in sensors_of}
    missed = np.array([sent.missed[name] for name in scans])
    all_scans = np.array([*scans.values()])
    assert abs(missed - all_scans * missed.sum() / all_scans.sum()).max() <= 2.5
    # Most scans that are sent are whole, and none starves.
    for sensor in sensors_of:
        found = sent.sectors[sensor.id]
        whole = [scan for scan, n in found.items() if n == sensor.scan.sectors]
        assert len(whole) >= 0.9 * len(found) - 2
        assert max(np.diff(sorted(whole))) <= 4 * times / 0.85 + 2
    # What there is time for is done.
    done = sum(map(len, sent.sectors.values())) / all_scans.sum()
    assert done >= 0.7 / times


def test_what_is_sent_is_on_time_although_what_a_sector_costs_varies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent, _ = loaded(tmp_path, monkeypatch, PERIODS, 3.0, 30.0, swing=0.5)
    assert float(np.median(sent.late_ns)) <= 0.05 * NS


@pytest.mark.parametrize("slow_s", [(0.0, 0.0), (3.0, 6.0)])
def test_nothing_is_left_out_while_there_is_time_for_all_or_once_there_is_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, slow_s: tuple[float, float]
) -> None:
    """However little time is to spare: what was late is given up, and not made up for."""
    sent, totals = loaded(tmp_path, monkeypatch, IN_STEP, 0.92, 20.0, slow_s=slow_s)
    assert (totals.missed_scans > 0) == (slow_s[1] > 0)
    first = min(min(found) for found in sent.sectors.values())
    for found in sent.sectors.values():
        for scan in range(first + (10 if totals.missed_scans else 1), first + 19):
            assert found[scan] == 32

"""What a session sends, the same at any pace and however late the machine; and how it ends."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from support.own_time import LoopClock, in_own_time
from support.scene_files import radar, scene_file, scene_text
from support.sessions import AtWork, StallingClock, at_work, simulated
from support.significance import Array, assert_chance

from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import MOST_BEHIND_NS, Clock, WallClock
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS

START = "2026-01-01T11:59:58.05Z"
TURN = radar(period_s=1.0, sectors=16)
STARING = radar(period_s=0.4).replace("rotating", "staring").replace("sectors = 8", "")
LONG = {"period_s": 6.0, "sectors": 240}  # A turn that no stall of the machine is as long as
LINKS = {
    "lossy": """
latency_ms = 120.0
jitter_ms = 80.0
delay_correlation = 0.4
duplicate = 0.2
corrupt = 0.1
loss = { kind = "gilbert-elliott", mean_loss = 0.2, mean_burst = 3.0 }
""",
    "narrow": """
rate_kbit_s = 24.0
queue_messages = 6
jitter_ms = 30.0
distribution = "pareto"
in_order = true
""",
    "stalled": """
latency_ms = 30.0
on_loss = "stall"
loss = { kind = "random", probability = 0.1 }
""",
}
EVENTS = """
[[sensor.event]]
from_s = 0.3
to_s = 0.55
set = { link = { down = true } }
[[sensor.event]]
from_s = 0.65
to_s = 0.95
set = { pfa_factor = 100, link = { latency_ms = 400.0 } }
[[sensor.event]]
from_s = 1.1
to_s = 1.25
set = { enabled = false }
"""


def scene(folder: Path, sensors: str, **changes: str) -> Scene:
    text = {"start_utc": START, "sensors": sensors, **changes}
    return load(scene_file(folder, scene_text(**text, port=1883)))


def impaired(**scan: float) -> str:
    """A radar behind each of the links."""
    return "".join(
        f"{radar(name, **scan)}[sensor.link]{link}{EVENTS}"  # type: ignore[arg-type]
        for name, link in LINKS.items()
    )


def start_of(what: Scene) -> int:
    return what.scene.start_utc_ns or 0


def batches(ran: AtWork) -> dict[tuple[int, int], bytes]:
    """Payloads of batches of plots by scan and sector, of which none is sent twice."""
    payloads = ran.on("radar/plots")
    found = {(b.scan, b.sector): p for p in payloads for b in [pb.PlotBatch.FromString(p)]}
    assert len(found) == len(payloads)
    return found


def assert_same(one: AtWork, another: AtWork) -> None:
    """To trackers, in the ledger but for when messages left, and as it was counted."""
    of_time = {"lateness_ns", "speed", "speed_reached"}

    def all_of(ran: AtWork) -> list[object]:
        ledger: dict[str, list[pb.Ledger]] = {}
        for entry in ran.entries:
            for sent in entry.messages:
                sent.ClearField("sent_utc_ns")
            ledger.setdefault(entry.sensor, []).append(entry)
        counts = {n: getattr(ran.totals, n) for n in ran.totals.__slots__ if n not in of_time}
        return [ran.reported, ledger, counts]

    for mine, theirs in zip(all_of(one), all_of(another), strict=True):
        assert mine == theirs


class LateClock(StallingClock):
    """A machine that oversleeps every time by chance, and once stands still."""

    def __init__(
        self, start_utc_ns: int, mean_s: float = 0.002, *, after_s: float = 1e6, for_s: float = 0.0
    ) -> None:
        super().__init__(start_utc_ns, after_s, for_s)
        self._rng, self._mean_s = np.random.default_rng(5), mean_s

    async def sleep_until(self, t_utc_ns: int, *, exactly: bool = True) -> None:
        if self.now_ns() < t_utc_ns:
            t_utc_ns += round(self._rng.exponential(self._mean_s) * NS)
        await super().sleep_until(t_utc_ns, exactly=exactly)


class SlowClock(LateClock):
    """A machine on which time goes by while it works, a tick's worth for a sensor."""

    def left_ns(self, t_utc_ns: int) -> int:
        self.jump(self.now_ns() + round(self._rng.exponential(0.01) * NS))
        return t_utc_ns - self.now_ns()


# And how late it is at least, of which the third has an event end after the next one has begun.
MACHINES: dict[str, tuple[Callable[[int], Clock], float]] = {
    "in real time": (WallClock, 0.0),
    "late": (LateClock, 0.002),
    "later than an event lasts": (lambda start_ns: LateClock(start_ns, 0.15), 0.15),
    "slow": (SlowClock, 0.002),
}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, AtWork]:
    """A scene with every kind of link and event, and what is sent of it."""
    folder = tmp_path_factory.mktemp("scene")
    what = scene(folder, impaired(**LONG) + radar("clear", **LONG))  # type: ignore[arg-type]
    ran = simulated(what, 1.5)
    assert {one.fate for one in ran.sent} == {pb.SENT, pb.LOST, pb.OUTAGE, pb.QUEUE_FULL}
    assert ran.totals.duplicated > 5
    return what, ran


@pytest.mark.parametrize("machine", MACHINES)
def test_links_and_events_do_the_same_on_every_machine(
    machine: str, undisturbed: tuple[Scene, AtWork]
) -> None:
    what, expected = undisturbed
    clock, late_s = MACHINES[machine]
    ran = simulated(what, 1.5, clock=clock(start_of(what)))
    assert ran.totals.missed_scans == 0
    assert_same(ran, expected)
    assert max(ran.totals.lateness_ns) > late_s * NS


@pytest.mark.parametrize("speed", [50.0, 10_000.0])
def test_a_speed_that_the_machine_cannot_hold_leaves_nothing_out(
    tmp_path: Path, speed: float
) -> None:
    """Beams that turn 20 times a second: their scans are shorter than the clock may be behind."""
    what = scene(tmp_path, impaired(period_s=0.05, sectors=4))
    ran = simulated(what, 4.0, clock=WallClock(start_of(what), speed=speed))
    assert_same(ran, simulated(what, 4.0))
    totals, *_, ended = ran.totals, *ran.told("session")
    assert 0 <= min(totals.lateness_ns) <= max(totals.lateness_ns) <= MOST_BEHIND_NS
    assert totals.speed == speed
    assert 0 < (totals.speed_reached or 0) <= (speed if speed < 10_000.0 else speed / 2)
    assert (ended["state"], ended["speed"]) == ("ENDED", speed)
    assert ended["speed_reached"] == pytest.approx(totals.speed_reached, abs=0.01)


def lateness_s(ran: AtWork) -> tuple[Array, Array]:
    """When sectors were due after the start, and how late they left; one message of each."""
    found = {
        (m.due_utc_ns - ran.start_ns) / NS: (t - m.due_utc_ns) / NS
        for m, t in ran.said
        if m.topic.endswith("/asterix/034")
    }
    return np.array(list(found)), np.array(list(found.values()))


def test_lateness_has_no_slope_over_minutes(tmp_path: Path) -> None:
    what = scene(tmp_path, TURN, drones="")
    ran = simulated(what, 150.0, clock=LateClock(start_of(what)))
    due_s, late_s = lateness_s(ran)
    assert len(late_s) > 2375
    assert ran.totals.missed_scans == 0
    fit = stats.linregress(due_s, late_s)
    assert_chance(float(fit.pvalue), "slope of lateness")
    assert abs(fit.slope) * 150 < 0.0005
    assert 0.0015 < late_s.mean() < 0.0025


@pytest.mark.parametrize(("after_s", "pause_s"), [(5.0, 1.7), (5.06, 5.3), (5.0, 60.0)])
def test_after_a_pause_it_goes_on_with_the_present(
    tmp_path: Path, after_s: float, pause_s: float
) -> None:
    """What was missed is counted, and not made up for; all else is what it would have been."""
    what, for_s = scene(tmp_path, TURN, drones=""), 12.0 + pause_s
    ran = simulated(what, for_s, clock=LateClock(start_of(what), after_s=after_s, for_s=pause_s))
    due_s, late_s = lateness_s(ran)
    # One was worked out already, and the last that ended in the pause is not missed.
    assert (late_s > 0.03).sum() <= 2
    assert late_s.max() < pause_s + 0.1
    missed = for_s * 16 - 1 - len(late_s)
    assert pause_s * 16 - 3 <= missed <= pause_s * 16 + 1
    places = [batch.sector.scan * 16 + batch.sector.index for batch in ran.sectors]
    assert ran.totals.missed_scans == sum(b // 16 - (a + 1) // 16 for a, b in pairwise(places))
    before, after = late_s[due_s < 4], late_s[due_s > 6 + pause_s]
    assert_chance(float(stats.ks_2samp(before, after).pvalue), "lateness before and after")
    assert batches(ran).items() <= batches(simulated(what, for_s)).items()


def test_a_pause_shorter_than_a_turn_is_caught_up_once(tmp_path: Path) -> None:
    what = scene(tmp_path, TURN)
    ran = simulated(what, 10.0, clock=StallingClock(start_of(what), 4.0, 0.8))
    assert ran.totals.missed_scans == 0
    assert ran.reported == simulated(what, 10.0).reported


def test_another_seed_is_another_scene(tmp_path: Path) -> None:
    text = scene_text(start_utc=START, port=1883)
    one, again, other = (
        simulated(load(scene_file(tmp_path, text.replace("seed = 3", f"seed = {seed}"))), 3.0)
        for seed in (3, 3, 4)
    )
    assert one.reported == again.reported != other.reported


@pytest.mark.parametrize("sensors", [radar(), STARING], ids=["rotating", "staring"])
def test_totals_are_what_was_sent_and_each_drone_is_looked_at_once_a_turn(
    tmp_path: Path, sensors: str
) -> None:
    ran = simulated(scene(tmp_path, sensors), 20.0)
    totals, entries = ran.totals, ran.entries
    plots = [plot for entry in entries for plot in entry.plots]
    told = [plot for p in batches(ran).values() for plot in pb.PlotBatch.FromString(p).plots]
    assert totals.plots == len(plots) == len(told) > 10
    assert totals.false_alarms == sum(not plot.drone for plot in plots)
    assert totals.messages == sum(map(len, ran.reported.values())) == len(ran.sent)
    assert totals.undelivered == totals.missed_scans == totals.refused == 0
    scans = [entry.scan for entry in entries for _ in entry.looks]
    assert totals.looks == len(scans)
    assert scans == [*range(scans[0], scans[-1] + 1)]


def test_a_session_lasts_as_its_scene_says_and_tells_of_every_sector_at_its_end(
    tmp_path: Path,
) -> None:
    """As of the first whole one; the sensor is ONLINE at first and OFFLINE at last."""
    ran = simulated(scene(tmp_path, TURN, general="duration_s = 11.0"), None)
    reported = [(m.due_utc_ns, t) for m, t in ran.said if m.topic in ran.reported]
    due = [due_ns for due_ns, _ in reported]
    assert due == sorted(due)
    assert all(t_ns % (NS // 16) == 0 for t_ns in due)
    assert all(left_ns >= due_ns for due_ns, left_ns in reported)
    assert len(batches(ran)) == 11 * 16 - 1
    states = [told["state"] for told in ran.told("radar/status")]
    assert states == ["ONLINE", "ONLINE", "ONLINE", "OFFLINE"]
    assert all(m.retain for m, _ in ran.said if m.topic.endswith("/status"))


@in_own_time
async def test_what_a_link_holds_leaves_at_once_when_a_command_lets_it(tmp_path: Path) -> None:
    """However long no sector ends, and nothing is worked out."""
    seldom = radar(period_s=4.0, sectors=4)
    what = scene(tmp_path, f'{seldom}[sensor.link]\non_loss = "stall"\n')
    async with at_work(what, None, clock=LoopClock(start_of(what))) as ran:
        await ran.sectors_more(1)
        for is_down, sectors in ((True, 3), (False, 1)):
            ran.session.command({"sensor": "radar", "set": {"link": {"down": is_down}}})
            asked_ns = ran.clock.now_ns()
            await ran.sectors_more(sectors)
            await asyncio.sleep(0.3)
    held = [one for one in ran.sent if one.due_utc_ns <= asked_ns < one.sent_utc_ns]
    assert len(held) > 4
    assert all(one.sent_utc_ns - asked_ns < NS // 16 for one in held)
    assert {one.fate for one in ran.sent} == {pb.SENT}


class Pauses(Observer):
    """Lets the session's time stand still after a while, and then asks the session to stop."""

    def __init__(self, stop: asyncio.Event, clock: WallClock) -> None:
        self._stop, self._clock = stop, clock
        self._after_ns = clock.now_ns() + NS // 5
        self.paused_ns = 0

    def before_due(self, due_utc_ns: int) -> None:
        if not self.paused_ns and due_utc_ns >= self._after_ns:
            self._clock.pause()
            self.paused_ns = self._clock.now_ns()
            asyncio.get_running_loop().call_later(0.1, self._stop.set)


@pytest.mark.asyncio
async def test_a_session_told_to_stop_sends_the_sectors_that_are_worked_out(tmp_path: Path) -> None:
    """At each tick those are that end before the next one, 10 ms later; a sector takes 2 ms."""
    stop, clock = asyncio.Event(), WallClock()
    observer, watch = Pauses(stop, clock), AtWork(clock)
    what = load(scene_file(tmp_path, scene_text(sensors=radar(period_s=0.2, sectors=100), port=1)))
    observers = [observer, watch]
    await run(what, clock=clock, broker="none", duration_s=3600.0, stop=stop, observers=observers)
    last_ns = max(m.due_utc_ns for m, _ in watch.said if m.topic.endswith("/plots"))
    assert last_ns > observer.paused_ns > 0
    assert json.loads(watch.on("radar/status")[-1])["state"] == "OFFLINE"

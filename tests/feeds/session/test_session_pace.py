"""Whatever the pace and however late the machine: the same octets, the same ledger, no drift."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from support.scene_files import DRONE, radar, scene_file, scene_text
from support.significance import Array, assert_chance

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import MOST_BEHIND_NS, Clock, InstantClock, WallClock
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import entries_in

S = 1_000_000_000
START = "2026-01-01T11:59:58.05Z"
# Of a turn, so that a machine that stalls is late but misses none, at ten times the pace too.
LONG_S = 12.0

LOSSY = """
[sensor.link]
latency_ms = 120.0
jitter_ms = 80.0
delay_correlation = 0.4
duplicate = 0.2
corrupt = 0.1
loss = { kind = "gilbert-elliott", mean_loss = 0.2, mean_burst = 3.0 }
"""
NARROW = """
[sensor.link]
rate_kbit_s = 24.0
queue_messages = 6
jitter_ms = 30.0
distribution = "pareto"
in_order = true
"""
STALLED = """
[sensor.link]
latency_ms = 30.0
on_loss = "stall"
loss = { kind = "random", probability = 0.1 }
"""
EVENTS = """
[[sensor.event]]
from_s = 0.6
to_s = 1.1
set = { link = { down = true } }
[[sensor.event]]
from_s = 1.3
to_s = 1.9
set = { pfa_factor = 100, link = { latency_ms = 400.0 } }
[[sensor.event]]
from_s = 2.2
to_s = 2.5
set = { enabled = false }
"""
LINKS = {"lossy": LOSSY, "narrow": NARROW, "stalled": STALLED}

Sent = list[tuple[Message, int]]


def impaired(name: str, link: str, *, period_s: float = LONG_S, sectors: int = 240) -> str:
    return radar(name, period_s=period_s, sectors=sectors) + link + EVENTS


def scene(folder: Path, sensors: str, drones: str = DRONE) -> Scene:
    text = scene_text(start_utc=START, sensors=sensors, drones=drones, port=1883)
    return load(scene_file(folder, text))


async def session(what: Scene, clock: Clock, duration_s: float) -> tuple[SessionCounters, Sent]:
    sent: Sent = []
    tap = lambda message, t: sent.append((message, t))  # noqa: E731
    totals = await run(what, clock=clock, broker="none", duration_s=duration_s, tap=tap)
    return totals, sent


async def simulated(
    what: Scene, duration_s: float, clock: Clock | None = None
) -> tuple[SessionCounters, Sent]:
    return await session(what, clock or InstantClock(what.scene.start_utc_ns), duration_s)


def reported(sent: Sent) -> dict[str, list[bytes]]:
    """What trackers get, by topic, in its order."""
    found: dict[str, list[bytes]] = {}
    for message, _ in sent:
        if "/asterix/" in message.topic or message.topic.endswith("/plots"):
            found.setdefault(message.topic, []).append(message.payload)
    return found


def ledger(sent: Sent) -> dict[str, list[pb.Ledger]]:
    """Of each sensor in its order, but for when messages left."""
    found: dict[str, list[pb.Ledger]] = {}
    for message, _ in sent:
        if message.topic.endswith("/truth"):
            for entry in entries_in(message.payload):
                for one in entry.messages:
                    one.ClearField("sent_utc_ns")
                found.setdefault(entry.sensor, []).append(entry)
    return found


def counts(totals: SessionCounters) -> dict[str, object]:
    of_time = {"lateness_ns", "speed", "speed_reached"}
    return {name: getattr(totals, name) for name in totals.__slots__ if name not in of_time}


def assert_same(one: tuple[SessionCounters, Sent], another: tuple[SessionCounters, Sent]) -> None:
    """To trackers, in the ledger, and as it was counted."""
    assert reported(one[1]) == reported(another[1])
    assert ledger(one[1]) == ledger(another[1])
    assert counts(one[0]) == counts(another[0])


@pytest.mark.asyncio
async def test_links_and_events_are_the_same_at_every_pace(tmp_path: Path) -> None:
    sensors = "".join(impaired(name, link) for name, link in LINKS.items())
    what = scene(tmp_path, sensors + radar("clear", period_s=LONG_S, sectors=240))

    totals, sent = await simulated(what, 3.0)
    fates = {one.fate for entries in ledger(sent).values() for e in entries for one in e.messages}
    assert fates == {pb.SENT, pb.LOST, pb.OUTAGE, pb.QUEUE_FULL}
    assert totals.duplicated > 5
    clocks = [WallClock(what.scene.start_utc_ns, speed=speed) for speed in (1.0, 10.0)]
    in_real_time = await asyncio.gather(*(session(what, clock, 3.0) for clock in clocks))
    for other_totals, other in in_real_time:
        assert other_totals.missed_scans == 0
        assert_same((other_totals, other), (totals, sent))


@pytest.mark.parametrize("speed", [50.0, 10_000.0])
@pytest.mark.asyncio
async def test_a_speed_that_the_machine_cannot_hold_leaves_nothing_out(
    tmp_path: Path, speed: float
) -> None:
    """Beams that turn 20 times a second: their scans are shorter than the clock may be behind."""
    sensors = "".join(impaired(n, link, period_s=0.05, sectors=4) for n, link in LINKS.items())
    what = scene(tmp_path, sensors)
    totals, sent = await simulated(what, 10.0)
    clock = WallClock(what.scene.start_utc_ns, speed=speed)
    other_totals, other = await session(what, clock, 10.0)
    assert_same((other_totals, other), (totals, sent))
    assert 0 <= min(other_totals.lateness_ns) <= max(other_totals.lateness_ns) <= MOST_BEHIND_NS
    assert other_totals.speed == speed
    assert 0 < (other_totals.speed_reached or 0) <= speed
    if speed == 10_000.0:  # 10 s in a thousandth of a second
        assert (other_totals.speed_reached or 0) < speed / 2
    *_, ended = [json.loads(m.payload) for m, _ in other if m.topic.endswith("/session")]
    assert (ended["state"], ended["speed"]) == ("ENDED", speed)
    assert ended["speed_reached"] == pytest.approx(other_totals.speed_reached, abs=0.01)


class LateClock(InstantClock):
    """A machine that oversleeps every time by chance, and now and then stands still."""

    leaps = False

    def __init__(
        self, start_utc_ns: int, seed: int, mean_s: float = 0.002, **pauses: float
    ) -> None:
        super().__init__(start_utc_ns)
        self._rng = np.random.default_rng(seed)
        self._mean_s = mean_s
        self._pause_ns = start_utc_ns + round(pauses.get("after_s", 1e6) * S)
        self._for_ns = round(pauses.get("for_s", 0.0) * S)

    async def sleep_until(self, t_utc_ns: int, *, exactly: bool = True) -> None:
        if self.now_ns() < t_utc_ns:
            t_utc_ns += round(self._rng.exponential(self._mean_s) * S)
        await super().sleep_until(t_utc_ns, exactly=exactly)
        if self._for_ns and t_utc_ns >= self._pause_ns:
            await super().sleep_until(t_utc_ns + self._for_ns)
            self._for_ns = 0


def late_clock(what: Scene, seed: int, **how: float) -> LateClock:
    return LateClock(what.scene.start_utc_ns or 0, seed, **how)


class SlowClock(LateClock):
    """A machine on which time goes by while it works, a tick's worth for a sensor."""

    def left_ns(self, t_utc_ns: int) -> int:
        self.jump(self.now_ns() + round(self._rng.exponential(0.01) * S))
        return t_utc_ns - self.now_ns()


@pytest.mark.parametrize(
    ("machine", "mean_s"), [(LateClock, 0.002), (LateClock, 0.15), (SlowClock, 0.002)]
)
@pytest.mark.asyncio
async def test_what_links_and_events_do_does_not_depend_on_how_late_they_are_done(
    tmp_path: Path, machine: type[LateClock], mean_s: float
) -> None:
    """Late by so much that an event's end is done after the next one has begun."""
    sensors = "".join(impaired(name, link) for name, link in LINKS.items())
    what = scene(tmp_path, sensors + radar("clear", period_s=LONG_S, sectors=240))
    late = await simulated(what, 3.0, machine(what.scene.start_utc_ns or 0, 5, mean_s))
    assert_same(late, await simulated(what, 3.0))
    assert max(late[0].lateness_ns) > mean_s * S


def lateness_s(sent: Sent) -> tuple[Array, Array]:
    """When sectors were due and how late they left; one message of each."""
    found = {
        m.due_utc_ns: (t - m.due_utc_ns) / S for m, t in sent if m.topic.endswith("/asterix/034")
    }
    return np.array(list(found)) / S, np.array(list(found.values()))


@pytest.mark.asyncio
async def test_lateness_has_no_slope_over_ten_minutes(tmp_path: Path) -> None:
    what = scene(tmp_path, radar(period_s=1.0, sectors=16), drones="")
    totals, sent = await simulated(what, 600.0, late_clock(what, 2))
    due_s, late_s = lateness_s(sent)
    assert len(late_s) > 9500
    assert totals.missed_scans == 0
    fit = stats.linregress(due_s - due_s[0], late_s)
    assert_chance(float(fit.pvalue), "slope of lateness")
    assert abs(fit.slope) * 600 < 0.0005
    assert 0.0015 < late_s.mean() < 0.0025


@pytest.mark.parametrize("after_s", [20.0, 20.06])
@pytest.mark.parametrize("pause_s", [1.7, 5.3, 60.0])
@pytest.mark.asyncio
async def test_after_a_pause_it_goes_on_with_the_present(
    tmp_path: Path, after_s: float, pause_s: float
) -> None:
    what = scene(tmp_path, radar(period_s=1.0, sectors=16), drones="")
    clock = late_clock(what, 3, after_s=after_s, for_s=pause_s)
    totals, sent = await simulated(what, 45.0 + pause_s, clock)
    due_s, late_s = lateness_s(sent)
    # One was worked out already, and the last that ended in the pause is not missed.
    assert (late_s > 0.03).sum() <= 2
    assert late_s.max() < pause_s + 0.1
    missed = (45.0 + pause_s) * 16 - 1 - len(late_s)
    assert pause_s * 16 - 3 <= missed <= pause_s * 16 + 1
    assert abs(totals.missed_scans - pause_s) <= 1
    before, after = late_s[due_s < due_s[0] + 19], late_s[due_s > due_s[0] + 21 + pause_s]
    assert_chance(float(stats.ks_2samp(before, after).pvalue), "lateness before and after")


@pytest.mark.asyncio
async def test_a_pause_shorter_than_a_turn_is_caught_up_once(tmp_path: Path) -> None:
    what = scene(tmp_path, radar(period_s=1.0, sectors=16), drones="")
    totals, sent = await simulated(what, 60.0, late_clock(what, 4, after_s=20.0, for_s=0.8))
    assert totals.missed_scans == 0
    assert reported(sent) == reported((await simulated(what, 60.0))[1])

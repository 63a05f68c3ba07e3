from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest
from support.scene_files import DRONE, radar, scene_file, scene_text
from support.sessions import StallingClock
from support.waiting import PATIENCE_S

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import Clock, InstantClock, WallClock
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.ledger import entries_in

S = 1_000_000_000
START = "2026-01-01T12:00:00.05Z"
STARING = radar(period_s=0.4).replace("rotating", "staring").replace("sectors = 8", "")

Sent = list[tuple[Message, int]]


def scene(folder: Path, **changes: str) -> Scene:
    return load(scene_file(folder, scene_text(**{"start_utc": START, **changes}, port=1883)))


async def session(
    what: Scene, clock: Clock, duration_s: float, stop: asyncio.Event | None = None
) -> tuple[SessionCounters, Sent]:
    sent: Sent = []
    totals = await run(
        what,
        clock=clock,
        broker="none",
        duration_s=duration_s,
        stop=stop,
        tap=lambda message, t: sent.append((message, t)),
    )
    return totals, sent


async def simulated(
    what: Scene, duration_s: float, clock: Clock | None = None
) -> tuple[SessionCounters, Sent]:
    clock = clock or InstantClock(what.scene.start_utc_ns)
    return await session(what, clock, duration_s)


def reported(sent: Sent, sensor: str = "radar") -> list[tuple[str, bytes]]:
    """What a tracker gets of a sensor."""
    topics = tuple(f"plotfeed/{sensor}/{kind}" for kind in ("plots", "asterix"))
    return [(m.topic, m.payload) for m, _ in sent if m.topic.startswith(topics)]


def states(sent: Sent, sensor: str = "radar") -> list[str]:
    topic = f"plotfeed/{sensor}/status"
    return [json.loads(m.payload)["state"] for m, _ in sent if m.topic == topic]


def batches(sent: Sent) -> dict[tuple[int, int], bytes]:
    found = {}
    for topic, payload in reported(sent):
        if topic.endswith("plots"):
            batch = pb.PlotBatch.FromString(payload)
            assert (batch.scan, batch.sector) not in found
            found[batch.scan, batch.sector] = payload
    return found


@pytest.mark.asyncio
async def test_the_octets_do_not_depend_on_the_pace(tmp_path: Path) -> None:
    # Turns are long, so that a machine that stalls for a while is late but skips none of them.
    what = scene(tmp_path, sensors=radar(period_s=3.0, sectors=60))
    start_ns = what.scene.start_utc_ns

    async def in_real_time() -> list[tuple[SessionCounters, Sent]]:
        clocks = [WallClock(start_ns), WallClock(start_ns, speed=3.0)]
        return await asyncio.gather(*(session(what, clock, 2.0) for clock in clocks))

    expected = reported((await simulated(what, 2.0))[1])
    assert sum(len(payload) for _, payload in expected) > 1000
    for _, sent in await in_real_time():
        assert reported(sent) == expected


@pytest.mark.asyncio
async def test_sensors_of_the_same_keys_have_chances_of_their_own(tmp_path: Path) -> None:
    _, sent = await simulated(
        scene(tmp_path, sensors=radar("one") + radar("other"), drones=""), 6.0
    )
    plots = [
        [
            plot.range_m
            for topic, payload in reported(sent, sensor)
            if topic.endswith("plots")
            for plot in pb.PlotBatch.FromString(payload).plots
        ]
        for sensor in ("one", "other")
    ]
    assert all(len(found) > 10 for found in plots)
    assert set(plots[0]).isdisjoint(plots[1])


@pytest.mark.asyncio
async def test_scans_do_not_depend_on_when_a_session_began(tmp_path: Path) -> None:
    early = batches((await simulated(scene(tmp_path, drones=""), 8.0))[1])
    later_text = "2026-01-01T12:00:03.21Z"
    later = batches((await simulated(scene(tmp_path, drones="", start_utc=later_text), 8.0))[1])
    shared = early.keys() & later.keys()
    assert len(shared) > 50
    assert all(early[place] == later[place] for place in shared)


@pytest.mark.asyncio
async def test_another_seed_is_another_scene(tmp_path: Path) -> None:
    text = scene_text(start_utc=START, port=1883)
    _, one = await simulated(load(scene_file(tmp_path, text)), 5.0)
    _, other = await simulated(
        load(scene_file(tmp_path, text.replace("seed = 3", "seed = 4"))), 5.0
    )
    assert reported(one) != reported(other)


@pytest.mark.parametrize("sensors", [radar(), STARING], ids=["rotating", "staring"])
@pytest.mark.asyncio
async def test_each_drone_is_looked_at_once_a_turn(tmp_path: Path, sensors: str) -> None:
    totals, sent = await simulated(scene(tmp_path, sensors=sensors), 20.0)
    ledgers = [e for m, _ in sent if m.topic == "plotfeed/truth" for e in entries_in(m.payload)]
    scans = [entry.scan for entry in ledgers for _ in entry.looks]
    assert totals.looks == len(scans)
    assert len(scans) == len(set(scans))
    assert set(range(min(scans), max(scans) + 1)) == set(scans)


@pytest.mark.asyncio
async def test_every_message_bears_the_end_of_its_sector(tmp_path: Path) -> None:
    _, sent = await simulated(scene(tmp_path, sensors=radar(period_s=0.5, sectors=8)), 5.0)
    due = [m.due_utc_ns for m, _ in sent if "/asterix/" in m.topic or m.topic.endswith("/plots")]
    assert due == sorted(due)
    assert all(t * 16 % S == 0 for t in due)
    assert all(t >= m.due_utc_ns for m, t in sent)


@pytest.mark.asyncio
async def test_sensors_are_online_at_first_and_offline_at_last(tmp_path: Path) -> None:
    _, sent = await simulated(scene(tmp_path), 11.0)
    assert states(sent) == ["ONLINE", "ONLINE", "ONLINE", "OFFLINE"]
    assert all(m.retain for m, _ in sent if m.topic.endswith("/status"))


@pytest.mark.asyncio
async def test_a_session_ends_when_it_is_asked_to(tmp_path: Path) -> None:
    what = scene(tmp_path)

    stop = asyncio.Event()
    asyncio.get_running_loop().call_later(0.2, stop.set)
    async with asyncio.timeout(PATIENCE_S):
        _, sent = await session(what, WallClock(), 3600.0, stop)
    assert states(sent)[-1] == "OFFLINE"


class Pauses(Observer):
    """Lets the session's time stand still after a while, and then asks the session to stop."""

    def __init__(self, stop: asyncio.Event, clock: WallClock) -> None:
        self._stop = stop
        self._clock = clock
        self._after_ns = clock.now_ns() + S // 2
        self.paused_ns = 0

    def before_due(self, due_utc_ns: int) -> None:
        if not self.paused_ns and due_utc_ns >= self._after_ns:
            self._clock.pause()
            self.paused_ns = self._clock.now_ns()
            asyncio.get_running_loop().call_later(0.3, self._stop.set)


@pytest.mark.asyncio
async def test_a_session_told_to_stop_sends_the_sectors_that_are_worked_out(tmp_path: Path) -> None:
    """At each tick those are that end before the next one, 10 ms later; a sector takes 2 ms."""
    what = scene(tmp_path, sensors=radar(period_s=0.2, sectors=100))
    stop, clock, sent = asyncio.Event(), WallClock(), list[tuple[Message, int]]()
    observer = Pauses(stop, clock)
    await run(
        what,
        clock=clock,
        broker="none",
        stop=stop,
        observers=[observer],
        tap=lambda m, t: sent.append((m, t)),
    )
    last_ns = max(m.due_utc_ns for m, _ in sent if m.topic.endswith("/plots"))
    assert last_ns > observer.paused_ns > 0


@pytest.mark.asyncio
async def test_the_scenes_own_duration_counts_where_none_is_given(tmp_path: Path) -> None:
    what = scene(tmp_path, general="duration_s = 2.0", sensors=radar(period_s=0.5, sectors=8))
    sent: Sent = []
    clock = InstantClock(what.scene.start_utc_ns)
    await run(what, clock=clock, broker="none", tap=lambda m, t: sent.append((m, t)))
    assert len(batches(sent)) == 31  # those that began within it and ended


@pytest.mark.asyncio
async def test_scans_that_were_missed_are_counted_and_not_made_up_for(tmp_path: Path) -> None:
    what = scene(tmp_path, sensors=radar(period_s=0.5, sectors=8))
    start_ns = what.scene.start_utc_ns
    assert start_ns is not None
    totals, sent = await simulated(what, 30.0, StallingClock(start_ns, 10.0, 7.0))
    whole = batches((await simulated(what, 30.0))[1])
    found = batches(sent)
    missed = {place[0] for place in whole.keys() - found.keys()}
    assert 12 <= len(missed) <= 15
    assert abs(totals.missed_scans - len(missed)) <= 1
    assert all(found[place] == whole[place] for place in found)
    late_ns = sorted(t - m.due_utc_ns for m, t in sent if "radar" in m.topic)
    assert late_ns[-1] <= 7.1 * S
    assert sum(late > 0.6 * S for late in late_ns) <= 5


@pytest.mark.asyncio
async def test_a_short_stall_costs_no_scan(tmp_path: Path) -> None:
    what = scene(tmp_path, sensors=radar(period_s=0.5, sectors=8))
    start_ns = what.scene.start_utc_ns
    assert start_ns is not None
    totals, sent = await simulated(what, 20.0, StallingClock(start_ns, 10.0, 0.3))
    assert totals.missed_scans == 0
    assert reported(sent) == reported((await simulated(what, 20.0))[1])


@pytest.mark.asyncio
async def test_a_flight_that_cannot_be_flown_is_an_error_before_anything_runs(
    tmp_path: Path,
) -> None:
    drone = '[[drone]]\nid = "d"\nflight = { file = "absent.csv" }\n'
    with pytest.raises(PlotfeedError, match=r"absent\.csv: cannot be read"):
        await simulated(scene(tmp_path, drones=drone), 1.0)


@pytest.mark.asyncio
async def test_a_path_that_outlasts_time_is_an_error(tmp_path: Path) -> None:
    far = "{ east_m = 1e6, north_m = 1e6, above_site_m = 0.0 }, "
    near = "{ east_m = -1e6, north_m = -1e6, above_site_m = 0.0 }, "
    slow = DRONE.partition("path")[0].replace("speed_m_s = 15.0", "speed_m_s = 0.01")
    drone = f"{slow}start_s = 1e9\npath = [{(far + near) * 2}]"
    with pytest.raises(PlotfeedError, match="'visitor': path: it ends after the year 2262"):
        await simulated(scene(tmp_path, drones=drone, start_utc="2199-12-30T00:00:00Z"), 1.0)


@pytest.mark.asyncio
async def test_totals_are_what_was_sent(tmp_path: Path) -> None:
    totals, sent = await simulated(scene(tmp_path), 20.0)
    ledgers = [e for m, _ in sent if m.topic == "plotfeed/truth" for e in entries_in(m.payload)]
    plots = [plot for entry in ledgers for plot in entry.plots]
    assert totals.plots == len(plots)
    assert totals.false_alarms == sum(not plot.drone for plot in plots)
    assert totals.messages == len(reported(sent)) == sum(len(e.messages) for e in ledgers)
    assert totals.undelivered == totals.missed_scans == totals.refused == 0
    in_batches = sum(len(pb.PlotBatch.FromString(b).plots) for b in batches(sent).values())
    assert in_batches == len(plots)

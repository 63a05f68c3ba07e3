"""Whole sessions whose broker is killed, and what their policies promise when it comes back."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest
from support.brokers import free_port, own_broker, quiet_mosquitto
from support.scene_files import radar, scene_file, scene_text
from support.servers import proxied
from support.sessions import AtWork, Start, at_work
from support.waiting import until

from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.feeds.transport import ways_out
from plotfeed.models.beam import Sector
from plotfeed.models.state import AltitudeReference
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.testing import MqttReceiver

KEPT = 12
SECTOR_S = 6.0 / 240
HERE = 40.46, -3.73, 900.0, AltitudeReference.ELLIPSOID
PLOTS, STATUS = "plotfeed/radar/plots", "plotfeed/radar/status"


@pytest.mark.parametrize(
    ("start", "policy"),
    [(quiet_mosquitto, "drop-oldest"), (own_broker, "drop-newest"), (quiet_mosquitto, "wait")],
)
@pytest.mark.asyncio
async def test_a_broker_that_is_killed_and_comes_back_gets_what_the_policy_promises(
    start: Start,
    policy: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """By the ledger of a whole session, with QoS 1; the session hears telemetry again, too."""
    monkeypatch.setattr(ways_out, "BACKOFF_S", (0.02,))
    queue = f'queue = {{ policy = "{policy}", messages = {KEPT} }}'
    plots = radar(period_s=6.0, sectors=240, more='report = ["plots"]')
    text = scene_text(port=1883, sensors=plots, drones="", mqtt=f"qos = 1\ntruth = false\n{queue}")
    what = load(scene_file(tmp_path, text))
    port = free_port()
    async with proxied(port) as proxy:
        with start(tmp_path, port) as process:
            session_of = at_work(what, proxy.port)
            session = await session_of.__aenter__()
            task = session.session.sensors["radar"]
            await until(lambda: len(session.entries) > 5)
            proxy.is_closed = True
            process.kill()
            process.wait()
        await until(lambda: task.outbox.waiting >= KEPT)
        full, sectors = task.outbox.waiting, len(session.sectors)
        if policy == "wait":
            await asyncio.sleep(10 * SECTOR_S)
            assert len(session.sectors) == sectors
        else:
            await session.sectors_more(2 * KEPT)
            assert task.outbox.waiting <= full
        with start(tmp_path, port), MqttReceiver(port, 5, PLOTS, STATUS) as ears:
            back_ns = session.clock.now_ns()
            proxy.is_closed = False
            await until(lambda: not task.outbox.waiting)
            while not session.totals.telemetry:
                report = PositionReport(session.clock.now_ns(), *HERE)
                ears.publish("plotfeed/telemetry/d", report.to_json())
                await asyncio.sleep(0.05)
            await session.sectors_more(5)
            await session_of.__aexit__(None, None, None)
            await until(lambda: place(session.sectors[-1].sector) in places(ears))
            states = [json.loads(payload)["state"] for payload in ears.on(STATUS)]
            heard = places(ears)
    assert_kept(session, policy, back_ns, heard)
    assert (states[0], states[-1]) == ("ONLINE", "OFFLINE")
    lost = [each for each in caplog.messages if "lost the connection" in each]
    assert len(lost) == 1  # of the one connection for data; those of last wills say nothing


def places(ears: MqttReceiver) -> list[tuple[int, int]]:
    """Scans and sectors of the plots that came."""
    batches = [pb.PlotBatch.FromString(payload) for payload in ears.on(PLOTS)]
    return [(batch.scan, batch.sector) for batch in batches]


def place(sector: Sector) -> tuple[int, int]:
    return sector.scan, sector.index


def assert_kept(session: AtWork, policy: str, back_ns: int, heard: list[tuple[int, int]]) -> None:
    fates = {(e.scan, e.sector): one for e in session.entries for one in e.messages}
    assert fates.keys() == {place(batch.sector) for batch in session.sectors}
    assert len(fates) == len(session.sent)
    assert {one.fate for one in fates.values()} <= {pb.SENT, pb.UNDELIVERED}
    ends_ns = {place(batch.sector): batch.sector.end_ns for batch in session.sectors}
    sent_afterwards = [p for p, one in fates.items() if one.sent_utc_ns >= back_ns]
    assert {*sent_afterwards} <= {*heard}
    assert sorted(dict.fromkeys(heard)) == list(dict.fromkeys(heard))
    given_up = sorted(p for p, one in fates.items() if one.fate == pb.UNDELIVERED)
    up_again_ns = min(fates[p].sent_utc_ns for p in sent_afterwards)
    due_away = sorted(p for p in fates if ends_ns[p] < up_again_ns and p >= min(sent_afterwards))
    if policy == "wait":
        assert given_up == []
        return
    assert len(given_up) > KEPT / 2
    assert session.totals.undelivered == len(given_up)
    if policy == "drop-oldest":
        assert {*due_away[-(KEPT - 1) :]} <= {*sent_afterwards}  # a status has a place, too
    else:  # status, settings and description take places of plots
        assert max(given_up) in due_away
        assert len([p for p in due_away if p < min(given_up)]) >= KEPT - 3

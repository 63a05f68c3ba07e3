"""Whole sessions whose broker is killed, and what their policies promise when it comes back."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from support.brokers import free_port
from support.cut_proxy import proxied
from support.scene_files import radar, scene_file, scene_text
from support.sessions import AtWork, Start, at_work, every_broker
from support.waiting import until

from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.transport import ways_out
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.testing import MqttMessage, MqttReceiver

KEPT = 12
SECTOR_S = 6.0 / 240


@every_broker
@pytest.mark.parametrize("policy", ["drop-oldest", "drop-newest", "wait"])
@pytest.mark.asyncio
async def test_a_broker_that_is_killed_and_comes_back_gets_what_the_policy_promises(
    start: Start, policy: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the ledger of a whole session, with QoS 1; what arrived is heard by another client."""
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
            await asyncio.sleep(20 * SECTOR_S)
            assert len(session.sectors) == sectors
        else:
            await session.sectors_more(2 * KEPT)
            assert task.outbox.waiting <= full
        with start(tmp_path, port), MqttReceiver(port, 5, "plotfeed/radar/plots") as ears:
            back_ns = session.clock.now_ns()
            proxy.is_closed = False
            await until(lambda: not task.outbox.waiting)
            await session.sectors_more(5)
            await session_of.__aexit__(None, None, None)
            last = place(session.sectors[-1].sector)
            await asyncio.to_thread(ears.wait_for, lambda m: heard_place(m) == last)
            heard = [heard_place(m) for m in ears.heard]
    assert_kept(session, policy, back_ns, heard)


def place(sector: Any) -> tuple[int, int]:
    return sector.scan, sector.index


def heard_place(message: MqttMessage) -> tuple[int, int]:
    batch = pb.PlotBatch.FromString(message.payload)
    return batch.scan, batch.sector


def assert_kept(session: AtWork, policy: str, back_ns: int, heard: list[tuple[int, int]]) -> None:
    fates = {(e.scan, e.sector): one for e in session.entries for one in e.messages}
    assert fates.keys() == {place(r.sector) for r in session.sectors}
    assert len(fates) == sum(len(entry.messages) for entry in session.entries)
    assert {one.fate for one in fates.values()} <= {pb.SENT, pb.UNDELIVERED}
    ends_ns = {place(r.sector): r.sector.end_ns for r in session.sectors}
    sent_afterwards = [p for p, one in fates.items() if one.sent_utc_ns >= back_ns]
    assert {*sent_afterwards} <= {*heard}
    assert sorted(dict.fromkeys(heard)) == list(dict.fromkeys(heard))
    given_up = sorted(p for p, one in fates.items() if one.fate == pb.UNDELIVERED)
    up_again_ns = min(fates[p].sent_utc_ns for p in sent_afterwards)
    due_away = sorted(p for p in fates if ends_ns[p] < up_again_ns and p >= min(sent_afterwards))
    if policy == "wait":
        assert given_up == []
    elif policy == "drop-oldest":
        assert len(given_up) > KEPT / 2
        assert {*due_away[-(KEPT - 1) :]} <= {*sent_afterwards}  # a status has a place, too
    else:
        assert len(given_up) > KEPT / 2
        assert max(given_up) in due_away
        assert len([p for p in due_away if p < min(given_up)]) >= KEPT - 1

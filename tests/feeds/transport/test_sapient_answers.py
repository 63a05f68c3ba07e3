"""What a middleware says to a node, and what becomes of a node whom it treats badly."""

from __future__ import annotations

import asyncio
import json
import logging
import socket
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from support import sapient_flood
from support.deliveries import taken
from support.sapient_middleware import Peer, linked, listening, polite, status_report
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.formats.sapient.sapient_announcer import MAX_TASKS_PER_S
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run
from plotfeed.feeds.transport import sapient, ways_out
from plotfeed.feeds.transport.sapient import AT_ONCE_S, SapientIntake, SapientNews
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.testing import held, radar, scene, staring

ERROR = SapientMessage(error={"packet": b"x", "error_message": ["bad\x1b[31m"] * 1000})


@pytest.fixture(autouse=True)
def hurried(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(sapient, "ACK_TIMEOUT_S", PATIENCE_S)
    monkeypatch.setattr(ways_out, "BACKOFF_S", (0.01, 0.05))
    caplog.set_level(logging.INFO)


def told(caplog: pytest.LogCaptureFixture) -> list[str]:
    lines = [r.getMessage() for r in caplog.records if r.name.startswith("plotfeed")]
    assert all(line.isprintable() and len(line) < 400 for line in lines)
    return lines


@pytest.mark.parametrize("says", [b"", b"\xff" * 40])
@pytest.mark.asyncio
async def test_a_node_reports_whatever_else_is_said_to_its_registration(
    says: bytes, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sapient, "ACK_TIMEOUT_S", 0.2)

    async def rude(peer: Peer) -> None:
        await peer.next()
        peer.send(says)
        await peer.hear_all()

    async with listening(rude) as middleware, linked(middleware.address) as link:
        assert taken(link, status_report())
        (peer,) = middleware.peers
        await until(lambda: len(peer.heard) == 3)
        assert link.counters.reporting
        assert link.counters.errors == 1
    complaint, silence = told(caplog)
    assert "complains: it sent" in complaint
    assert "did not acknowledge" in silence


@pytest.mark.asyncio
async def test_a_node_that_is_refused_reports_nothing_and_says_so_once(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sapient, "REGISTER_AGAIN_S", 0.02)

    async def refusing(peer: Peer) -> None:
        for _ in range(5):
            assert (await peer.next()).HasField("registration")
            peer.acknowledge("no room\nhere", accepted=False)
        assert (await peer.next()).HasField("registration")
        peer.acknowledge()
        await peer.hear_all()

    async with listening(refusing) as middleware, linked(middleware.address) as link:
        assert not taken(link, status_report())
        assert not link.counters.reporting
        await until(lambda: link.counters.reporting)
        (peer,) = middleware.peers
        assert taken(link, status_report())
        await until(lambda: len(peer.heard) == 8)
        assert peer.kinds() == ["registration"] * 6 + ["status_report"] * 2
        assert link.counters.refusals == link.counters.totals.sapient_refusals == 5
    (line,) = told(caplog)
    assert line.endswith("refused the registration: no room here")


@pytest.mark.asyncio
async def test_a_registration_can_be_refused_later_and_accepted_again() -> None:
    async with listening() as middleware, linked(middleware.address) as link:
        (peer,) = middleware.peers
        peer.acknowledge("enough", accepted=False)
        await until(lambda: not link.counters.reporting)
        assert not taken(link, status_report())
        peer.acknowledge()
        await until(lambda: link.counters.reporting)
        assert taken(link, status_report())
        await until(lambda: len(peer.heard) == 4)
        assert peer.kinds() == ["registration", *["status_report"] * 3]


@pytest.mark.asyncio
async def test_errors_are_counted_and_told_in_few_lines(caplog: pytest.LogCaptureFixture) -> None:
    async def complaining(peer: Peer) -> None:
        await peer.next()
        peer.acknowledge()
        for _ in range(250):
            peer.send(ERROR.SerializeToString())
        await peer.hear_all()

    async with (
        listening(complaining) as middleware,
        linked(middleware.address, max_octets_per_s=1_000_000_000) as link,
    ):
        await until(lambda: link.counters.errors == 250)
        assert link.counters.totals.sapient_errors == 250
        assert taken(link, status_report())
    lines = told(caplog)
    assert ["complains: " in line for line in lines] == [True, False, False]
    assert [line.partition(" (")[2].split(" ")[0] for line in lines] == ["", "10", "100"]


@pytest.mark.asyncio
async def test_a_restart_of_the_middleware_is_told_when_it_is_over(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def hang_up(peer: Peer) -> None:
        await peer.next()
        peer.acknowledge()
        await peer.next()

    async with listening(hang_up, polite) as middleware, linked(middleware.address) as link:
        await until(lambda: link.counters.connections == 2)
        await until(lambda: taken(link, status_report()))
    lost, again = told(caplog)
    assert lost.endswith("(the connection was closed)")
    assert again == f"sapient-radar: connected to {middleware.address} again"


@pytest.mark.asyncio
async def test_who_no_longer_reads_is_given_up_after_the_time_that_the_scene_says(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sapient, "MAX_STALL_S", 0.1)

    async def deaf(peer: Peer) -> None:
        await peer.next()
        peer.acknowledge()
        peer.writer.transport.pause_reading()  # type: ignore[attr-defined]
        await asyncio.sleep(PATIENCE_S)

    async with (
        listening(deaf, polite) as middleware,
        linked(middleware.address, give_up_after_s=0.5) as link,
    ):
        message, refused = status_report(50_000), 0
        while link.counters.connections < 2:  # it is noticed even if nothing more is sent
            if not refused:
                refused += not taken(link, message)
            await asyncio.sleep(0.001)
        assert refused
        assert link.counters.stalls == link.counters.totals.sapient_stalls == 1
    lines = told(caplog)
    assert sum("it has read nothing for 0.5 s" in line for line in lines) == 1
    assert sum("again" in line for line in lines) == 1


@pytest.mark.skipif(not hasattr(socket, "TCP_USER_TIMEOUT"), reason="Linux alone has it")
@pytest.mark.asyncio
async def test_the_system_gives_up_a_host_that_is_gone_without_a_word() -> None:
    async with listening() as middleware, linked(middleware.address, give_up_after_s=2.5) as link:
        wire = link._wire
        assert wire is not None
        own = wire._writer.get_extra_info("socket")
        assert own.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 2500
        protocol = wire._writer.transport.get_protocol()
        protocol.connection_lost(TimeoutError(110, "Connection timed out"))
        await until(lambda: link.counters.stalls == 1)
        assert "has read nothing for 2.5 s" in link.last_error


class Fates(Observer):
    """Fates of messages, and how statuses say that it goes with the middleware, by sensor."""

    def __init__(self) -> None:
        self.of: dict[str, Counter[int]] = {}
        self.statuses: dict[str, list[dict[str, Any]]] = {}

    def settled(self, report: Batch, sent: Any) -> None:
        self.of.setdefault(report.sensor, Counter()).update(one.fate for one in sent)

    def after_link(self, message: Message, _sent_utc_ns: int) -> None:
        if message.topic.endswith("/status"):
            status = json.loads(message.payload)
            self.statuses.setdefault(status["sensor"], []).append(status["sapient"])


@pytest.mark.asyncio
async def test_a_node_that_is_refused_costs_no_other_anything() -> None:
    """Detections of the one are undelivered, as the ledger says; those of the other are sent."""

    async def choosy(peer: Peer) -> None:
        accepted = (await peer.next()).registration.name == "good"
        peer.acknowledge("not you", accepted=accepted)
        await peer.hear_all()

    sensors = [radar(id=name, report=["sapient"], scan=staring(0.1)) for name in ("good", "bad")]
    fates = Fates()
    async with listening(choosy) as middleware:
        flown = scene(
            sensors,
            [held("d", 45.0, 20.0, 1000.0, rcs_m2=1.0)],
            seed=3,
            sapient={"middleware": middleware.address},
        )
        totals = await run(flown, broker="none", duration_s=2.0, observers=[fates])
    assert totals.sapient_refusals == 1
    good, bad = fates.statuses["good"][0], fates.statuses["bad"][0]
    assert (good["reporting"], good["connections"], good["refusals"]) == (True, "1", "0")
    assert (bad.get("reporting", False), bad["connections"], bad["refusals"]) == (False, "1", "1")
    assert set(fates.of["good"]) == {pb.SENT}
    assert set(fates.of["bad"]) == {pb.UNDELIVERED}
    assert totals.undelivered == fates.of["bad"].total() > 5
    heard = {peer.heard[0].registration.name: peer.kinds() for peer in middleware.peers}
    assert set(heard["bad"]) == {"registration"}
    assert heard["good"].count("detection_report") == fates.of["good"].total()


@contextmanager
def flooding(says: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, str(Path(sapient_flood.__file__)), says],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("says", ["errors", "empty", "tasks"])
@pytest.mark.asyncio
async def test_a_middleware_that_never_stops_talking_is_made_to_wait(says: str) -> None:
    """It says as much as it may in a second, however many connections it says it over."""
    most_per_s, fates = 200, Fates()
    with flooding(says) as flood:
        assert flood.stdout is not None
        port = int(flood.stdout.readline())
        flown = scene(
            [radar(id=name, report=["sapient"], scan=staring(0.1)) for name in ("a", "b", "c")],
            [held("d", 45.0, 20.0, 1000.0, rcs_m2=1.0)],
            seed=3,
            sapient={"middleware": f"127.0.0.1:{port}", "max_messages_per_s": most_per_s},
        )
        loop = asyncio.get_running_loop()
        began_s = loop.time()
        totals = await run(flown, broker="none", duration_s=3.0, observers=[fates])
        took_s = loop.time() - began_s
        heard = [int(flood.stdout.readline()) for _ in flown.sensor]
    taken = totals.sapient_errors + totals.sapient_tasks + totals.sapient_rejected
    assert 0.5 * most_per_s < taken <= most_per_s * (took_s + AT_ONCE_S)
    assert totals.sapient_tasks <= MAX_TASKS_PER_S * len(flown.sensor) * (took_s + 1)
    assert (totals.sapient_tasks > 0) == (says == "tasks")
    assert totals.undelivered == 0
    assert sorted(heard) == sorted(found.total() for found in fates.of.values())
    assert all(set(found) == {pb.SENT} for found in fates.of.values())


@pytest.mark.asyncio
async def test_what_happens_to_all_sensors_at_once_is_few_lines(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sapient, "GATHER_S", 0.05)
    news = SapientNews()
    for i in range(200):
        news.tell(f"sapient-{i}", "lost it")
    news.tell("sapient-3", "found it")
    await until(lambda: len(told(caplog)) == 3)
    assert told(caplog) == [
        "sapient-0: lost it",
        "sapient-3: found it",
        "sapient: lost it, and so 199 more sensors",
    ]
    news.tell("sapient-0", "lost it")
    assert told(caplog)[3:] == ["sapient-0: lost it"]


@pytest.mark.asyncio
async def test_connections_speak_in_turn_within_both_limits() -> None:
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    intake = SapientIntake(max_messages_per_s=1000, max_octets_per_s=10_000)
    said = Counter[int]()

    async def talk(octets: int) -> None:
        """For a long time."""
        while True:
            await intake.turn(octets)
            said[octets] += 1

    long, short = (asyncio.create_task(talk(octets)) for octets in (500, 4))
    await until(lambda: said[500] >= 5)
    elapsed_s = loop.time() - began_s
    assert abs(said[500] - said[4]) <= 2  # the first has begun alone
    octets = said[500] * 500 + said[4] * 4
    assert octets <= 10_000 * (elapsed_s + AT_ONCE_S) + 500  # that are owed at most
    long.cancel()
    await asyncio.gather(long, return_exceptions=True)
    until_now = said.copy()
    await until(lambda: said[4] > until_now[4] + 5)
    assert said[500] == until_now[500]
    short.cancel()
    await asyncio.gather(short, return_exceptions=True)

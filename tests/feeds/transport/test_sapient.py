"""A node's connection to its middleware, polite, rude, deaf or away, in time that tests make."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections import Counter
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from sapient_msg.bsi_flex_335_v2_0.status_report_pb2 import StatusReport
from support.brokers import free_port
from support.deliveries import taken
from support.own_time import LoopClock, in_own_time
from support.sapient_middleware import Peer, linked, listening, polite, status_report
from support.sapient_rules import checked_together, task
from support.sessions import AtWork, at_work
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.formats.sapient.sapient_announcer import MAX_TASKS_PER_S
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.fields import split_address
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.session import run
from plotfeed.feeds.transport.sapient import (
    ACK_TIMEOUT_S,
    AT_ONCE_S,
    GATHER_S,
    MAX_UNSENT_OCTETS,
    REGISTER_AGAIN_S,
    SapientIntake,
    SapientNews,
    framed,
    next_message,
)
from plotfeed.feeds.transport.ways_out import BACKOFF_S, TransportError
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.testing import held, radar, rotating, scene, staring

ERROR = SapientMessage(error={"packet": b"x", "error_message": ["bad\x1b[31m"] * 1000})


@pytest.fixture(autouse=True)
def _heard(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)


def told(caplog: pytest.LogCaptureFixture) -> list[str]:
    lines = [r.getMessage() for r in caplog.records if r.name.startswith("plotfeed")]
    assert all(line.isprintable() and len(line) < 400 for line in lines)
    return lines


def now_s() -> float:
    return asyncio.get_running_loop().time()


@in_own_time
async def test_a_node_registers_first_and_then_reports_in_order_what_is_for_a_middleware() -> None:
    """However slow that is."""

    async def slow(peer: Peer) -> None:
        await peer.next()
        peer.acknowledge()
        while True:
            await peer.next()
            await asyncio.sleep(0.02)

    async with listening(slow) as middleware, linked(middleware.address) as link:
        assert taken(link, Message("t", b"x", "text/plain", 0))  # which is left to others
        sent = [status_report() for _ in range(100)]
        assert all(taken(link, message) for message in sent)
        await link.drain()
        (peer,) = middleware.peers
        await until(lambda: len(peer.heard) == 102)
        assert peer.kinds() == ["registration"] + ["status_report"] * 101
        assert [m.SerializeToString() for m in peer.heard[2:]] == [m.payload for m in sent]


@in_own_time
async def test_a_middleware_that_is_not_there_is_one_clear_error() -> None:
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))  # and does not listen
        for port in (nobody.getsockname()[1], free_port()):
            async with linked(f"127.0.0.1:{port}", wait=False) as link:
                assert not taken(link, status_report())
                with pytest.raises(TransportError, match="no SAPIENT middleware answers at 127"):
                    await link.wait_until_up(0.3)
            sapient = {"middleware": f"127.0.0.1:{port}"}
            flown = scene([radar(report=["sapient"])], seed=3, sapient=sapient)
            with pytest.raises(TransportError, match="no SAPIENT middleware"):
                await run(flown, broker="none", duration_s=1.0, clock=LoopClock())


async def cut_off(peer: Peer) -> None:
    """Amid a message of its own."""
    await peer.next()
    peer.acknowledge()
    await peer.next()
    peer.writer.write(b"\x40\0\0\0half")


async def reset(peer: Peer) -> None:
    await peer.next()
    peer.acknowledge()
    peer.writer.transport.abort()


async def hang_up(peer: Peer) -> None:
    """Without a word."""


async def boast(peer: Peer) -> None:
    await peer.next()
    peer.writer.write(b"\xff\xff\xff\xff" + b"x" * 100_000)
    await peer.hear_all()


@pytest.mark.parametrize("behave", [cut_off, reset, hang_up, boast])
@in_own_time
async def test_a_lost_connection_is_made_anew_and_registered_anew(
    behave: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """Whoever hangs up at once is not hurried."""
    behaviours = [*[behave] * 4, polite]
    began_s = now_s()
    async with listening(*behaviours) as middleware, linked(middleware.address, wait=False) as link:
        await until(lambda: len(middleware.peers) == 5)
        assert now_s() - began_s > sum(BACKOFF_S[:4]) - 0.01
        await link.wait_until_up(PATIENCE_S)
        last = middleware.peers[4]
        await until(lambda: taken(link, status_report()))
        await until(lambda: len(last.heard) >= 3)
        assert last.kinds()[:3] == ["registration", "status_report", "status_report"]
        assert last.heard[1].status_report.info == StatusReport.INFO_NEW
    if behave is cut_off:
        lost, again = told(caplog)
        assert lost.endswith("(the connection was closed)")
        assert again == f"sapient-radar: connected to {middleware.address} again"


@in_own_time
async def test_who_no_longer_reads_costs_no_memory_and_is_left_after_the_time_of_the_scene(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def deaf(peer: Peer) -> None:
        await peer.next()
        peer.acknowledge()
        peer.writer.transport.pause_reading()  # type: ignore[attr-defined]
        await asyncio.sleep(PATIENCE_S)

    async with (
        listening(deaf, polite) as middleware,
        linked(middleware.address, give_up_after_s=7.0) as link,
    ):
        message, refused, began_s = status_report(100_000), 0, now_s()
        while link.counters.connections < 2:  # it is noticed even if nothing more is sent
            if refused < 3:
                refused += not taken(link, message)
            assert link._wire is None or link._wire.unsent_octets <= MAX_UNSENT_OCTETS
            await asyncio.sleep(0.02)
        assert 7.0 <= now_s() - began_s < 12.0
        assert refused
        assert link.counters.stalls == link.counters.totals.sapient_stalls == 1
    lines = told(caplog)
    assert sum("it has read nothing for 7 s" in line for line in lines) == 1
    assert sum("again" in line for line in lines) == 1


@given(st.lists(st.binary(max_size=50), max_size=10), st.integers(1, 40))
def test_messages_are_put_together_however_they_come(messages: list[bytes], size: int) -> None:
    async def test() -> list[bytes]:
        stream, octets = b"".join(map(framed, messages)), asyncio.StreamReader()
        hearing = asyncio.gather(*(next_message(octets) for _ in messages[:1]))
        await asyncio.sleep(0)
        for start in range(0, len(stream), size):
            octets.feed_data(stream[start : start + size])
        octets.feed_eof()
        return [*await hearing, *[await next_message(octets) for _ in messages[1:]]]

    assert asyncio.run(test()) == messages


def test_addresses_are_a_host_and_a_port() -> None:
    assert split_address("middleware.example:1") == ("middleware.example", 1)
    assert split_address("[::1]:65535") == ("::1", 65535)
    for text in ("", ":1", "host", "host:", "host:0", "host:65536", "a b:1", "::1:5", "u@h:1"):
        with pytest.raises(ValueError, match="expected HOST:PORT"):
            split_address(text)


@pytest.mark.parametrize("says", [b"", b"\xff" * 40])
@in_own_time
async def test_a_node_reports_whatever_else_is_said_to_its_registration(
    says: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    async def rude(peer: Peer) -> None:
        await peer.next()
        peer.send(says)
        await peer.hear_all()

    began_s = now_s()
    async with listening(rude) as middleware, linked(middleware.address) as link:
        assert now_s() - began_s >= ACK_TIMEOUT_S
        assert taken(link, status_report())
        (peer,) = middleware.peers
        await until(lambda: len(peer.heard) == 3)
        assert link.counters.reporting
        assert link.counters.errors == 1
    complaint, silence = told(caplog)
    assert "complains: it sent" in complaint
    assert "did not acknowledge" in silence


@in_own_time
async def test_a_node_that_is_refused_asks_again_and_reports_nothing_and_says_so_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
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
        began_s = now_s()
        await asyncio.sleep(4 * REGISTER_AGAIN_S)
        await until(lambda: link.counters.reporting)
        assert now_s() - began_s == pytest.approx(5 * REGISTER_AGAIN_S, abs=1.0)
        (peer,) = middleware.peers
        assert taken(link, status_report())
        await until(lambda: len(peer.heard) == 8)
        assert peer.kinds() == ["registration"] * 6 + ["status_report"] * 2
        assert link.counters.refusals == link.counters.totals.sapient_refusals == 5
        peer.acknowledge("enough", accepted=False)  # a registration can be refused later, too
        await until(lambda: not link.counters.reporting)
        assert not taken(link, status_report())
        peer.acknowledge()
        await until(lambda: link.counters.reporting)
        assert taken(link, status_report())
    line, *_ = told(caplog)
    assert line.endswith("refused the registration: no room here")


@in_own_time
async def test_errors_are_counted_and_told_in_few_lines(caplog: pytest.LogCaptureFixture) -> None:
    async def complaining(peer: Peer) -> None:
        await peer.next()
        peer.acknowledge()
        for _ in range(250):
            peer.send(ERROR.SerializeToString())
        await peer.hear_all()

    async with listening(complaining) as middleware, linked(middleware.address) as link:
        await until(lambda: link.counters.errors == 250)
        assert link.counters.totals.sapient_errors == 250
        assert taken(link, status_report())
    lines = [line for line in told(caplog) if "more sensors" not in line]
    assert ["complains: " in line for line in lines] == [True, False, False]
    assert [line.partition(" (")[2].split(" ")[0] for line in lines] == ["", "10", "100"]


@pytest.mark.skipif(not hasattr(socket, "TCP_USER_TIMEOUT"), reason="Linux alone has it")
@in_own_time
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


def watched(address: str, *names: str, **keys: Any) -> Scene:
    """Radars of those names that stare at a drone, each a node of that middleware."""
    sensors = [radar(id=name, report=["sapient"], scan=staring(0.1)) for name in names]
    drone = held("d", 45.0, 20.0, 1000.0, rcs_m2=1.0)
    return scene(sensors, [drone], seed=3, sapient={"middleware": address, **keys})


async def session_of(flown: Scene, duration_s: float) -> AtWork:
    """A session that is over, by the time of the loop."""
    async with at_work(flown, None, clock=LoopClock(), duration_s=duration_s) as session:
        pass
    return session


def fates(session: AtWork) -> dict[str, Counter[int]]:
    """Of the detections of each sensor, as the ledger has them."""
    found: dict[str, Counter[int]] = {}
    for entry in session.entries:
        found.setdefault(entry.sensor, Counter()).update(one.fate for one in entry.messages)
    return found


@in_own_time
async def test_a_node_that_is_refused_costs_no_other_anything() -> None:
    """Detections of the one are undelivered, as the ledger says; those of the other are sent."""

    async def choosy(peer: Peer) -> None:
        accepted = (await peer.next()).registration.name == "good"
        peer.acknowledge("not you", accepted=accepted)
        await peer.hear_all()

    async with listening(choosy) as middleware:
        session = await session_of(watched(middleware.address, "good", "bad"), 2.0)
    of, totals = fates(session), session.totals
    assert totals.sapient_refusals == 1
    good, bad = (session.told(f"{name}/status")[0]["sapient"] for name in ("good", "bad"))
    assert (good["reporting"], good["connections"], good["refusals"]) == (True, "1", "0")
    assert (bad.get("reporting", False), bad["connections"], bad["refusals"]) == (False, "1", "1")
    assert (set(of["good"]), set(of["bad"])) == ({pb.SENT}, {pb.UNDELIVERED})
    assert totals.undelivered == of["bad"].total() > 5
    heard = {peer.heard[0].registration.name: peer.kinds() for peer in middleware.peers}
    assert set(heard["bad"]) == {"registration"}
    assert heard["good"].count("detection_report") == of["good"].total()


@pytest.mark.parametrize("says", ["errors", "empty", "tasks"])
@in_own_time
async def test_a_middleware_that_never_stops_talking_is_made_to_wait(says: str) -> None:
    """It says as much as it may in a second, however many connections it says it over."""
    error = SapientMessage(error={"packet": b"x", "error_message": ["no"]}).SerializeToString()
    said = {"errors": error, "empty": b"", "tasks": task(request="Status")}[says]

    async def talk(peer: Peer) -> None:
        while not peer.writer.is_closing():
            peer.writer.write(framed(said) * 200)
            await peer.writer.drain()

    async def talkative(peer: Peer) -> None:
        await peer.next()
        peer.acknowledge()
        talking = asyncio.create_task(talk(peer))
        await peer.hear_all()
        talking.cancel()
        with suppress(asyncio.CancelledError, ConnectionError):
            await talking

    most_per_s = 200
    async with listening(talkative) as middleware:
        flown = watched(middleware.address, "a", "b", "c", max_messages_per_s=most_per_s)
        began_s = now_s()
        session = await session_of(flown, 3.0)
        took_s, totals = now_s() - began_s, session.totals
        await until(lambda: all(peer.kinds()[-1] == "status_report" for peer in middleware.peers))
    taken_in = totals.sapient_errors + totals.sapient_tasks + totals.sapient_rejected
    assert 0.5 * most_per_s < taken_in <= most_per_s * (took_s + AT_ONCE_S)
    assert totals.sapient_tasks <= MAX_TASKS_PER_S * len(flown.sensor) * (took_s + 1)
    assert (totals.sapient_tasks > 0) == (says == "tasks")
    assert totals.undelivered == 0
    heard = [peer.kinds().count("detection_report") for peer in middleware.peers]
    assert sorted(heard) == sorted(found.total() for found in fates(session).values())
    assert all(set(found) == {pb.SENT} for found in fates(session).values())


@in_own_time
async def test_a_session_connects_every_sensor_that_reports_it_and_says_goodbye() -> None:
    sensors = [
        radar(id="turning", report=["sapient"], scan=rotating(0.5, 16), pfa=1e-5),
        radar(id="staring", report=["sapient"], scan=staring(0.1)),
        radar(id="other", report=["plots"]),
    ]
    async with listening() as middleware:
        sapient = {"middleware": middleware.address, "status_interval_s": 0.5}
        drones = [held("d", 45.0, 20.0, 1000.0, rcs_m2=1.0)]
        session = await session_of(scene(sensors, drones, seed=3, sapient=sapient), 3.0)
        assert session.totals.undelivered == 0
        await until(lambda: all(peer.reader.at_eof() for peer in middleware.peers))
    names = {peer.heard[0].registration.name for peer in middleware.peers}
    assert names == {"turning", "staring"}
    assert len({peer.heard[0].node_id for peer in middleware.peers}) == len(middleware.peers) == 2
    for peer in middleware.peers:
        assert peer.kinds()[:2] == ["registration", "status_report"]
        assert peer.kinds().count("detection_report") > 3
        assert peer.heard[-1].status_report.system == StatusReport.SYSTEM_GOODBYE
        checked_together(peer.heard)


@in_own_time
async def test_what_happens_to_all_sensors_at_once_is_few_lines(
    caplog: pytest.LogCaptureFixture,
) -> None:
    news = SapientNews()
    for i in range(200):
        news.tell(f"sapient-{i}", "lost it")
    news.tell("sapient-3", "found it")
    await asyncio.sleep(GATHER_S + 0.01)
    news.tell("sapient-0", "lost it")
    assert told(caplog) == [
        "sapient-0: lost it",
        "sapient-3: found it",
        "sapient: lost it, and so 199 more sensors",
        "sapient-0: lost it",
    ]


@in_own_time
async def test_connections_speak_in_turn_within_both_limits() -> None:
    began_s, said = now_s(), Counter[int]()
    intake = SapientIntake(max_messages_per_s=1000, max_octets_per_s=10_000)

    async def talk(octets: int) -> None:
        """For a long time."""
        while True:
            await intake.turn(octets)
            said[octets] += 1

    long, short = (asyncio.create_task(talk(octets)) for octets in (500, 4))
    await until(lambda: said[500] >= 5)
    elapsed_s = now_s() - began_s
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

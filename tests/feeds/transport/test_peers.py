"""Strangers at a door have turns and places; what they use up is bounded, and what is lost told."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Iterator
from itertools import count
from random import Random

import pytest
from fuzz.first_seeds import OF_TARGET
from fuzz.targets import NS_2026
from support.own_time import in_own_time

from plotfeed.feeds.scene.telemetry_keys import KINDS, TelemetrySource
from plotfeed.feeds.telemetry.fair_queue import MAX_OF_TOPIC
from plotfeed.feeds.telemetry.live.aircraft import MAX_LINE_OCTETS, AircraftReports
from plotfeed.feeds.telemetry.live.heard import HeardReport, Listener
from plotfeed.feeds.telemetry.live.remote_id import RemoteIdReports
from plotfeed.feeds.telemetry.position_report import PositionReport, Reason, Refused
from plotfeed.feeds.transport.live_source import listener_of
from plotfeed.feeds.transport.peers import AT_ONCE_S, SLICE_OCTETS, PeerLimits, PeerTurns, Places
from plotfeed.models.state import AltitudeReference

STEP_S = AT_ONCE_S / 10  # What the clock of these tests goes on by when it is looked at
REPORT = PositionReport(
    t_utc_ns=1,
    latitude_deg=40.0,
    longitude_deg=-3.0,
    altitude_m=9.0,
    altitude_reference=AltitudeReference.ELLIPSOID,
)


class Echo(Listener):
    """A report for each dot, of a drone that is called as its peer; breaks at an x."""

    def __init__(self) -> None:
        self.forgotten: list[str] = []

    def hear(self, peer: str, data: bytes, now_utc_ns: int) -> Iterator[HeardReport]:
        del now_utc_ns
        for octet in data:
            if octet == ord("x"):
                raise OverflowError
            if octet == ord("."):
                yield HeardReport(peer, REPORT)

    def forget(self, peer: str) -> None:
        self.forgotten.append(peer)


class Door:
    """Turns of peers, by a clock that goes on by a step whenever it is looked at."""

    def __init__(self, listener: Listener | None = None, now_utc_ns: int = 0) -> None:
        self.listener, self.said = listener or Echo(), list[HeardReport]()
        looks = count(1)
        self.turns = PeerTurns(
            self.listener,
            say=self.said.append,
            note=print,
            now_utc_ns=lambda: now_utc_ns,
            now_s=lambda: next(looks) * STEP_S,
        )

    @property
    def reasons(self) -> Counter[str]:
        refused = [h.said for h in self.said if isinstance(h.said, Refused)]
        return Counter(r.reason for r in refused for _ in range(r.count))


@in_own_time
async def test_what_has_no_room_is_refused_and_counted_and_others_have_theirs() -> None:
    for ends_before_a_turn in (True, False):
        door = Door()
        for _ in range(MAX_OF_TOPIC + 7):
            door.turns.put("loud", b".")
        door.turns.put("quiet", b".")
        if ends_before_a_turn:
            door.turns.close()
        else:
            await door.turns.emptied()
        assert door.reasons == {Reason.FLOOD: 7}
        heard = sum(heard.drone == "quiet" for heard in door.said)
        assert heard == (not ends_before_a_turn)


@in_own_time
async def test_a_flood_is_given_a_share_of_the_time_and_peers_equal_shares_of_that() -> None:
    door = Door()
    for _ in range(MAX_OF_TOPIC):
        door.turns.put("loud", b"." * 10)
    door.turns.put("quiet", b".")
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert 0 < len(door.said) <= AT_ONCE_S / STEP_S  # then others have the loop
    await door.turns.emptied()
    by = [heard.drone for heard in door.said]
    assert by.index("quiet") <= 10  # after one turn of the other
    assert len(by) == 10 * MAX_OF_TOPIC + 1
    assert not door.reasons


@in_own_time
async def test_a_stream_waits_for_its_turn_and_loses_nothing() -> None:
    door, data = Door(), b".".rjust(SLICE_OCTETS) * (MAX_OF_TOPIC * 3)
    hearing = asyncio.create_task(door.turns.hear("loud", data))
    await asyncio.sleep(0)
    assert not hearing.done()
    await hearing
    door.turns.gone("loud")
    await door.turns.emptied()
    assert len(door.said) == 3 * MAX_OF_TOPIC
    assert isinstance(door.listener, Echo)
    assert door.listener.forgotten == ["loud"]


@in_own_time
async def test_octets_at_which_a_reader_breaks_are_refused_in_a_line() -> None:
    door = Door()
    for data in (b"..x..", b"."):
        door.turns.put("peer", data)
    await door.turns.emptied()
    assert door.reasons == {Reason.UNDECODABLE: 1}
    assert len(door.said) == 4


@in_own_time
async def test_who_never_asks_gives_way_and_the_host_that_has_most_first() -> None:
    left: list[str] = []
    places = Places[str](PeerLimits(peers=4, octets=1))
    for who, host in (("own", "a"), ("b1", "b"), ("b2", "b"), ("b3", "b")):
        places.take(who, host, lambda who=who: left.append(who))  # type: ignore[misc]
    places.heard("b1")
    places.take("c", "c", lambda: left.append("c"))
    places.take("b4", "b", lambda: left.append("b4"))
    assert left == ["b2", "b3"]
    assert "own" in places
    for n in range(1000):
        places.take(f"b{n + 5}", "b", lambda: left.append("b"))
    assert len(places._held) == 4
    assert "own" in places
    assert "c" in places


@in_own_time
async def test_patience_ends_however_much_is_said() -> None:
    left: list[str] = []
    places = Places[str](PeerLimits(peers=4, octets=1, patience_s=5.0))
    places.take("drips", "a", lambda: left.append("drips"))
    places.take("asks", "a", lambda: left.append("asks"))
    places.give_up("asks")
    await asyncio.sleep(4.9)
    places.heard("drips")
    assert not left
    await asyncio.sleep(0.2)
    assert left == ["drips"]
    assert not len(places._held)


def test_senders_without_number_are_forgotten() -> None:
    heard = RemoteIdReports("{id}")
    identity = b"\x02\x12" + b"1581F4XF".ljust(20, b"\0") + bytes(3)
    for n in range(1_200):
        list(heard.hear(f"1.2.3.4:{n}", identity, 0))
    assert len(heard._identities) == 1_000


def test_lines_without_end_are_refused_and_nothing_is_kept_of_them() -> None:
    listener = AircraftReports("sbs1", "{icao}")
    line = b"MSG,3,1,1," + b"A" * 60_000 + b",1,,,,,,10000,,,52.25,3.9,,,,,,0\n"
    refused = [h.said for n in range(50) for h in listener.hear(f"p{n}", line, 0)]
    assert len(refused) == 50
    assert all(isinstance(said, Refused) and said.reason is Reason.OVERSIZED for said in refused)
    for n in range(1000):
        list(listener.hear(f"p{n}", b"A" * MAX_LINE_OCTETS, 0))
    kept = sum(len(rest) for rest in listener._lines.values())
    assert kept <= 256 * MAX_LINE_OCTETS
    assert not listener._aircraft


def misbehave(turns: PeerTurns, way: str, octets: bytes, rng: Random, step: int) -> None:
    """What one bad peer, or many, do meanwhile."""
    if way == "garbage":
        turns.put("bad", rng.randbytes(500))
    elif way == "flood":
        for _ in range(100):
            turns.put(f"bad {rng.randrange(9)}", rng.randbytes(100))
    elif way == "drip":
        turns.put("bad", octets[step : step + 1])
    else:
        turns.put(f"bad {step}", octets[: len(octets) // 3])
        if way == "disconnect":
            turns.gone(f"bad {step}")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("way", ["garbage", "flood", "drip", "cut", "disconnect"])
@in_own_time
async def test_whatever_one_peer_does_another_is_heard_as_if_alone(kind: str, way: str) -> None:
    octets, rng = next(iter(OF_TARGET[f"live-{kind}"]()))[1:], Random(way)  # noqa: S311
    found = []
    for is_alone in (True, False):
        door = Door(listener_of(TelemetrySource(url=f"{kind}:udp::1")), NS_2026)
        for step in range(3):
            if not is_alone:
                misbehave(door.turns, way, octets, rng, step)
            door.turns.put("good", octets)
            await door.turns.emptied()
        found.append([heard for heard in door.said if isinstance(heard.said, PositionReport)])
    assert found[0] == found[1]
    assert found[0] or kind == "mavlink"

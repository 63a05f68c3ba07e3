"""ASTERIX by UDP, as an ordinary socket receives it."""

from __future__ import annotations

import errno
import os
import socket
import struct
from pathlib import Path

import pytest
from support.brokers import free_port, has_ipv6
from support.command import plotfeed
from support.deliveries import taken
from support.scene_files import radar, scene_file
from support.udp_receiver import (
    LOOPBACK_INTERFACE,
    destination,
    heard,
    interface_of,
    place,
    receiver,
    scene_with,
    simulated,
)

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import UdpDestination
from plotfeed.feeds.scene.scene import SceneError, load
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.feeds.transport.udp import UdpTransport
from plotfeed.feeds.transport.ways_out import TransportError
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.codec.decode import decode_lenient
from plotfeed.proto.ledger import entries_in

# Of this machine or this interface alone, as far as scopes are kept.
GROUP_4, GROUP_6 = "239.255.77.77", "ff11::7:7"
IP_RECVTTL = 12  # Of Linux, and unknown to Python


def asterix(sent: list[Message], *sensors: str) -> list[bytes]:
    return [
        m.payload
        for m in sent
        if "/asterix/" in m.topic and (not sensors or m.topic.split("/")[1] in sensors)
    ]


@pytest.mark.asyncio
async def test_what_is_asterix_goes_out_in_the_order_in_which_it_left(tmp_path: Path) -> None:
    with receiver() as ears:
        totals, sent, got = await simulated(
            tmp_path, scene_with(destination(place(ears))), listener=ears
        )
    assert got == asterix(sent)
    assert totals.undelivered == 0
    categories = [datagram[0] for datagram in got]
    assert {34, 48} == set(categories)
    # A sector's plots come before the service message that ends it: both bear a time of day.
    ends = 0.0
    for datagram in got:
        records, errors = decode_lenient(datagram)
        assert not errors
        for record in records:
            seconds = record.get(
                f"I{record.category:03d}/{'030' if record.category == 34 else 140}"
            )
            assert isinstance(seconds, float)
            if record.category == 34:
                assert seconds >= ends
                ends = seconds
            else:
                assert seconds >= ends


@pytest.mark.parametrize("max_octets", [64, 200, 1400])
@pytest.mark.asyncio
async def test_every_datagram_is_whole_blocks_and_no_larger_than_asked(
    tmp_path: Path, max_octets: int
) -> None:
    crowded = radar(period_s=0.5, sectors=4, more="doppler_cells = 200")
    with receiver() as ears:
        text = scene_with(destination(place(ears), max_octets=max_octets), crowded)
        totals, sent, got = await simulated(tmp_path, text, 2.0, ears)
    assert got == asterix(sent)
    assert max(map(len, got)) <= max_octets
    assert max(map(len, got)) > max_octets * 0.7
    found = 0
    for datagram in got:
        assert len(datagram) == int.from_bytes(datagram[1:3], "big")  # one block and nothing more
        records, errors = decode_lenient(datagram)
        assert not errors
        found += sum(record.category == 48 for record in records)
    assert found == totals.plots


@pytest.mark.asyncio
async def test_each_destination_gets_its_own_sensors(tmp_path: Path) -> None:
    sensors = radar("one", period_s=0.5) + radar("two", period_s=0.5)
    with receiver() as all_ears, receiver() as ears:
        udp = destination(place(all_ears)) + destination(place(ears), sensors=["two"])
        _, sent, got = await simulated(tmp_path, scene_with(udp, sensors), 2.0, all_ears)
        assert got == asterix(sent)
        assert heard(ears) == asterix(sent, "two")
    assert asterix(sent, "one")


@pytest.mark.asyncio
async def test_nobody_listening_is_nobodys_trouble(tmp_path: Path) -> None:
    totals, _, _ = await simulated(tmp_path, scene_with(destination(f"127.0.0.1:{free_port()}")))
    assert totals.messages > 50
    assert totals.undelivered == 0


@pytest.mark.skipif(not has_ipv6(), reason="this machine has no IPv6 loopback")
@pytest.mark.asyncio
async def test_ipv6_carries_it_too(tmp_path: Path) -> None:
    with receiver("::1") as ears:
        _, sent, got = await simulated(
            tmp_path, scene_with(destination(place(ears))), listener=ears
        )
    assert got == asterix(sent) != []


@pytest.mark.parametrize("interface", ["127.0.0.1", LOOPBACK_INTERFACE])
@pytest.mark.asyncio
async def test_a_group_is_reached_by_the_interface_of_the_scene(
    tmp_path: Path, interface: str
) -> None:
    with receiver("127.0.0.1", GROUP_4) as one, receiver("127.0.0.1", GROUP_4) as other:
        udp = destination(place(one), interface=interface, ttl=0)
        udp += destination(place(other), interface=interface, ttl=0)
        _, sent, got = await simulated(tmp_path, scene_with(udp), listener=one)
        assert got == asterix(sent) != []
        assert heard(other) == got


@pytest.mark.skipif(not has_ipv6(), reason="this machine has no IPv6 loopback")
@pytest.mark.asyncio
async def test_a_group_of_ipv6_is_reached(tmp_path: Path) -> None:
    with receiver("::1", GROUP_6) as ears:
        udp = destination(place(ears), interface=interface_of(GROUP_6), ttl=0)
        _, sent, got = await simulated(tmp_path, scene_with(udp), listener=ears)
    assert got == asterix(sent) != []


@pytest.mark.parametrize(("group", "ttl"), [(GROUP_4, 1), (GROUP_4, 7), (GROUP_6, 3)])
def test_datagrams_may_go_as_far_as_the_scene_says(group: str, ttl: int) -> None:
    if ":" in group and not has_ipv6():
        pytest.skip("this machine has no IPv6 loopback")
    host = "::1" if ":" in group else "127.0.0.1"
    with receiver(host, group) as ears:
        level, wanted, kind = socket.IPPROTO_IP, IP_RECVTTL, socket.IP_TTL
        if ":" in group:
            level, wanted = socket.IPPROTO_IPV6, socket.IPV6_RECVHOPLIMIT
            kind = socket.IPV6_HOPLIMIT
        ears.setsockopt(level, wanted, 1)
        settings = UdpDestination(destination=place(ears), ttl=ttl, interface=interface_of(group))
        link = UdpTransport(settings)
        link.open()
        try:
            assert taken(link, block())
        finally:
            link.close()
        data, extra, _, _ = ears.recvmsg(100, 100)
    assert data == block().payload
    ((found_level, found_kind, packed),) = extra
    assert (found_level, found_kind) == (level, kind)
    assert struct.unpack("@i", packed) == (ttl,)


def block(octets: int = 3) -> Message:
    return Message(
        topic="t",
        payload=bytes([48]) + octets.to_bytes(2, "big") + bytes(octets - 3),
        content_type="application/x-asterix; cat=48",
        due_utc_ns=0,
    )


def test_what_the_system_does_not_take_is_not_delivered() -> None:
    link = UdpTransport(UdpDestination(destination="127.0.0.1:8600"))
    assert not taken(link, block())  # not open
    link.open()
    try:
        assert not taken(link, block(65_535))  # no datagram is as large
        assert taken(link, block())
    finally:
        link.close()
    link.close()


@pytest.mark.asyncio
async def test_an_interface_that_is_not_there_is_an_error_that_names_its_key(
    tmp_path: Path,
) -> None:
    for group, name in ((GROUP_4, "192.0.2.99"), (GROUP_4, "nowhere0"), (GROUP_6, "nowhere0")):
        to = f"[{group}]:8600" if ":" in group else f"{group}:8600"
        good = destination("127.0.0.1:8600")
        scene = scene_file(tmp_path, scene_with(good + destination(to, interface=name)))
        with pytest.raises(TransportError) as caught:
            await run(load(scene), broker="none", duration_s=1)
        assert str(caught.value).startswith(f"udp[1].interface: '{name}': ")
        assert caught.value.exit_code == 1
    done = plotfeed("run", scene, "--broker", "none")
    assert done.returncode == 1
    assert done.stderr.startswith("plotfeed: udp[1].interface: 'nowhere0': ")
    assert len(done.stderr.splitlines()) == 1


EXPECTED = "expected ADDRESS:PORT such as 239.255.0.1:8600 or [ff15::1]:8600, not "
MISTAKES = {
    'destination = "localhost:8600"': f"udp[0].destination: {EXPECTED}'localhost:8600'",
    'destination = "239.1.2.3"': f"udp[0].destination: {EXPECTED}'239.1.2.3'",
    'destination = "239.1.2.3:0"': f"udp[0].destination: {EXPECTED}'239.1.2.3:0'",
    'destination = "239.1.2.3:65536"': f"udp[0].destination: {EXPECTED}'239.1.2.3:65536'",
    'destination = "ff15::1:8600"': f"udp[0].destination: {EXPECTED}'ff15::1:8600'",
    'destination = "0.0.0.0:8600"': "udp[0].destination: expected the address of one host or a "
    "multicast group, not 0.0.0.0",
    'destination = "[fe80::1]:8600"': "udp[0].destination: a link-local address needs its "
    "interface, such as fe80::1%eth0",
    'destination = "10.0.0.1:1"\ninterface = "eth0"': "udp[0].interface: only for multicast, which "
    "10.0.0.1:1 is not",
    'destination = "239.1.2.3:1"\ninterface = ""': "udp[0].interface: expected the name of one, or "
    "its address",
    'destination = "239.1.2.3:1"\nttl = 256': "udp[0].ttl: input should be less than or equal to "
    "255, not 256",
    'destination = "239.1.2.3:1"\nmax_octets = 10': "udp[0].max_octets: input should be greater "
    "than or equal to 64, not 10",
    'destination = "239.1.2.3:1"\nsensors = ["raddar"]': "udp[0].sensors: no sensor has the id "
    "'raddar'",
    "ttl = 3": "udp[0].destination: missing",
}


@pytest.mark.parametrize("keys", MISTAKES)
def test_a_mistake_is_one_line_that_names_its_key(tmp_path: Path, keys: str) -> None:
    path = scene_file(tmp_path, scene_with(f"[[udp]]\n{keys}\n"))
    with pytest.raises(SceneError) as caught:
        load(path)
    place, _, told = str(caught.value).partition(": udp")
    assert place.startswith(f"{path}: line ")
    assert f"udp{told}" == MISTAKES[keys]


def test_a_run_says_where_datagrams_go(tmp_path: Path) -> None:
    udp = destination("127.0.0.1:8600", sensors=["radar"])
    udp += destination(f"{GROUP_4}:8600", interface="127.0.0.1", ttl=2)
    options = ("--broker", "none", "--speed", "max", "--duration", "1")
    done = plotfeed("run", scene_file(tmp_path, scene_with(udp)), *options)
    assert done.returncode == 0
    assert "  UDP         127.0.0.1:8600 (ASTERIX of radar)\n" in done.stdout
    assert f"  UDP         {GROUP_4}:8600 (ASTERIX, multicast with TTL 2)\n" in done.stdout


NO_ROUTE = "192.0.2.1:9"  # Of documentation, RFC 5737


class Unrouted(socket.socket):
    """Has no route there, whatever this machine has."""

    def sendto(self, data: bytes, address: tuple[str, int]) -> int:  # type: ignore[override]
        if address[0] == "192.0.2.1":
            raise OSError(errno.ENETUNREACH, os.strerror(errno.ENETUNREACH))
        return super().sendto(data, address)


@pytest.fixture
def no_route(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("plotfeed.feeds.transport.udp.socket.socket", Unrouted)


@pytest.mark.asyncio
async def test_a_destination_without_a_route_takes_nothing_from_others(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, no_route: None
) -> None:
    """What arrived elsewhere was sent; who did not get it is told by name, and once in the log."""
    with receiver() as ears:
        udp = destination(place(ears)) + destination(NO_ROUTE)
        entries = Entries()
        scene = load(scene_file(tmp_path, scene_with(udp)))
        totals = await run(
            scene,
            clock=InstantClock(scene.scene.start_utc_ns),
            broker="none",
            duration_s=4.0,
            observers=[entries],
        )
        got = heard(ears)
    name = f"udp[1] {NO_ROUTE}"
    sent = [one for entry in entries.made for one in entry.messages]
    of_asterix = [one for one in sent if "/asterix/" in one.topic]
    assert len(got) == len(of_asterix) > 10
    assert {one.fate for one in sent} == {pb.SENT}
    assert {(*one.not_to,) for one in of_asterix} == {(name,)}
    assert {(*one.not_to,) for one in sent if one not in of_asterix} == {()}
    assert (totals.undelivered, totals.undelivered_to) == (0, {name: len(got)})
    assert totals.messages == len(sent)
    (line,) = [r.getMessage() for r in caplog.records]
    assert line == f"{name} gets nothing: Network is unreachable; others do"


@pytest.mark.asyncio
async def test_what_no_destination_got_is_undelivered(tmp_path: Path, no_route: None) -> None:
    totals, _, _ = await simulated(tmp_path, scene_with(destination(NO_ROUTE)))
    assert totals.undelivered == totals.undelivered_to[f"udp[0] {NO_ROUTE}"] > 10


class Entries(Observer):
    """Of the ledger."""

    def __init__(self) -> None:
        self.made: list[pb.Ledger] = []

    def ledger(self, message: Message) -> None:
        self.made += entries_in(message.payload)

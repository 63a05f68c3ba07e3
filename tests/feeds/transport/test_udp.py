"""ASTERIX by UDP, as an ordinary socket receives it."""

from __future__ import annotations

import errno
import os
import socket
import struct
from pathlib import Path

import pytest
from support import sessions
from support.brokers import free_port, has_ipv6
from support.command import plotfeed_here
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
from plotfeed.feeds.session.session import run
from plotfeed.feeds.transport.udp import UdpTransport
from plotfeed.feeds.transport.ways_out import TransportError
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.codec.decode import decode_lenient

needs_ipv6 = pytest.mark.skipif(not has_ipv6(), reason="this machine has no IPv6 loopback")
# Of this machine or this interface alone, as far as scopes are kept.
GROUP_4, GROUP_6 = "239.255.77.77", "ff11::7:7"
# Options that tell how far a datagram may still go; 12 is IP_RECVTTL of Linux.
OF_HOPS = (
    (socket.IPPROTO_IP, 12, socket.IP_TTL),
    (socket.IPPROTO_IPV6, socket.IPV6_RECVHOPLIMIT, socket.IPV6_HOPLIMIT),
)


def asterix(sent: list[Message], *sensors: str) -> list[bytes]:
    return [
        m.payload
        for m in sent
        if "/asterix/" in m.topic and (not sensors or m.topic.split("/")[1] in sensors)
    ]


@pytest.mark.parametrize(
    ("host", "max_octets"), [("127.0.0.1", 64), pytest.param("::1", 1400, marks=needs_ipv6)]
)
def test_what_is_asterix_goes_out_in_order_in_whole_blocks_no_larger_than_asked(
    tmp_path: Path, host: str, max_octets: int
) -> None:
    """A sector's plots come before the service message that ends it; both bear a time of day."""
    crowded = radar(period_s=0.5, sectors=4, more="doppler_cells = 200")
    with receiver(host) as ears:
        text = scene_with(destination(place(ears), max_octets=max_octets), crowded)
        totals, sent, got = simulated(tmp_path, text, 2.0, ears)
    assert got == asterix(sent)
    assert totals.undelivered == 0
    assert max_octets * 0.7 < max(map(len, got)) <= max_octets
    plots, ends = 0, 0.0
    for datagram in got:
        assert len(datagram) == int.from_bytes(datagram[1:3], "big")  # one block and nothing more
        records, errors = decode_lenient(datagram)
        assert not errors
        for record in records:
            is_plot = record.category == 48
            seconds = record.get("I048/140" if is_plot else "I034/030")
            assert isinstance(seconds, float)
            assert seconds >= ends
            plots, ends = plots + is_plot, ends if is_plot else seconds
    assert {datagram[0] for datagram in got} == {34, 48}
    assert plots == totals.plots > 0


def test_each_destination_gets_its_own_sensors(tmp_path: Path) -> None:
    sensors = radar("one", period_s=0.5) + radar("two", period_s=0.5)
    with receiver() as all_ears, receiver() as ears:
        udp = destination(place(all_ears)) + destination(place(ears), sensors=["two"])
        _, sent, got = simulated(tmp_path, scene_with(udp, sensors), 2.0, all_ears)
        assert got == asterix(sent)
        assert heard(ears) == asterix(sent, "two")
    assert asterix(sent, "one")


def sent_to(folder: Path, udp: str) -> sessions.AtWork:
    """A session in simulated time that sends to those destinations."""
    return sessions.simulated(load(scene_file(folder, scene_with(udp))), 4.0)


def test_nobody_listening_is_nobodys_trouble(tmp_path: Path) -> None:
    totals = sent_to(tmp_path, destination(f"127.0.0.1:{free_port()}")).totals
    assert totals.messages > 50
    assert totals.undelivered == 0


@pytest.mark.parametrize(
    ("group", "interface"),
    [
        (GROUP_4, "127.0.0.1"),
        (GROUP_4, LOOPBACK_INTERFACE),
        pytest.param(GROUP_6, "", marks=needs_ipv6),
    ],
)
def test_a_group_is_reached_by_the_interface_of_the_scene(
    tmp_path: Path, group: str, interface: str
) -> None:
    host, interface = "::1" if group == GROUP_6 else "127.0.0.1", interface or interface_of(group)
    with receiver(host, group) as one, receiver(host, group) as other:
        udp = destination(place(one), interface=interface, ttl=0)
        udp += destination(place(other), interface=interface, ttl=0)
        _, sent, got = simulated(tmp_path, scene_with(udp), 4.0, one)
        assert got == asterix(sent) != []
        assert heard(other) == got


@pytest.mark.parametrize(
    ("group", "ttl"), [(GROUP_4, 7), pytest.param(GROUP_6, 3, marks=needs_ipv6)]
)
def test_datagrams_may_go_as_far_as_the_scene_says(group: str, ttl: int) -> None:
    host = "::1" if ":" in group else "127.0.0.1"
    with receiver(host, group) as ears:
        level, wanted, kind = OF_HOPS[":" in group]
        ears.setsockopt(level, wanted, 1)
        settings = UdpDestination(destination=place(ears), ttl=ttl, interface=interface_of(group))
        link = UdpTransport(settings)
        link.open()
        assert taken(link, block())
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
    assert not taken(link, block(65_535))  # no datagram is as large
    assert taken(link, block())
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


EXPECTED = "expected ADDRESS:PORT such as 239.255.0.1:8600 or [ff15::1]:8600, not "
ONE = "expected the address of one host or a multicast group, not "
LOCAL = "a link-local address needs its interface, such as fe80::1%eth0"
LEAST = "input should be greater than or equal to 64"
MOST = "input should be less than or equal to 255"
# A destination, further keys, and which key is wrong and why.
MISTAKES = [
    ("localhost:8600", "", f"destination: {EXPECTED}'localhost:8600'"),
    ("239.1.2.3:0", "", f"destination: {EXPECTED}'239.1.2.3:0'"),
    ("ff15::1:8600", "", f"destination: {EXPECTED}'ff15::1:8600'"),
    ("0.0.0.0:8600", "", f"destination: {ONE}0.0.0.0"),  # noqa: S104
    ("[fe80::1]:8600", "", f"destination: {LOCAL}"),
    ("10.0.0.1:1", 'interface = "eth0"', "interface: only for multicast, which 10.0.0.1:1 is not"),
    ("239.1.2.3:1", 'interface = ""', "interface: expected the name of one, or its address"),
    ("239.1.2.3:1", "ttl = 256", f"ttl: {MOST}, not 256"),
    ("239.1.2.3:1", "max_octets = 10", f"max_octets: {LEAST}, not 10"),
    ("239.1.2.3:1", 'sensors = ["raddar"]', "sensors: no sensor has the id 'raddar'"),
    ("", "ttl = 3", "destination: missing"),
]


def test_a_mistake_is_one_line_that_names_its_key(tmp_path: Path) -> None:
    for to, keys, expected in MISTAKES:
        table = f'[[udp]]\ndestination = "{to}"\n{keys}\n' if to else f"[[udp]]\n{keys}\n"
        path = scene_file(tmp_path, scene_with(table))
        with pytest.raises(SceneError) as caught:
            load(path)
        place, _, told = str(caught.value).partition(": udp[0].")
        assert place.startswith(f"{path}: line ")
        assert told == expected


def test_a_run_says_where_datagrams_go(tmp_path: Path) -> None:
    udp = destination("127.0.0.1:8600", sensors=["radar"])
    udp += destination(f"{GROUP_4}:8600", interface="127.0.0.1", ttl=2)
    options = ("--broker", "none", "--speed", "max", "--duration", "1")
    done = plotfeed_here("run", scene_file(tmp_path, scene_with(udp)), *options)
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


def test_a_destination_without_a_route_takes_nothing_from_others(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, no_route: None
) -> None:
    """What arrived elsewhere was sent; who did not get it is told by name, and once in the log."""
    with receiver() as ears:
        udp = destination(place(ears)) + destination(NO_ROUTE)
        seen, got = sent_to(tmp_path, udp), heard(ears)
    name = f"udp[1] {NO_ROUTE}"
    of_asterix = [one for one in seen.sent if "/asterix/" in one.topic]
    assert len(got) == len(of_asterix) > 10
    assert {one.fate for one in seen.sent} == {pb.SENT}
    assert {(*one.not_to,) for one in of_asterix} == {(name,)}
    assert {(*one.not_to,) for one in seen.sent if one not in of_asterix} == {()}
    assert (seen.totals.undelivered, seen.totals.undelivered_to) == (0, {name: len(got)})
    assert seen.totals.messages == len(seen.sent)
    (line,) = [r.getMessage() for r in caplog.records]
    assert line == f"{name} gets nothing: Network is unreachable; others do"


def test_what_no_destination_got_is_undelivered(tmp_path: Path, no_route: None) -> None:
    totals = sent_to(tmp_path, destination(NO_ROUTE)).totals
    assert totals.undelivered == totals.undelivered_to[f"udp[0] {NO_ROUTE}"] > 10

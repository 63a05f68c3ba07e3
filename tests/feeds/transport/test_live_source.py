"""Octets come in over UDP, TCP, serial ports and pipes, and come again after whatever broke."""

from __future__ import annotations

import asyncio
import contextlib
import os
import pty
import socket
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from support.brokers import free_port, has_ipv6
from support.deliveries import taken
from support.own_time import in_own_time
from support.udp_receiver import interface_of
from support.waiting import PATIENCE_S, kept_up, until

from plotfeed.feeds.console.printed import bracketed
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import UdpDestination
from plotfeed.feeds.scene.telemetry_keys import SourceAddress, TelemetrySource
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.feeds.transport import live_source
from plotfeed.feeds.transport.live_source import LiveSource, UdpOctets, octets_of
from plotfeed.feeds.transport.peers import PeerLimits
from plotfeed.feeds.transport.udp import UdpTransport
from plotfeed.feeds.transport.ways_out import BACKOFF_S, TransportError
from plotfeed.proto.errors import PlotfeedError

IDENTITY = b"\x02\x12" + b"1581F4XF".ljust(20, b"\0") + bytes(3)
# A Location message of Open Drone ID, of now, whenever that is.
AIRBORNE = bytes.fromhex("12222364fe595e1c18b3ddc6fd600dc30d48084b33aaffff00")


class Taker:
    """What has come, by who sent it, and who has gone."""

    def __init__(self) -> None:
        self.came: dict[str, bytes] = {}
        self.left: list[str] = []
        self.refused: list[str] = []

    def put(self, peer: str, data: bytes) -> None:
        self.came[peer] = self.came.get(peer, b"") + data

    async def hear(self, peer: str, data: bytes) -> None:
        self.put(peer, data)

    def gone(self, peer: str) -> None:
        self.left.append(peer)

    def refuse(self, why: str, number: int = 1) -> None:
        self.refused += [why] * number

    @property
    def all(self) -> bytes:
        return b"".join(self.came.values())

    @property
    def told(self) -> int:
        """Octets that have come or were refused."""
        return len(self.all) + len(self.refused)


def datagrams() -> socket.socket:
    """A socket of IPv4 at a port of its own, for as long as it is open."""
    ours = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ours.bind(("127.0.0.1", 0))
    ours.settimeout(PATIENCE_S)
    return ours


@contextlib.asynccontextmanager
async def listening(
    url: str, interface: str | None = None
) -> AsyncIterator[tuple[Taker, UdpOctets]]:
    taker = Taker()
    source = octets_of(SourceAddress.parse(url), taker, interface)
    await source.open()
    async with kept_up(source.run()):
        yield taker, source  # type: ignore[misc]
    source.close()


@in_own_time
async def test_a_peer_that_is_held_up_when_all_ends_is_no_error() -> None:
    class Full(Taker):
        async def hear(self, peer: str, data: bytes) -> None:
            self.put(peer, data)
            await asyncio.Event().wait()

    told: list[object] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: told.append(context))
    taker, port = Full(), free_port()
    source = octets_of(SourceAddress.parse(f"mavlink:tcpin:127.0.0.1:{port}"), taker)
    await source.open()
    _, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"more")
    await until(lambda: taker.came)
    others = asyncio.all_tasks() - {asyncio.current_task()}
    for task in others:  # as asyncio.run does
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)
    await asyncio.sleep(0)
    assert not told
    source.close()
    writer.close()


@in_own_time
async def test_datagrams_come_with_their_senders_who_can_be_answered() -> None:
    port = free_port()
    async with listening(f"mavlink:udpin:127.0.0.1:{port}") as (taker, source):
        with datagrams() as one, datagrams() as other:
            one.sendto(b"one", ("127.0.0.1", port))
            other.sendto(b"other", ("127.0.0.1", port))
            await until(lambda: len(taker.came) == 2)
            assert set(taker.came.values()) == {b"one", b"other"}
            source.send("{}:{}".format(*one.getsockname()), b"answer")
            assert one.recv(100) == b"answer"


@in_own_time
async def test_octets_of_a_live_source_become_reports_with_what_the_scene_states() -> None:
    """Of Remote ID, with an identity before the place; what is no message is refused."""
    taken, refused, port = dict[str, PositionReport](), list[str](), free_port()
    url = f"remote-id:udp://127.0.0.1:{port}"
    source = LiveSource(
        TelemetrySource(url=url, rcs_m2=0.5),
        now_utc_ns=lambda: 1_767_225_600_000_000_000,
        take=taken.__setitem__,
        refuse=lambda _drone, refusal: refused.append(refusal.reason),
    )
    await source.open()
    with datagrams() as receiver:
        for said in (IDENTITY, AIRBORNE, b"noise"):
            receiver.sendto(said, ("127.0.0.1", port))
        await until(lambda: taken and refused)
    source.close()
    assert [*taken] == ["1581F4XF"]
    found = taken["1581F4XF"]
    assert found.latitude_deg == pytest.approx(40.4512345, abs=1e-7)
    assert (found.rcs_m2, refused) == (0.5, ["undecodable"])


@pytest.mark.parametrize("group", ["239.255.77.78", "ff11::7:8"])
@in_own_time
async def test_a_group_is_heard_by_all_who_joined_it(group: str) -> None:
    if ":" in group and not has_ipv6():
        pytest.skip("this machine has no IPv6 loopback")
    place = f"{bracketed(group)}:{free_port()}"
    url, at = f"mavlink:udp://{place}", interface_of(group)
    drone = UdpTransport(UdpDestination(destination=place, interface=at, ttl=0))
    try:
        async with listening(url, at) as (one, _), listening(url, at) as (other, _):
            drone.open()
            assert taken(drone, Message("t", b"here I am", "application/x-asterix", 0))
            await until(lambda: one.all == other.all == b"here I am")
            assert list(one.came) == list(other.came)
    except TransportError as error:
        pytest.skip(f"this machine's loopback has no multicast: {error}")
    finally:
        drone.close()


@in_own_time
async def test_whoever_is_named_is_sent_something_first() -> None:
    with datagrams() as autopilot:
        place = "{}:{}".format(*autopilot.getsockname())
        async with listening(f"mavlink:udpout:{place}") as (taker, source):
            source.send(source.correspondents[0], b"hello")
            data, sender = autopilot.recvfrom(100)
            assert data == b"hello"
            autopilot.sendto(b"position", sender)
            await until(lambda: taker.all == b"position")


@in_own_time
async def test_a_connection_that_ends_is_made_again_and_one_that_does_not_come_more_slowly() -> (
    None
):
    port, times, loop = free_port(), 0, asyncio.get_running_loop()

    async def serve(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal times
        times += 1
        writer.write(b"%d" % times)
        await writer.drain()
        writer.close()

    async with listening(f"mavlink:tcp:127.0.0.1:{port}") as (taker, _):
        await asyncio.sleep(sum(BACKOFF_S) + 0.1)  # nobody is there yet
        server, since_s = await asyncio.start_server(serve, "127.0.0.1", port), loop.time()
        await until(lambda: len(taker.left) >= 3)
        assert BACKOFF_S[-1] <= loop.time() - since_s <= BACKOFF_S[-1] + 3 * BACKOFF_S[0] + 1.0
        server.close()
    assert {b"1", b"2", b"3"} <= {bytes([octet]) for octet in taker.all}


@in_own_time
async def test_datagrams_that_the_socket_had_no_room_for_are_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if sys.platform != "linux":
        pytest.skip("only Linux tells")
    monkeypatch.setattr(live_source, "BUFFER_OCTETS", 4096)
    port, sent = free_port(), 500
    async with listening(f"mavlink:udpin:127.0.0.1:{port}") as (taker, _):
        with datagrams() as end:
            for burst in (1, 2):
                for _ in range(sent):
                    end.sendto(b".", ("127.0.0.1", port))
                await until(lambda n=burst * sent: taker.told == n)  # type: ignore[misc]
        assert taker.refused


@in_own_time
async def test_several_connect_and_who_is_silent_longest_gives_way(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(live_source, "TCP", PeerLimits(2, 1 << 16))
    port = free_port()
    async with listening(f"mavlink:tcpin:127.0.0.1:{port}") as (taker, _):
        ends = []
        for name in (b"a", b"b"):
            ends.append(await asyncio.open_connection("127.0.0.1", port))
            ends[-1][1].write(name)
        await until(lambda: sorted(taker.came.values()) == [b"a", b"b"])
        ends[0][1].write(b"again")
        await until(lambda: b"aagain" in taker.came.values())
        ends.append(await asyncio.open_connection("127.0.0.1", port))
        with contextlib.suppress(OSError):
            assert await ends[1][0].read(1) == b""
        ends[2][1].write(b"c")
        await until(lambda: b"c" in taker.came.values())
        assert len(taker.refused) == 1
        for _, writer in ends:
            writer.close()
        await until(lambda: len(taker.left) == 3)


def watch_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The running loop is as that of Windows, and so is what reads a serial port."""

    def refused(*_: object) -> None:
        raise NotImplementedError

    monkeypatch.setattr(live_source, "HAS_POSIX", False)
    monkeypatch.setattr(asyncio.get_running_loop(), "add_reader", refused)


@pytest.mark.parametrize("is_watched", [True, False])
@in_own_time
async def test_a_serial_port_that_is_unplugged_is_opened_again(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    *,
    is_watched: bool,
) -> None:
    if not is_watched:
        watch_nothing(monkeypatch)
    port = tmp_path / "tty"

    def plug_in() -> tuple[int, int]:
        ours, theirs = pty.openpty()
        port.unlink(missing_ok=True)
        port.symlink_to(os.ttyname(theirs))
        return ours, theirs

    ours, theirs = plug_in()
    async with listening(f"mavlink:{port},115200") as (taker, source):
        # Nothing of it is taken for a control character or an end of line.
        os.write(ours, bytes(range(256)))
        await until(lambda: taker.all == bytes(range(256)))
        source.send(str(port), b"\r\nasked")
        assert os.read(ours, 100) == b"\r\nasked"
        os.close(theirs)
        port.unlink()
        os.close(ours)
        await until(lambda: taker.left)
        ours, theirs = plug_in()
        while not taker.all.endswith(b"again"):
            os.write(ours, b"again")
            await asyncio.sleep(0.01)
    os.close(ours)
    os.close(theirs)
    told = ["the port is gone; tried again", "the port is back"]
    assert caplog.messages == [f"mavlink:{port},115200: {each}" for each in told]


@in_own_time
async def test_a_serial_port_that_takes_no_more_makes_nobody_wait() -> None:
    ours, theirs = pty.openpty()
    async with listening(f"mavlink:{os.ttyname(theirs)}") as (taker, source):
        for _ in range(1000):
            source.send("", bytes(1000))
        os.write(ours, b"heard")
        await until(lambda: taker.all == b"heard")
    source.send("", b"too late")
    os.close(ours)
    os.close(theirs)


def test_a_serial_port_without_pyserial_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(PlotfeedError, match=r"a serial port needs .*'plotfeed\[serial\]'$"):
        octets_of(SourceAddress.parse("sbs1:/dev/ttyUSB0"), Taker())


@in_own_time
@pytest.mark.parametrize(
    ("url", "interface", "why"),
    [
        ("mavlink:/dev/null", None, "expected a serial port"),
        ("mavlink:/nowhere/tty", None, "mavlink:/nowhere/tty,57600: No such file or directory$"),
        ("mavlink:/dev/null,12345", None, "12345 baud is no usual rate"),
        ("sbs1:file:/nowhere", None, "no file that can be read"),
        ("mavlink:udpin:127.0.0.1:{taken}", None, r"127\.0\.0\.1:\d+: Address already in use"),
        ("mavlink:mcast:239.255.77.78:{taken}", "nowhere0", r"239\.255\.77\.78:\d+ at nowhere0: "),
    ],
)
async def test_what_cannot_be_opened_says_why(url: str, interface: str | None, why: str) -> None:
    with datagrams() as ours, pytest.raises(TransportError, match=why):
        async with listening(url.format(taken=ours.getsockname()[1]), interface):
            pass


@in_own_time
async def test_a_file_is_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "hex"
    path.write_bytes(bytes(range(256)) * 1000)
    async with listening(f"sbs1:file:{path}") as (taker, _):
        await until(lambda: taker.left == [str(path)])
    assert taker.all == path.read_bytes()


ADDRESSES = [
    ("mavlink:udp://:14550", "mavlink:udpin:127.0.0.1:14550"),
    ("mavlink:udpin://0.0.0.0:14550", "mavlink:udpin:0.0.0.0:14550"),
    ("mavlink:udpin:0.0.0.0:14550", "mavlink:udpin:0.0.0.0:14550"),
    ("mavlink:udpout:10.0.0.1:14550", "mavlink:udpout:10.0.0.1:14550"),
    ("mavlink:udp:[::1]:14550", "mavlink:udpin:[::1]:14550"),
    ("mavlink:mcast:", "mavlink:udpin:239.255.145.50:14550"),
    ("mavlink:tcp:sitl.example:5760", "mavlink:tcp:sitl.example:5760"),
    ("mavlink:tcpout://127.0.0.1:5760", "mavlink:tcp:127.0.0.1:5760"),
    ("mavlink:tcpin::5760", "mavlink:tcpin:127.0.0.1:5760"),
    ("mavlink:/dev/ttyACM0", "mavlink:/dev/ttyACM0,57600"),
    ("mavlink:serial:///dev/ttyUSB0:115200", "mavlink:/dev/ttyUSB0,115200"),
    ("mavlink:serial:COM3:115200", "mavlink:COM3,115200"),
    ("sbs1:-", "sbs1:-"),
]
NO_ADDRESSES = [
        "", "mavlink", "mavlink:", "mavlink:udp", "mavlink:udp:", "mavlink:udp:host:1x", "x:udp::1",
        "mavlink:udpin:name:1", "mavlink:tcp::5760", "mavlink:udp:1.2.3.4:0", "mavlink:file:",
        "mavlink:/dev/tty,x", "mavlink:/dev/tty,0", "mavlink:http://a", "mavlink:udp:1.2.3.4:99999",
        "remote-id:-", "remote-id:/dev/ttyUSB0",
]  # fmt: skip


def test_addresses_are_understood_as_users_write_them() -> None:
    for text, shown in ADDRESSES:
        assert str(SourceAddress.parse(text)) == shown
        assert SourceAddress.parse(shown) == SourceAddress.parse(text)
    for text in NO_ADDRESSES:
        with pytest.raises(ValueError, match="expected"):
            SourceAddress.parse(text)

"""What is heard of real sockets and brokers, as it is recorded."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.brokers import free_port, has_ipv6, mosquitto, own_broker
from support.deliveries import NOBODY
from support.udp_receiver import LOOPBACK_INTERFACE, interface_of
from support.waiting import PATIENCE_S

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.record import BrokerSource, CaptureSource, UdpSource, rfc_3339_ns
from plotfeed.feeds.scene.output_keys import Endpoint
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.ways_out import TransportError
from plotfeed.replay.recorded import Recorded, Stage

GROUP_4, GROUP_6 = "239.255.77.78", "ff11::7:8"
BLOCK = bytes([48, 0, 6, 1, 2, 3])
on_linux = pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells of each datagram")


class Listener(contextlib.AsyncExitStack):
    """Keeps what a source hears."""

    def __init__(self, source: CaptureSource) -> None:
        super().__init__()
        self.found: list[Recorded] = []
        self._source = source
        self._news = asyncio.Event()

    async def __aenter__(self) -> Listener:
        await self.enter_async_context(self._source.receiving(self._hear))
        return self

    def _hear(self, recorded: Recorded) -> None:
        self.found.append(recorded)
        self._news.set()

    async def wait_for(self, count: int) -> list[Recorded]:
        async with asyncio.timeout(PATIENCE_S):
            while len(self.found) < count:
                self._news.clear()
                await self._news.wait()
        return self.found


@contextlib.contextmanager
def sender(to: str, interface: str | None = None) -> Iterator[socket.socket]:
    family = socket.AF_INET6 if ":" in to else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as out:
        if interface is not None and ":" in to:
            index = socket.if_nametoindex(interface)
            out.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_IF, index)
        elif interface is not None:
            loopback = socket.inet_aton("127.0.0.1")
            out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
        yield out


async def heard_over_udp(
    source: UdpSource, to: str, port: int, interface: str | None
) -> list[Recorded]:
    payloads = [BLOCK, b"", b"?" * 1400, BLOCK * 3]

    async with Listener(source) as listener:
        with sender(to, interface) as out:
            began_ns = time.time_ns()
            for payload in payloads:
                out.sendto(payload, (to, port))
            found = await listener.wait_for(len(payloads))
            ended_ns = time.time_ns()
            came_from = out.getsockname()[1]
        assert all(began_ns <= m.log_time_ns <= ended_ns for m in found)
        assert {m.properties[0][0] for m in found} == {"udp-source"}
        assert all(m.properties[0][1].endswith(f"/{came_from}") for m in found)
    assert [m.payload for m in found] == payloads
    assert [m.content_type for m in found] == [
        "application/x-asterix; cat=48",
        "application/octet-stream",
        "application/octet-stream",
        "application/x-asterix; cat=48",
    ]
    assert all(m.publish_time_ns == m.log_time_ns for m in found)
    assert all(m.stage is Stage.RECEIVED for m in found)
    assert source.lost in (0, None)
    return found


@pytest.mark.parametrize("bound", ["127.0.0.1", "0.0.0.0", "::1", "::"])  # noqa: S104
@pytest.mark.asyncio
async def test_datagrams_to_one_host_come_with_their_destination(bound: str) -> None:
    if ":" in bound and not has_ipv6():
        pytest.skip("this machine has no IPv6 loopback")
    to, port = "::1" if ":" in bound else "127.0.0.1", free_port()
    place = f"[{bound}]:{port}" if ":" in bound else f"{bound}:{port}"
    source = UdpSource(Endpoint.parse(place))
    assert source.shown == f"udp://{place}"
    found = await heard_over_udp(source, to, port, None)
    if sys.platform == "linux":
        assert {m.topic for m in found} == {f"udp/{to}/{port}"}


@pytest.mark.parametrize(
    ("group", "interface"), [(GROUP_4, "127.0.0.1"), (GROUP_4, LOOPBACK_INTERFACE), (GROUP_6, "")]
)
@pytest.mark.asyncio
async def test_a_group_is_joined_where_it_is_said(group: str, interface: str) -> None:
    if group == GROUP_6 and not has_ipv6():
        pytest.skip("this machine has no IPv6 loopback")
    port, joined_at = free_port(), interface or interface_of(group)
    place = f"[{group}]:{port}" if group == GROUP_6 else f"{group}:{port}"
    found = await heard_over_udp(
        UdpSource(Endpoint.parse(place), joined_at), group, port, joined_at
    )
    assert {m.topic for m in found} == {f"udp/{group}/{port}"}


@on_linux
@pytest.mark.asyncio
async def test_times_are_those_at_which_the_kernel_took_them() -> None:
    port = free_port()
    source = UdpSource(Endpoint.parse(f"127.0.0.1:{port}"))
    async with Listener(source) as listener:
        assert source.has_kernel_times
        for number in range(1, 21):  # the kernel begins to stamp a little after it is asked to
            with sender("127.0.0.1") as out:
                out.sendto(BLOCK, ("127.0.0.1", port))
            arrived_ns = time.time_ns()  # nobody has read it yet
            time.sleep(0.05)  # noqa: ASYNC251 - the loop is to be held up
            *_, recorded = await listener.wait_for(number)
            if recorded.log_time_ns <= arrived_ns:
                return
        pytest.fail("no datagram has the time at which the kernel took it")


@pytest.mark.asyncio
async def test_at_first_no_datagram_is_older_than_the_one_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stamps = iter([5, 3, 9, 7])
    monkeypatch.setattr(UdpSource, "_kernel_told", lambda *_: ("udp", next(stamps)))

    port = free_port()
    async with Listener(UdpSource(Endpoint.parse(f"127.0.0.1:{port}"))) as listener:
        with sender("127.0.0.1") as out:
            for _ in range(4):
                out.sendto(BLOCK, ("127.0.0.1", port))
        found = await listener.wait_for(4)
    assert [recorded.log_time_ns for recorded in found] == [5, 5, 9, 9]


@on_linux
@pytest.mark.asyncio
async def test_what_the_socket_had_no_room_for_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("plotfeed.feeds.recording.record.BUFFER_OCTETS", 100_000)

    port = free_port()
    source = UdpSource(Endpoint.parse(f"127.0.0.1:{port}"))
    async with Listener(source) as listener:
        with sender("127.0.0.1") as out:
            for _ in range(2000):
                out.sendto(bytes(1000), ("127.0.0.1", port))
    heard, lost = len(listener.found), source.lost
    assert heard > 0
    assert lost is not None
    assert lost > 0
    assert heard + lost == 2000


@pytest.mark.parametrize(
    ("place", "interface", "text"),
    [
        ("127.0.0.1:8600", "lo", "interface: only for multicast, which 127.0.0.1 is not"),
        ("192.0.2.1:8600", None, "udp://192.0.2.1:8600: "),
        (f"{GROUP_4}:8600", "nowhere0", f"udp://{GROUP_4}:8600: "),
    ],
)
@pytest.mark.asyncio
async def test_what_cannot_be_heard_is_an_error(
    place: str, interface: str | None, text: str
) -> None:
    with pytest.raises(TransportError) as caught:
        async with Listener(UdpSource(Endpoint.parse(place), interface)):
            pass
    assert str(caught.value).startswith(text)


# Brokers.

DUE_NS = 1_767_268_800_123_456_789
MESSAGES = [
    Message(
        topic="plotfeed/radar/asterix/048",
        payload=BLOCK,
        content_type="application/x-asterix; cat=48",
        due_utc_ns=DUE_NS,
        properties=(("time", "2026-01-01T12:00:00.123456789Z"), ("scan", "7"), ("scan", "8")),
    ),
    Message(
        topic="plotfeed/radar/status",
        payload=b"{}",
        content_type="application/json",
        due_utc_ns=DUE_NS,
        retain=True,
        qos=1,
    ),
]


async def heard_over_mqtt(port: int, versions: tuple[int, ...]) -> list[Recorded]:
    address = BrokerAddress("127.0.0.1", port, versions)

    link, began_ns = MqttTransport(address, "test"), time.time_ns()
    async with Listener(BrokerSource(address, "plotfeed/#")) as listener:
        running = asyncio.create_task(link.run())
        try:
            await link.wait_until_up(PATIENCE_S)
            for message in MESSAGES:
                link.publish([message.again(NOBODY, 1)])
            found = await listener.wait_for(len(MESSAGES))
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)
    assert all(began_ns <= m.log_time_ns <= time.time_ns() for m in found)
    return sorted(found, key=lambda m: m.topic)


@pytest.mark.asyncio
async def test_a_message_is_recorded_with_all_that_came_with_it(tmp_path: Path) -> None:
    port = free_port()
    with mosquitto(tmp_path, port):
        found = await heard_over_mqtt(port, (5,))
    for recorded, message in zip(found, MESSAGES, strict=True):
        for name in ("topic", "payload", "content_type", "properties", "retain", "qos"):
            assert getattr(recorded, name) == getattr(message, name)
    assert found[0].publish_time_ns == DUE_NS
    assert found[1].publish_time_ns == found[1].log_time_ns  # nothing says when it was due


@pytest.mark.parametrize("version", [4, 5])
@pytest.mark.asyncio
async def test_the_embedded_broker_is_heard_too(tmp_path: Path, version: int) -> None:
    port = free_port()
    with own_broker(tmp_path, port):
        found = await heard_over_mqtt(port, (version,))
    assert [(m.topic, m.payload) for m in found] == [(m.topic, m.payload) for m in MESSAGES]
    if version == 5:
        assert [m.content_type for m in found] == [m.content_type for m in MESSAGES]
        assert found[0].properties == MESSAGES[0].properties
    else:
        assert {(m.content_type, m.properties) for m in found} == {("", ())}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1970-01-01T00:00:00Z", 0),
        ("1970-01-01T00:00:01.5Z", 1_500_000_000),
        ("1970-01-01T01:00:00.000000001+01:00", 1),
        ("2026-01-01T12:00:00.123456789Z", DUE_NS),
        ("1969-12-31T23:59:59Z", None),
        ("2026-02-30T12:00:00Z", None),
        ("2026-01-01T12:00:00", None),
        ("2026-01-01T12:00:00.1234567890Z", None),
        ("", None),
    ],
)
def test_times_are_exact_or_unknown(text: str, expected: int | None) -> None:
    assert rfc_3339_ns(text) == expected

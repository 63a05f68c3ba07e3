"""Where records come from: datagrams with the kernel's times, a broker's messages as they come."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import re
import socket
import struct
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from plotfeed.feeds.console.posix import HAS_POSIX, watched
from plotfeed.feeds.messages.message import ReceivedMessage
from plotfeed.feeds.scene.output_keys import Endpoint
from plotfeed.feeds.transport.mqtt.address import (
    DEFAULT_PORTS,
    AddressError,
    BrokerAddress,
    without_secrets,
)
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.udp import UdpError, interface_number, join_group
from plotfeed.proto.utc import NS, utc_ns
from plotfeed.replay.asterix_blocks import content_type
from plotfeed.replay.pcap.captures import SOURCE
from plotfeed.replay.recorded import UDP_TOPIC, Recorded

IS_LINUX = sys.platform == "linux"
# Of Linux, and unknown to Python.
SO_RCVBUFFORCE, SO_TIMESTAMPNS, SO_MEMINFO = 33, 35, 55
IP_PKTINFO, IPV6_RECVPKTINFO, IPV6_PKTINFO = 8, 49, 50
TIMESPEC = struct.Struct("@ll")  # Seconds and nanoseconds
MEMINFO = struct.Struct("@9I")  # Of which the last is how many datagrams the socket had no room for
# What comes while this program does something else; the kernel may allow less.
BUFFER_OCTETS = 32 << 20
LARGEST_OCTETS = 1 << 16
EXTRA_OCTETS = 256
AT_ONCE = 256  # Datagrams, until something else has its turn
# At first the kernel may give a datagram the time at which it is read, as it has no other yet.
#
# Those after it, which it stamped as they came, would then be earlier; a socket hands on in order.
SETTLING_S = 1.0
LAST_TURNS = 1000  # At the end, should they never cease to come


class UdpSource:
    """What comes to one port, of one address, of a group, or of all addresses."""

    def __init__(self, endpoint: Endpoint, interface: str | None = None) -> None:
        """`interface` is where a group is joined; raises `UdpError`."""
        if interface is not None and not endpoint.address.is_multicast:
            raise UdpError(f"--interface: only for multicast, which {endpoint.address} is not")
        host = str(endpoint.address)
        self.shown = f"udp://{f'[{host}]' if ':' in host else host}:{endpoint.port}"
        self.has_kernel_times = False  # Whether times are those of the kernel, not of this program
        self._endpoint = endpoint
        self._interface = interface
        self._topic = _topic(endpoint.address, endpoint.port)
        self._is_any = endpoint.address.is_unspecified
        self._socket: socket.socket | None = None
        self._receive: Callable[[Recorded], None] = _forget
        self._lost: int | None = None
        self._latest_ns = 0
        self._settled_s = 0.0

    @property
    def lost(self) -> int | None:
        """Datagrams for which the socket had no room; None if the kernel does not tell."""
        if self._socket is None or not IS_LINUX:
            return self._lost
        try:
            told = self._socket.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, MEMINFO.size)
            return int(MEMINFO.unpack(told)[-1])
        except (OSError, struct.error):
            return None

    async def open(self, receive: Callable[[Recorded], None]) -> None:
        """Call `receive` with each datagram from now on; raises `UdpError`."""
        family = socket.AF_INET if self._endpoint.address.version == 4 else socket.AF_INET6
        self._receive = receive
        opened = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._prepare(opened)
            if self._endpoint.address.is_multicast:
                join_group(opened, self._endpoint.address, self._interface)
        except OSError as error:
            opened.close()
            raise UdpError(f"{self.shown}: {error.strerror or error}") from None
        self._socket = opened
        self._settled_s = time.monotonic() + SETTLING_S
        self._unwatch = watched(opened, partial(self._take, opened))

    async def close(self) -> None:
        """Receive what is there already, and no more."""
        opened = self._socket
        if opened is None:
            return
        self._unwatch()
        for _ in range(LAST_TURNS):
            if self._take(opened) < AT_ONCE:
                break
        self._lost, self._socket = self.lost, None
        opened.close()

    def _take(self, opened: socket.socket) -> int:
        """What has come, up to a number that takes no long time; how many."""
        is_settling = time.monotonic() < self._settled_s
        for n in range(AT_ONCE):
            try:
                if HAS_POSIX:
                    payload, extras, _, sender = opened.recvmsg(LARGEST_OCTETS, EXTRA_OCTETS)
                else:
                    extras, (payload, sender) = [], opened.recvfrom(LARGEST_OCTETS)
            except OSError:  # there is nothing, or only word of an error
                return n
            topic, at_ns = self._kernel_told(extras)
            if is_settling:
                at_ns = self._latest_ns = max(at_ns, self._latest_ns)
            self._receive(
                Recorded(
                    topic=topic,
                    payload=payload,
                    log_time_ns=at_ns,
                    publish_time_ns=at_ns,
                    content_type=content_type(payload),
                    properties=((SOURCE, _place(*sender[:2])),),
                )
            )
        return AT_ONCE

    def _kernel_told(self, extras: Sequence[tuple[int, int, bytes]]) -> tuple[str, int]:
        """Topic and time, as far as the kernel says them."""
        topic, at_ns = self._topic, 0
        for level, kind, data in extras:
            if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS:
                seconds, ns = TIMESPEC.unpack(data[: TIMESPEC.size])
                at_ns = seconds * NS + ns
            elif self._is_any:
                topic = self._topic_of(level, kind, data) or topic
        return topic, at_ns or time.time_ns()

    def _prepare(self, receiver: socket.socket) -> None:
        address = self._endpoint.address
        receiver.setblocking(False)
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_OCTETS)
        if IS_LINUX:
            with contextlib.suppress(OSError):  # beyond everybody's limit, which needs a right
                receiver.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, BUFFER_OCTETS)
            with contextlib.suppress(OSError):
                receiver.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
                self.has_kernel_times = True
        if address.is_multicast:  # others on this machine may receive the group too
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if self._is_any and IS_LINUX:  # where a datagram went is not known otherwise
            if address.version == 4:
                receiver.setsockopt(socket.IPPROTO_IP, IP_PKTINFO, 1)
            else:
                receiver.setsockopt(socket.IPPROTO_IPV6, IPV6_RECVPKTINFO, 1)
        found = socket.getaddrinfo(
            str(address), self._endpoint.port, receiver.family, socket.SOCK_DGRAM
        )
        place = found[0][4]
        if address.is_multicast and address.version == 6:  # whose scope may need its interface
            place = (*place[:3], interface_number(address, self._interface))
        receiver.bind(place)

    def _topic_of(self, level: int, kind: int, data: bytes) -> str:
        """The topic of a struct in_pktinfo or in6_pktinfo; empty if it is none."""
        port = self._endpoint.port
        if (level, kind) == (socket.IPPROTO_IP, IP_PKTINFO):
            return _topic(ipaddress.IPv4Address(data[8:12]), port)
        if (level, kind) == (socket.IPPROTO_IPV6, IPV6_PKTINFO):
            return _topic(ipaddress.IPv6Address(data[:16]), port)
        return ""


def _place(address: object, port: int) -> str:
    """Address and port as topics and properties have them."""
    return f"{str(address).partition('%')[0]}/{port}"


def _topic(address: object, port: int) -> str:
    return f"{UDP_TOPIC}{_place(address, port)}"


def _forget(_recorded: Recorded) -> None:
    """What a source that is not open does with datagrams."""


CONNECT_S = 5.0
DEFAULT_FILTER = "plotfeed/#"
RFC_3339 = re.compile(r"\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d(\.\d{1,9})?(Z|[+-]\d\d:\d\d)")


class BrokerSource:
    """The messages of a broker on a topic filter."""

    # Messages that are known to have been lost on their way; a broker tells none.
    lost: int | None = None

    def __init__(
        self, address: BrokerAddress, topic_filter: str, name: str = "plotfeed-record"
    ) -> None:
        """`name` is how the client calls itself."""
        self.topic_filter = topic_filter
        self.shown = f"{address}/{topic_filter}"  # Where messages come from, without secrets
        self._address = address
        self._name = name
        self._running: asyncio.Task[None] | None = None

    @classmethod
    def parse(cls, url: str, access: dict[str, Any], name: str, *, expected: str) -> BrokerSource:
        """The source at mqtt://HOST:PORT/FILTER; raises `PlotfeedError`.

        `access` holds the keyword arguments of `BrokerAddress.parse`, `expected` is for the error.
        """
        scheme, _, rest = url.partition("://")
        if scheme not in DEFAULT_PORTS:
            raise AddressError(f"{without_secrets(url)!r}: expected {expected}")
        place, _, topic_filter = rest.partition("/")
        address = BrokerAddress.parse(f"{scheme}://{place}", **access)
        return cls(address, topic_filter or DEFAULT_FILTER, name)

    async def open(self, receive: Callable[[Recorded], None]) -> None:
        """Call `receive` with each message from now on; raises `PlotfeedError` without a broker."""
        link = MqttTransport(
            self._address,
            self._name,
            subscribe=[self.topic_filter],
            on_received=lambda message: receive(recorded_of(message, time.time_ns())),
        )
        self._running = asyncio.create_task(link.run(), name=f"link[{self._name}]")
        await link.wait_until_up(CONNECT_S)

    async def close(self) -> None:
        """Receive no more."""
        if self._running is not None:
            self._running.cancel()
            await asyncio.gather(self._running, return_exceptions=True)


def recorded_of(message: ReceivedMessage, now_utc_ns: int) -> Recorded:
    """A received message as it is recorded.

    It was due when its CloudEvents attribute `time` says, if it has one.
    """
    due_utc_ns = rfc_3339_ns(dict(message.properties).get("time", ""))
    return Recorded(
        topic=message.topic,
        payload=message.payload,
        log_time_ns=now_utc_ns,
        publish_time_ns=now_utc_ns if due_utc_ns is None else due_utc_ns,
        content_type=message.content_type or "",
        properties=message.properties,
        retain=message.retain,
        qos=message.qos,
    )


def rfc_3339_ns(text: str) -> int | None:
    """UTC, up to nine decimals of the second; None for no such time, or one before 1970."""
    found = utc_ns(text) if RFC_3339.fullmatch(text) else None
    return found if found is not None and found >= 0 else None

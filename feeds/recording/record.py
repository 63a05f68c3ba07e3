"""A broker's messages, or datagrams with the kernel's times, into a file, until stopped or full."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import json
import re
import signal
import socket
import struct
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from plotfeed.feeds.console import FAILED, INTERRUPTED
from plotfeed.feeds.console.posix import HAS_POSIX, watched
from plotfeed.feeds.console.printed import interval_s, say, show_last_status, show_status
from plotfeed.feeds.console.process import refuse_if_there, stopped_by_signals
from plotfeed.feeds.messages.message import checked_topic_filter
from plotfeed.feeds.recording.recorder import Recorder
from plotfeed.feeds.recording.recording_settings import RecordSettings
from plotfeed.feeds.scene.output_keys import Endpoint
from plotfeed.feeds.transport.mqtt.address import (
    DEFAULT_PORTS,
    AddressError,
    BrokerAddress,
    without_secrets,
)
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.mqtt.packets import Publication
from plotfeed.feeds.transport.udp import lost_of, receiver_at
from plotfeed.feeds.transport.ways_out import TransportError
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS, utc_ns
from plotfeed.replay.asterix_files import content_type
from plotfeed.replay.pcap import SOURCE
from plotfeed.replay.recorded import SUFFIX, UDP_TOPIC, Recorded

IS_LINUX = sys.platform == "linux"
# Of Linux, and unknown to Python.
SO_RCVBUFFORCE, SO_TIMESTAMPNS = 33, 35
IP_PKTINFO, IPV6_RECVPKTINFO, IPV6_PKTINFO = 8, 49, 50
TIMESPEC = struct.Struct("@ll")  # Seconds and nanoseconds
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


Receive = Callable[[Recorded], None]


class UdpSource:
    """What comes to one port, of one address, of a group, or of all addresses."""

    def __init__(self, endpoint: Endpoint, interface: str | None = None) -> None:
        """`interface` is where a group is joined; raises `TransportError`."""
        if interface is not None and not endpoint.address.is_multicast:
            raise TransportError(f"interface: only for multicast, which {endpoint.address} is not")
        host = str(endpoint.address)
        self.shown = f"udp://{f'[{host}]' if ':' in host else host}:{endpoint.port}"
        self.has_kernel_times = False  # Whether times are those of the kernel, not of this program
        self._endpoint = endpoint
        self._interface = interface
        self._topic = _topic(endpoint.address, endpoint.port)
        self._is_any = endpoint.address.is_unspecified
        self._socket: socket.socket | None = None
        self._lost: int | None = None
        self._latest_ns = 0
        self._settled_s = 0.0

    @property
    def lost(self) -> int | None:
        """Datagrams for which the socket had no room; None if the kernel does not tell."""
        return self._lost if self._socket is None else lost_of(self._socket)

    @contextlib.asynccontextmanager
    async def receiving(self, receive: Receive) -> AsyncIterator[None]:
        """Call `receive` with each datagram, last with what is left; raises `TransportError`."""
        host, port = str(self._endpoint.address), self._endpoint.port
        try:
            opened = receiver_at(host, port, self._interface, BUFFER_OCTETS, self._prepare)
        except OSError as error:
            raise TransportError(f"{self.shown}: {error.strerror or error}") from None
        with opened:
            self._socket = opened
            self._settled_s = time.monotonic() + SETTLING_S
            unwatch = watched(opened, partial(self._take, opened, receive))
            try:
                yield
            finally:
                unwatch()
                for _ in range(LAST_TURNS):
                    if self._take(opened, receive) < AT_ONCE:
                        break
                self._lost, self._socket = self.lost, None

    def _take(self, opened: socket.socket, receive: Receive) -> int:
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
            receive(
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
        topic, at_ns, port = self._topic, 0, self._endpoint.port
        for level, kind, data in extras:
            if (level, kind) == (socket.SOL_SOCKET, SO_TIMESTAMPNS):
                seconds, ns = TIMESPEC.unpack(data[: TIMESPEC.size])
                at_ns = seconds * NS + ns
            elif self._is_any and (level, kind) == (socket.IPPROTO_IP, IP_PKTINFO):
                topic = _topic(ipaddress.IPv4Address(data[8:12]), port)  # of struct in_pktinfo
            elif self._is_any and (level, kind) == (socket.IPPROTO_IPV6, IPV6_PKTINFO):
                topic = _topic(ipaddress.IPv6Address(data[:16]), port)  # of struct in6_pktinfo
        return topic, at_ns or time.time_ns()

    def _prepare(self, receiver: socket.socket) -> None:
        """Have the kernel tell when and where datagrams came, and keep as many as it may."""
        if not IS_LINUX:
            return
        with contextlib.suppress(OSError):  # beyond everybody's limit, which needs a right
            receiver.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, BUFFER_OCTETS)
        with contextlib.suppress(OSError):
            receiver.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            self.has_kernel_times = True
        if self._is_any and receiver.family == socket.AF_INET:  # where it went is not known else
            receiver.setsockopt(socket.IPPROTO_IP, IP_PKTINFO, 1)
        elif self._is_any:
            receiver.setsockopt(socket.IPPROTO_IPV6, IPV6_RECVPKTINFO, 1)


def _place(address: object, port: int) -> str:
    """Address and port as topics and properties have them."""
    return f"{str(address).partition('%')[0]}/{port}"


def _topic(address: object, port: int) -> str:
    return f"{UDP_TOPIC}{_place(address, port)}"


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
        self.shown = f"{address}/{topic_filter}"  # Where messages come from, without secrets
        self._address, self._topic_filter, self._name = address, topic_filter, name

    @contextlib.asynccontextmanager
    async def receiving(self, receive: Receive) -> AsyncIterator[None]:
        """Call `receive` with each message; raises `PlotfeedError` without a broker."""
        link = MqttTransport(
            self._address,
            self._name,
            subscribe=[self._topic_filter],
            on_received=lambda message: receive(recorded_of(message, time.time_ns())),
        )
        async with link.connected(CONNECT_S):
            yield


def recorded_of(message: Publication, now_utc_ns: int) -> Recorded:
    """A received message as it is recorded.

    It was due when its CloudEvents attribute `time` says, if it has one.
    """
    properties = message.properties.pairs
    due_utc_ns = rfc_3339_ns(dict(properties).get("time", ""))
    return Recorded(
        topic=message.topic,
        payload=message.payload,
        log_time_ns=now_utc_ns,
        publish_time_ns=now_utc_ns if due_utc_ns is None else due_utc_ns,
        content_type=message.properties.content_type or "",
        properties=properties,
        retain=message.retain,
        qos=int(message.number is not None),  # The lower one of what it was published with and 1
    )


def rfc_3339_ns(text: str) -> int | None:
    """UTC, up to nine decimals of the second; None for no such time, or one before 1970."""
    found = utc_ns(text) if RFC_3339.fullmatch(text) else None
    return found if found is not None and found >= 0 else None


MAX_TOPICS = 65_536  # That are counted


LIVE = "mqtt://HOST:PORT/TOPIC-FILTER or udp://ADDRESS:PORT"
# Behind the address of a group: the network interface at which it is joined.
INTERFACE = "?interface="
CaptureSource = BrokerSource | UdpSource


def source_of(
    url: str, access: dict[str, Any], name: str = "plotfeed-record", expected: str = LIVE
) -> CaptureSource:
    """The source at mqtt://HOST:PORT/FILTER or udp://ADDRESS:PORT; raises `PlotfeedError`.

    Behind the latter, ?interface=NAME says at which network interface a group is joined.
    `access` holds the keyword arguments of `BrokerAddress.parse`, `name` is that of the client,
    and `expected` is what an error says is wanted.
    """
    scheme, _, rest = url.partition("://")
    if scheme == "udp":
        place, mark, interface = rest.partition(INTERFACE)
        try:
            return UdpSource(Endpoint.parse(place.rstrip("/")), interface if mark else None)
        except ValueError as error:
            raise AddressError(f"{without_secrets(url)}: {error}") from None
    if scheme not in DEFAULT_PORTS:
        raise AddressError(f"{without_secrets(url)!r}: expected {expected}")
    place, _, topic_filter = rest.partition("/")
    address = BrokerAddress.parse(f"{scheme}://{place}", **access)
    topic_filter = topic_filter or DEFAULT_FILTER
    checked_topic_filter(topic_filter)
    return BrokerSource(address, topic_filter, name)


def record_source(url: str, target: Path, access: dict[str, Any], settings: RecordSettings) -> int:
    """Record until it is stopped or has enough; the exit code.

    Raises `PlotfeedError`, and `OSError` if the file cannot be written.
    """
    source = source_of(url, access)
    if target.suffix.lower() != SUFFIX:
        raise PlotfeedError(
            f"{target}: expected a name that ends in {SUFFIX}, of which plotfeed convert makes more"
        )
    refuse_if_there(target, force=settings.force)
    return asyncio.run(_Recording(source, target, settings).run())


class _Recording:
    """One source into one file."""

    def __init__(self, source: CaptureSource, target: Path, settings: RecordSettings) -> None:
        self._source = source
        self._target = target
        self._settings = settings
        self._stop = asyncio.Event()
        self._topics: set[str] = set()
        self._early: list[Recorded] = []  # What comes before there is a file for it
        self._recorder: Recorder | None = None
        self._told = 0  # Messages when the last status line was written

    async def run(self) -> int:
        """The exit code."""
        began_s = time.monotonic()
        async with contextlib.AsyncExitStack() as source:
            await source.enter_async_context(self._source.receiving(self._receive))
            with stopped_by_signals(self._stop.set) as signals:
                recorder = self._recorder = Recorder(self._target, force=self._settings.force)
                try:
                    await self._work(recorder)
                    await source.aclose()
                finally:
                    await recorder.stop()
        self._conclude(recorder, time.monotonic() - began_s)
        if recorder.failure:
            return FAILED
        return INTERRUPTED if signal.SIGINT in signals else 0

    async def _work(self, recorder: Recorder) -> None:
        for recorded in self._early:
            self._receive(recorded)
        if not self._settings.as_json:
            say(f"recording {self._source.shown} to {self._target}; stop: Ctrl-C")
            sys.stdout.flush()
        flushing = asyncio.create_task(recorder.run(), name="flush")
        stopping = asyncio.create_task(self._stop.wait(), name="stop")
        tasks: set[asyncio.Task[Any]] = {flushing, stopping}
        if not self._settings.as_json:
            status = show_status(lambda: self._status(recorder))
            tasks.add(asyncio.create_task(status, name="status"))
        duration_s = self._settings.duration
        await asyncio.wait(tasks, timeout=duration_s, return_when=asyncio.FIRST_COMPLETED)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _receive(self, recorded: Recorded) -> None:
        if self._recorder is None:
            self._early.append(recorded)
            return
        count = self._settings.count
        if count is not None:
            if self._recorder.messages >= count:
                return
            if self._recorder.messages == count - 1:
                self._stop.set()
        self._recorder.write(recorded)
        if len(self._topics) < MAX_TOPICS:
            self._topics.add(recorded.topic)

    def _status(self, recorder: Recorder) -> str:
        rate = (recorder.messages - self._told) / interval_s()
        self._told = recorder.messages
        return f"{self._line(recorder)}  {rate:.0f}/s"

    def _line(self, recorder: Recorder) -> str:
        text = (
            f"messages {recorder.messages}  topics {len(self._topics)}  "
            f"{recorder.octets / 1e6:.2f} MB"
        )
        lost = (self._source.lost or 0) + recorder.dropped + recorder.refused
        return f"{text}  lost {lost}" if lost else text

    def _conclude(self, recorder: Recorder, lasted_s: float) -> None:
        """The totals, and what is missing."""
        lost = self._source.lost
        if self._settings.as_json:
            totals = {
                "file": str(self._target),
                "messages": recorder.messages,
                "octets": recorder.octets,
                "topics": len(self._topics),
                "seconds": round(lasted_s, 3),
                "lost": lost,
                "dropped": recorder.dropped,
                "refused": recorder.refused,
            }
            say(json.dumps(totals))
        else:
            show_last_status(self._line(recorder))
        if lost:
            say(f"plotfeed: {lost} datagrams were lost: the socket had no room", err=True)
        for line in recorder.losses():
            say(f"plotfeed: {line}", err=True)


MAX_WAITING_LINES = 100_000


async def show_live(
    source: CaptureSource,
    lines_of: Callable[[Recorded], Iterator[str]],
    count: int | None,
    duration_s: float | None,
) -> int:
    """Print so many of the lines of its messages, for so long; the exit code."""
    lines: asyncio.Queue[str] = asyncio.Queue(MAX_WAITING_LINES)
    dropped = 0

    def receive(message: Recorded) -> None:
        nonlocal dropped
        for line in lines_of(message):
            if lines.full():
                dropped += 1
            else:
                lines.put_nowait(line)

    async def print_lines() -> None:
        printed = 0
        while count is None or printed < count:
            say(await lines.get())
            printed += 1

    async with source.receiving(receive):
        printing = asyncio.create_task(print_lines(), name="print")
        with stopped_by_signals(printing.cancel) as signals:
            await asyncio.wait({printing}, timeout=duration_s)
        printing.cancel()
        await asyncio.gather(printing, return_exceptions=True)
    if dropped:
        say(f"plotfeed: {dropped} lines were not shown: the terminal is slower", err=True)
    return INTERRUPTED if signal.SIGINT in signals else 0

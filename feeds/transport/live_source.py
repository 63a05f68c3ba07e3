"""A live source at work: octets in, reports of drones out, and what autopilots are asked.

Octets come over UDP, TCP, serial ports, files, pipes and from services that are asked, by who sends
them. Connections that break and ports that are unplugged are made and opened anew.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import os
import socket
import threading
from collections.abc import Callable, Collection, Iterator
from functools import partial
from io import FileIO
from typing import Any
from urllib.parse import quote

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.console.posix import HAS_POSIX, watched
from plotfeed.feeds.scene.telemetry_keys import KINDS, SourceAddress, TelemetrySource
from plotfeed.feeds.telemetry.live.aircraft import AircraftReports
from plotfeed.feeds.telemetry.live.heard import HeardReport, Listener, remember
from plotfeed.feeds.telemetry.live.remote_id import NetworkRemoteIdReports, RemoteIdReports
from plotfeed.feeds.telemetry.position_report import PositionReport, Refused
from plotfeed.feeds.transport.http import HttpClient
from plotfeed.feeds.transport.mqtt.address import BrokerAccess
from plotfeed.feeds.transport.peers import PEER_LIMITS, SLICE_OCTETS, PeerTurns, Places
from plotfeed.feeds.transport.udp import lost_of, receiver_at
from plotfeed.feeds.transport.ways_out import SendError, TransportError, backoff_s

log = logging.getLogger(__name__)

HEARTBEAT_S = 1.0
ASK_EVERY_S = 10.0

Take = Callable[[str, PositionReport], object]  # Told of the reports of a drone
# Told of what was not taken, and of which drone; "" if that is not known.
Refuse = Callable[[str, Refused], object]


class LiveSource:
    """A source of a scene or of a command: listens, understands, and hands on."""

    def __init__(
        self,
        settings: TelemetrySource,
        *,
        now_utc_ns: Callable[[], int],
        take: Take,
        refuse: Refuse,
    ) -> None:
        """Raises `PlotfeedError` where a library is missing."""
        self.address = settings.address
        self.name = str(self.address)
        self._settings = settings
        stated = {"rcs_m2": settings.rcs_m2, "target_class": settings.target_class}
        self._stated: dict[str, Any] = {k: v for k, v in stated.items() if v is not None}
        self._take, self._refuse = take, refuse
        self._turns = PeerTurns(
            listener_of(settings),
            say=self._hand_on,
            note=partial(log.warning, "%s: %s", self.name),
            now_utc_ns=now_utc_ns,
        )
        self._octets: OctetSource
        if settings.view is None:
            self._octets = octets_of(self.address, self._turns, settings.interface)
        else:
            view = ",".join(f"{degrees:.6f}" for degrees in settings.view)
            self._octets = PolledOctets(self.address, self._turns, view, settings.poll_s)

    async def open(self) -> None:
        """Listen from now on; raises `TransportError`."""
        await self._octets.open()

    async def run(self) -> None:
        """Keep listening; returns where what is read has an end."""
        asks = self.address.transport == "udpout" or self._settings.ask_hz is not None
        asking = None
        if self.address.kind == "mavlink" and asks:
            asking = asyncio.create_task(self._ask())
        try:
            await self._octets.run()
            await self._turns.emptied()
        finally:
            if asking is not None:
                asking.cancel()

    def close(self) -> None:
        """Take no more."""
        self._octets.close()
        self._turns.close()

    def _hand_on(self, heard: HeardReport) -> None:
        if isinstance(heard.said, Refused):
            self._refuse(heard.drone, heard.said)
        else:
            said = heard.said._replace(**self._stated)
            self._take(heard.drone, said)

    async def _ask(self) -> None:
        """Say every second that somebody listens, and from time to time what is wanted."""
        from plotfeed.feeds.telemetry.live.mavlink import heartbeat, requests

        every_us = None if self._settings.ask_hz is None else round(1e6 / self._settings.ask_hz)
        beats = 0
        while True:
            for peer in list(self._octets.correspondents):
                self._octets.send(peer, heartbeat())
                if every_us is not None and beats % math.ceil(ASK_EVERY_S / HEARTBEAT_S) == 1:
                    for request in requests(every_us):
                        self._octets.send(peer, request)
            beats += 1
            await asyncio.sleep(HEARTBEAT_S)


def listener_of(settings: TelemetrySource) -> Listener:
    """Whoever understands a source; raises `PlotfeedError` where a library is missing."""
    if settings.address.kind == "mavlink":
        from plotfeed.feeds.telemetry.live.mavlink import MavlinkReports

        return MavlinkReports(settings.template, settings.altitude)
    if KINDS[settings.address.kind].is_traffic:
        return AircraftReports(settings.address.kind, settings.template, settings.qnh_hpa)
    if settings.address.transport == "http":
        return NetworkRemoteIdReports(settings.template)
    return RemoteIdReports(settings.template)


def octets_of(
    address: SourceAddress, taker: PeerTurns, interface: str | None = None
) -> OctetSource:
    """The way in to a source's octets."""
    if address.transport in ("udpin", "udpout"):
        return UdpOctets(address, taker, interface)
    if address.transport in ("tcp", "tcpin"):
        return TcpOctets(address, taker)
    if address.transport == "serial":
        return SerialOctets(address, taker)
    return PipedOctets(address, taker)


UDP, TCP = PEER_LIMITS["live source, UDP"], PEER_LIMITS["live source, TCP"]
BUFFER_OCTETS = 1 << 20
AT_ONCE = 16  # Datagrams, until something else has its turn


class OctetSource:
    """A way in for octets, by who sends them; a taker has them wait for their turn."""

    @property
    def correspondents(self) -> Collection[str]:
        """Who can be sent something."""
        return ()

    async def open(self) -> None:
        """Take what comes from now on; raises `TransportError`."""

    async def run(self) -> None:
        """Take what comes, until its end."""
        await asyncio.Event().wait()  # where the loop takes it, for ever

    def close(self) -> None:
        """Take no more."""

    def send(self, peer: str, data: bytes) -> None:
        """Send somebody something who has sent something, or was named."""


class UdpOctets(OctetSource):
    """A socket that is bound to a port, or sends to one, and takes what comes."""

    def __init__(
        self, address: SourceAddress, taker: PeerTurns, interface: str | None = None
    ) -> None:
        """`interface` is where a multicast group is joined."""
        self._address, self._taker, self._interface = address, taker, interface
        self._socket: socket.socket | None = None
        self._senders: dict[str, tuple[object, ...]] = {}
        self._lost = 0

    async def open(self) -> None:
        """Take what comes from now on; raises `TransportError`."""
        address = self._address
        try:
            if address.transport == "udpout":
                family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
                opened = socket.socket(family, socket.SOCK_DGRAM)
                opened.setblocking(False)
                opened.connect((address.host, address.port))
                self._senders[f"{address.host}:{address.port}"] = ()
            else:
                opened = receiver_at(address.host, address.port, self._interface, BUFFER_OCTETS)
        except OSError as error:
            at = f" at {self._interface}" if self._interface else ""
            raise TransportError(f"{address}{at}: {error.strerror or error}") from None
        self._socket = opened
        self._unwatch = watched(opened, partial(self._take, opened))

    def close(self) -> None:
        """Take no more."""
        if self._socket is not None:
            self._unwatch()
            self._socket.close()
            self._socket = None

    def send(self, peer: str, data: bytes) -> None:
        """Answer somebody who has sent something, or whoever was named."""
        to = self._senders.get(peer)
        if self._socket is None or to is None:
            return
        with contextlib.suppress(OSError):  # who is away hears nothing, and may come again
            if to:
                self._socket.sendto(data, to)
            else:
                self._socket.send(data)

    @property
    def correspondents(self) -> Collection[str]:
        """Who can be sent something."""
        return list(self._senders)

    def _take(self, opened: socket.socket) -> None:
        for _ in range(AT_ONCE):
            try:
                data, sender = opened.recvfrom(UDP.octets)
            except OSError:  # there is nothing, or only word of an error
                break
            peer = f"{sender[0]}:{sender[1]}"
            if self._address.transport == "udpin":
                remember(self._senders, peer, sender, UDP.peers)
            if data:
                self._taker.put(peer, data)
        if (lost := lost_of(opened) or 0) > self._lost:
            why = f"{self._address}: more comes than the socket has room for"
            self._taker.refuse(why, lost - self._lost)
            self._lost = lost


class TcpOctets(OctetSource):
    """A connection to somebody, made again whenever it ends, or connections that others make."""

    def __init__(self, address: SourceAddress, taker: PeerTurns) -> None:
        self._address, self._taker = address, taker
        self._writers: dict[str, asyncio.StreamWriter] = {}
        self._places = Places[str](TCP)
        self._server: asyncio.Server | None = None

    async def open(self) -> None:
        """Listen, where others connect; raises `TransportError`."""
        address = self._address
        if address.transport != "tcpin":
            return
        try:
            self._server = await asyncio.start_server(
                self._accepted, address.host, address.port, limit=TCP.octets
            )
        except OSError as error:
            raise TransportError(f"{address}: {error.strerror or error}") from None

    async def run(self) -> None:
        """Keep the connection up, or wait for ever where others connect."""
        if self._server is not None:
            await super().run()
        attempt, was_told = 0, False
        while True:
            try:
                reader, writer = await asyncio.open_connection(
                    self._address.host, self._address.port, limit=TCP.octets
                )
            except OSError as error:
                if not was_told:
                    log.warning("%s: %s; tried again", self._address, error.strerror or error)
                    was_told = True
            else:
                if was_told:
                    log.warning("%s: connected", self._address)
                has_come = await self._read(reader, writer)
                attempt = 0 if has_come else attempt
                log.warning("%s: the connection has ended; made anew", self._address)
                was_told = True
            await asyncio.sleep(backoff_s(attempt))
            attempt += 1

    def close(self) -> None:
        """Take no more."""
        if self._server is not None:
            self._server.close()
            self._server = None
        for writer in self._writers.values():
            writer.close()
        self._writers.clear()

    def send(self, peer: str, data: bytes) -> None:
        """Send something over a connection that is there."""
        writer = self._writers.get(peer)
        # Who reads nothing is sent nothing more.
        if writer is not None and writer.transport.get_write_buffer_size() < TCP.octets:
            writer.write(data)

    @property
    def correspondents(self) -> Collection[str]:
        """Who is connected."""
        return list(self._writers)

    async def _accepted(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        # asyncio asks its task what it raised, which a cancelled one answers by raising.
        with contextlib.suppress(asyncio.CancelledError):
            await self._read(reader, writer)

    async def _read(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bool:
        """Take what comes until the connection ends; whether anything came."""
        host, port = (writer.get_extra_info("peername") or ("", 0))[:2]
        peer, has_come = f"{host}:{port}", False
        self._writers[peer] = writer
        self._places.take(peer, host, partial(self._leave, peer))
        _keep_alive(writer.get_extra_info("socket"))
        try:
            while data := await reader.read(TCP.octets):
                has_come = True
                self._places.heard(peer)
                await self._taker.hear(peer, data)
        except OSError:
            pass  # it is over
        finally:
            self._writers.pop(peer, None)
            self._places.give_up(peer)
            writer.close()
            self._taker.gone(peer)
        return has_come

    def _leave(self, peer: str) -> None:
        self._taker.refuse(f"{peer}: its connection gave way: {TCP.peers} are the most kept")
        self._writers[peer].transport.abort()


def _keep_alive(connection: socket.socket) -> None:
    """Have the system find out within half a minute that the other side is gone."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 4)):
        if hasattr(socket, name):
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


READ_OCTETS = PEER_LIMITS["live source, serial port, file or pipe"].octets
REOPEN_S = 1.0  # Between attempts to open a port


class SerialOctets(OctetSource):
    """A serial port, raw, 8 bits, no parity, 1 stop bit; opened again when it comes back."""

    def __init__(self, address: SourceAddress, taker: PeerTurns) -> None:
        """Raises `PlotfeedError` without pyserial."""
        need_extra("serial", "a serial port", "serial")
        self._address, self._taker = address, taker
        self._opened = contextlib.ExitStack()
        self._ended = asyncio.Event()

    async def open(self) -> None:
        """Open the port; raises `TransportError`."""
        from serial import Serial  # an extra

        path, baud = self._address.path, self._address.baud
        if baud not in Serial.BAUDRATES:
            raise TransportError(f"{self._address}: {baud} baud is no usual rate")
        try:
            port = await asyncio.to_thread(Serial, path, baud, timeout=0, write_timeout=0)
        except Exception as error:  # noqa: BLE001 - those of termios are no OSError
            why = getattr(error.__context__, "strerror", f"{error}: expected a serial port")
            raise TransportError(f"{self._address}: {why}") from None
        self._opened.callback(port.close)
        # On POSIX pyserial itself would write again and again until all is taken.
        self._line = FileIO(port.fileno(), "r+", closefd=False) if HAS_POSIX else port
        self._opened.callback(self._line.close)
        self._opened.callback(watched(port, self._take))

    async def run(self) -> None:
        """Open the port again whenever it was lost."""
        while True:
            await self._ended.wait()
            log.warning("%s: the port is gone; tried again", self._address)
            self._taker.gone(self._address.path)
            while self._ended.is_set():
                await asyncio.sleep(REOPEN_S)
                with contextlib.suppress(TransportError):
                    await self.open()
                    self._ended.clear()
            log.warning("%s: the port is back", self._address)

    def close(self) -> None:
        """Take no more."""
        self._opened.close()

    @property
    def correspondents(self) -> Collection[str]:
        """Whoever is at the other end."""
        return (self._address.path,)

    def send(self, peer: str, data: bytes) -> None:
        """Write to the port what it takes at once."""
        del peer
        with contextlib.suppress(OSError, ValueError):  # it is closed
            self._line.write(data)

    def _take(self) -> None:
        try:
            data = self._line.read(READ_OCTETS)
            is_gone = HAS_POSIX and data == b""  # which is read only when something is there
        except OSError:
            is_gone = True
        if is_gone:
            self.close()
            self._ended.set()
        elif data:
            for at in range(0, len(data), SLICE_OCTETS):
                self._taker.put(self._address.path, data[at : at + SLICE_OCTETS])


class PipedOctets(OctetSource):
    """A file, a named pipe or standard input, read to its end by a thread of its own.

    Nothing else waits for what blocks, such as a pipe to which nobody writes.
    """

    def __init__(self, address: SourceAddress, taker: PeerTurns) -> None:
        self._address, self._taker = address, taker
        self._peer = address.path or "-"
        self._is_taken = threading.Event()
        self._is_closed = False

    async def open(self) -> None:
        """See whether there is such a file; raises `TransportError`."""
        if self._address.transport == "file" and not os.access(self._address.path, os.R_OK):
            raise TransportError(f"{self._address}: no file that can be read")

    async def run(self) -> None:
        """Take all there is, and return at the end."""
        loop, done = asyncio.get_running_loop(), asyncio.Event()

        async def take(data: bytes) -> None:
            try:
                if not self._is_closed:
                    await self._taker.hear(self._peer, data)
            finally:
                self._is_taken.set()

        def read() -> None:
            with contextlib.suppress(RuntimeError):  # the loop is closed: nobody wants any more
                try:
                    for data in self._pieces():
                        self._is_taken.clear()
                        asyncio.run_coroutine_threadsafe(take(data), loop)
                        self._is_taken.wait()
                except OSError as error:
                    log.warning("%s: %s", self._address, error.strerror or error)
                loop.call_soon_threadsafe(done.set)

        threading.Thread(target=read, name=f"reads {self._peer}", daemon=True).start()
        await done.wait()
        self._taker.gone(self._peer)

    def close(self) -> None:
        """Take no more."""
        self._is_closed = True
        self._is_taken.set()

    def _pieces(self) -> Iterator[bytes]:
        is_stdin = self._address.transport == "stdin"
        source = 0 if is_stdin else self._peer
        with open(source, "rb", buffering=0, closefd=not is_stdin) as file:
            while not self._is_closed and (data := file.read(READ_OCTETS)):
                yield data


POLL_TOKEN = "PLOTFEED_REMOTE_ID_TOKEN"  # noqa: S105 - where it is, not what it is
ANSWER = PEER_LIMITS["live source, HTTP: an answer"]
SLOWEST_S = 30.0  # Between two questions to a service that fails
WHY = {
    401: f"it wants a token: {POLL_TOKEN}",
    403: f"it does not let that token in: {POLL_TOKEN}",
    413: "the view is too large for it: 7 km across at most",
}


class PolledOctets(OctetSource):
    """GET {base}/uss/flights?view=..., each answer whole to the taker."""

    def __init__(self, address: SourceAddress, taker: PeerTurns, view: str, every_s: float) -> None:
        self._address, self._taker, self._every_s = address, taker, every_s
        self._url = f"{address.path.rstrip('/')}/uss/flights?view={quote(view, safe=',')}"
        self._is_told = False

    async def open(self) -> None:
        """See whether the token can be sent; raises `TransportError`."""
        token = os.environ.get(POLL_TOKEN, "")
        if not (token.isascii() and token.isprintable()):
            raise TransportError(f"{POLL_TOKEN}: expected printable ASCII")

    async def run(self) -> None:
        """Ask for ever: at the usual interval, more slowly while there is no answer."""
        wait_s = self._every_s
        while True:
            try:
                answer = await self._get()
            except SendError as error:
                if not self._is_told:
                    log.warning("%s: %s; asked again", self._address, error)
                    self._is_told = True
                wait_s = min(2 * wait_s, max(SLOWEST_S, self._every_s))
            else:
                if self._is_told:
                    log.warning("%s: it answers again", self._address)
                    self._is_told = False
                wait_s = self._every_s
                self._taker.put(str(self._address), answer)
            await asyncio.sleep(wait_s)

    async def _get(self) -> bytes:
        fields = ["Accept: application/json", "Connection: close"]
        if token := os.environ.get(POLL_TOKEN):
            fields.append(f"Authorization: Bearer {token}")
        tls = BrokerAccess().tls_context() if self._url.startswith("https") else None
        server = HttpClient(self._url, tls, fields)
        try:
            status, answer = await server.ask(
                "GET", (), b"", timeout_s=ANSWER.patience_s, most=ANSWER.octets
            )
        finally:
            server.hang_up()
        if status != 200:
            raise SendError(f"status {status}" + (f", {WHY[status]}" if status in WHY else ""))
        if answer is None:
            raise SendError(f"an answer of more than {ANSWER.octets} octets")
        return answer

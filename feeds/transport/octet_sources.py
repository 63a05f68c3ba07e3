"""Octets that come in over UDP and TCP, by who sends them; connections that break are made anew."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import logging
import socket
from collections.abc import Callable
from functools import partial
from typing import Protocol

from plotfeed.feeds.console.posix import watched
from plotfeed.feeds.scene.telemetry_keys import SourceAddress
from plotfeed.feeds.transport.multicast_groups import interface_number, join_group
from plotfeed.proto.errors import PlotfeedError

log = logging.getLogger(__name__)

LARGEST_OCTETS = 1 << 16
BUFFER_OCTETS = 1 << 20
AT_ONCE = 64  # Datagrams, until something else has its turn
# Between attempts to connect: each of them, and the last from then on.
AGAIN_S = (0.5, 1.0, 2.0, 5.0)
MAX_CONNECTIONS = 64
MAX_CORRESPONDENTS = 256


class SourceError(PlotfeedError):
    """A source that cannot be listened to."""

    exit_code = 1


class OctetsTaker(Protocol):
    """Whoever is told what comes."""

    def octets(self, peer: str, data: bytes) -> None:
        """A peer has sent these."""

    def gone(self, peer: str) -> None:
        """A peer's connection has ended."""


Send = Callable[[str, bytes], None]


class UdpOctets:
    """A socket that is bound to a port, or sends to one, and takes what comes."""

    def __init__(
        self, address: SourceAddress, taker: OctetsTaker, interface: str | None = None
    ) -> None:
        """`interface` is where a multicast group is joined."""
        self._address, self._taker, self._interface = address, taker, interface
        self._socket: socket.socket | None = None
        self._senders: dict[str, tuple[object, ...]] = {}

    @property
    def bound_port(self) -> int:
        """The port that the socket has; 0 before it is open."""
        return 0 if self._socket is None else int(self._socket.getsockname()[1])

    async def open(self) -> None:
        """Take what comes from now on; raises `SourceError`."""
        address = self._address
        family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
        opened = socket.socket(family, socket.SOCK_DGRAM)
        try:
            opened.setblocking(False)
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_OCTETS)
            if address.transport == "udpout":
                opened.connect((address.host, address.port))
                self._senders[f"{address.host}:{address.port}"] = ()
            elif address.is_multicast:
                self._join(opened)
            else:
                opened.bind((address.host, address.port))
        except OSError as error:
            opened.close()
            at = f" at {self._interface}" if self._interface else ""
            raise SourceError(f"{address}{at}: {error.strerror or error}") from None
        self._socket = opened
        self._unwatch = watched(opened, partial(self._take, opened))

    async def run(self) -> None:
        """Wait for ever: what comes is taken by the loop."""
        await asyncio.Event().wait()

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
    def correspondents(self) -> list[str]:
        """Who can be sent something."""
        return list(self._senders)

    def _join(self, opened: socket.socket) -> None:
        host, port = self._address.host.partition("%")[0], self._address.port
        group = ipaddress.ip_address(self._address.host)
        # Others on this machine may receive the group too.
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if group.version == 4:
            opened.bind((host, port))
        else:  # whose scope may need its interface
            opened.bind((host, port, 0, interface_number(group, self._interface)))
        join_group(opened, group, self._interface)

    def _take(self, opened: socket.socket) -> None:
        for _ in range(AT_ONCE):
            try:
                data, sender = opened.recvfrom(LARGEST_OCTETS)
            except OSError:  # there is nothing, or only word of an error
                return
            peer = f"{sender[0]}:{sender[1]}"
            if self._address.transport == "udpin" and peer not in self._senders:
                if len(self._senders) >= MAX_CORRESPONDENTS:
                    del self._senders[next(iter(self._senders))]
                self._senders[peer] = sender
            self._taker.octets(peer, data)


class TcpOctets:
    """A connection to somebody, made again whenever it ends, or connections that others make."""

    def __init__(self, address: SourceAddress, taker: OctetsTaker) -> None:
        self._address, self._taker = address, taker
        self._writers: dict[str, asyncio.StreamWriter] = {}
        self._server: asyncio.Server | None = None

    @property
    def bound_port(self) -> int:
        """The port that is listened at; 0 where none is."""
        return 0 if self._server is None else int(self._server.sockets[0].getsockname()[1])

    async def open(self) -> None:
        """Listen, where others connect; raises `SourceError`."""
        address = self._address
        if address.transport != "tcpin":
            return
        try:
            self._server = await asyncio.start_server(self._accepted, address.host, address.port)
        except OSError as error:
            raise SourceError(f"{address}: {error.strerror or error}") from None

    async def run(self) -> None:
        """Keep the connection up, or wait for ever where others connect."""
        if self._server is not None:
            await asyncio.Event().wait()
        attempt, was_told = 0, False
        while True:
            try:
                reader, writer = await asyncio.open_connection(
                    self._address.host, self._address.port, limit=LARGEST_OCTETS
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
            await asyncio.sleep(AGAIN_S[min(attempt, len(AGAIN_S) - 1)])
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
        if writer is not None and writer.transport.get_write_buffer_size() < LARGEST_OCTETS:
            writer.write(data)

    @property
    def correspondents(self) -> list[str]:
        """Who is connected."""
        return list(self._writers)

    async def _accepted(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._writers) >= MAX_CONNECTIONS:
            log.warning("%s: more than %d connections", self._address, MAX_CONNECTIONS)
            writer.close()
            return
        await self._read(reader, writer)

    async def _read(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bool:
        """Take what comes until the connection ends; whether anything came."""
        host, port = (writer.get_extra_info("peername") or ("", 0))[:2]
        peer, has_come = f"{host}:{port}", False
        self._writers[peer] = writer
        _keep_alive(writer.get_extra_info("socket"))
        try:
            while data := await reader.read(LARGEST_OCTETS):
                has_come = True
                self._taker.octets(peer, data)
        except OSError:
            pass  # it is over
        finally:
            self._writers.pop(peer, None)
            writer.close()
            self._taker.gone(peer)
        return has_come


def _keep_alive(connection: socket.socket) -> None:
    """Have the system find out within half a minute that the other side is gone."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 4)):
        if hasattr(socket, name):
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)

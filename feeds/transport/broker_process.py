"""The process of the embedded broker: its sockets, and the WebSocket where there is one.

Run as a module; the first line of its standard input is its orders in JSON, the first of its
standard output its ports, or why it has none. It serves until its input ends, which it does when
the parent ends, however that ends, and leaves no file behind. What there is to tell of clients is a
line each on its output.
"""

from __future__ import annotations

import asyncio
import contextlib
import http
import json
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, cast

from plotfeed.feeds.console.posix import allow_many_files
from plotfeed.feeds.transport.mqtt.broker import Broker, BrokerLimits, Connection, Rights, User

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

TICK_S = 0.25
MAX_UNSENT_OCTETS = 1 << 20  # That a connection has in hand; what is more waits in the broker
MAX_BEHIND_OCTETS = 1 << 17  # The same, of the session, by the system too
LINES_A_MINUTE = 30  # That are told; whoever comes again and again fills no log
BACKLOG, LAST_PORT = 1024, 65_535
# So long a session that ended just now may still have the ports that a scene names.
PORT_PATIENCE_S = 3.0


def main() -> None:
    """Serve what the orders say."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    orders = json.loads(sys.stdin.buffer.readline())
    threading.Thread(target=_end_with_parent, daemon=True).start()
    allow_many_files()
    try:
        found = listeners(orders["host"], orders["ports"], may_be_others=orders["may_be_others"])
    except PortTakenError as error:
        print(json.dumps({"taken": error.port}), flush=True)  # noqa: T201 - the parent reads it
    except OSError as error:
        why = str(error.strerror).partition(" (while")[0]  # without the address
        print(json.dumps({"error": why}), flush=True)  # noqa: T201 - the parent reads it
    else:
        asyncio.run(serve(orders, *found))


def _end_with_parent() -> None:
    sys.stdin.buffer.read()
    os._exit(0)


class PortTakenError(Exception):
    """A port that may not be another, and is somebody else's."""

    def __init__(self, port: int) -> None:
        super().__init__(port)
        self.port = port


def listeners(host: str, ports: Sequence[int], *, may_be_others: bool) -> list[socket.socket]:
    """A socket that listens at each port there, at a free one where that is taken and may be other.

    Raises `PortTakenError`, and `OSError` where nobody can listen at any port.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    deadline_s = time.monotonic() + PORT_PATIENCE_S
    found: list[socket.socket] = []
    for port in ports:
        while True:
            with contextlib.suppress(OSError):
                if port <= LAST_PORT:
                    found.append(socket.create_server((host, port), family=family, backlog=BACKLOG))
                    break
            other = socket.create_server((host, 0), family=family, backlog=BACKLOG)
            if may_be_others:
                found.append(other)
                break
            other.close()
            if time.monotonic() > deadline_s:
                raise PortTakenError(port)
            time.sleep(0.05)
    return found


async def serve(
    orders: dict[str, Any], mqtt: socket.socket, websocket: socket.socket | None = None
) -> None:
    """Serve on sockets that listen until cancelled; the ports are told first."""
    loop, lines = asyncio.get_running_loop(), _Lines()
    users = {
        name: User(user["password"], Rights(**user["rights"]))
        for name, user in orders["users"].items()
    }
    anonymous = Rights() if orders["anonymous"] else None
    limits = BrokerLimits(**orders["limits"])
    broker = Broker(limits, users, anonymous=anonymous, tell=lines.tell)
    attend = partial(_Client, broker, orders, set[_Client]())
    await loop.create_server(attend, sock=mqtt, backlog=BACKLOG)
    if websocket is not None:
        await _serve_websocket(attend, orders, websocket)
    ports = [each.getsockname()[1] for each in (mqtt, websocket) if each is not None]
    lines.tell(json.dumps({"ports": ports}))
    while True:
        broker.tick(loop.time())
        lines.tick(loop.time())
        await asyncio.sleep(TICK_S)


class _Lines:
    """What is told of clients, on standard output, not too much of it."""

    def __init__(self) -> None:
        self._since_s, self._told = 0.0, 0

    def tell(self, line: str) -> None:
        self._told += 1
        if self._told <= LINES_A_MINUTE:
            print(line, flush=True)  # noqa: T201 - the parent reads it

    def tick(self, now_s: float) -> None:
        if now_s - self._since_s < 60:
            return
        more, self._since_s, self._told = self._told - LINES_A_MINUTE, now_s, 0
        if more > 0:
            self.tell(f"{more} more such lines in a minute")


class _Client(asyncio.Protocol):
    """A client's TCP connection. What it publishes beyond its rate is read later.

    So is what all publish while the session has not taken what it was sent: it counts and tells
    what it drops, and nothing is lost before.
    """

    def __init__(self, broker: Broker, orders: Mapping[str, Any], others: set[_Client]) -> None:
        self._broker, self._others = broker, others
        self._rate, self._trusted = orders["messages_per_s"], orders["trusted"]
        self._loop = asyncio.get_running_loop()
        self._unsent: list[bytes] = []
        self._window_s, self._before = 0.0, 0
        self._is_session = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        self._transport.set_write_buffer_limits(high=MAX_UNSENT_OCTETS)
        self._connection: Connection = self._broker.connect(self._write, self._close)
        self._others.add(self)

    def data_received(self, data: bytes) -> None:
        connection = self._connection
        if connection.session is None:
            connection.receive(data)
            self._is_session = connection.user == self._trusted
            if self._is_session:
                # What waits for it should wait where it came from, in its own connection.
                self._transport.set_write_buffer_limits(high=MAX_BEHIND_OCTETS)
                of_kernel = self._transport.get_extra_info("socket")
                of_kernel.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, MAX_BEHIND_OCTETS)
            return
        connection.receive(data)
        if connection.messages - self._before < self._rate or self._is_session:
            return
        now_s = self._loop.time()
        wait_s = self._window_s + 1 - now_s
        self._window_s, self._before = max(now_s, self._window_s + 1), connection.messages
        if wait_s > 0:
            self._transport.pause_reading()
            self._loop.call_later(wait_s, self._read_on)

    def _read_on(self) -> None:
        self._connection.heard_s = self._loop.time()
        if not self._transport.is_closing():
            self._transport.resume_reading()

    def pause_writing(self) -> None:
        self._connection.resume(has_room=False)
        if self._is_session:
            for other in self._others - {self}:
                other._transport.pause_reading()

    def resume_writing(self) -> None:
        self._connection.resume(has_room=True)
        if self._is_session:
            for other in self._others - {self}:
                other._read_on()

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002
        self._others.discard(self)
        if self._is_session:
            self.resume_writing()
        self._connection.end()

    def _write(self, octets: bytes) -> None:
        if not self._unsent:
            self._loop.call_soon(self._flush)
        self._unsent.append(octets)

    def _flush(self) -> None:
        octets, self._unsent = b"".join(self._unsent), []
        if not self._transport.is_closing():
            self._transport.write(octets)

    def _close(self) -> None:
        self._flush()
        self._transport.close()


async def _serve_websocket(
    attend: Callable[[], _Client], orders: dict[str, Any], at: socket.socket
) -> None:
    """MQTT in WebSocket, for pages of the origins named and for who is no browser.

    Its octets go through a pair of sockets, so that they are a client's like those of others.
    """
    from websockets.asyncio.server import serve
    from websockets.typing import Origin, Subprotocol

    async def pass_on(client: ServerConnection) -> None:
        ours, theirs = socket.socketpair()
        await asyncio.get_running_loop().connect_accepted_socket(attend, theirs)
        said, writer = await asyncio.open_connection(sock=ours)

        async def tell() -> None:
            while octets := await said.read(MAX_BEHIND_OCTETS):
                await client.send(octets)
            await client.close()

        telling = asyncio.create_task(tell())
        with contextlib.suppress(Exception):  # its connection is lost
            async for data in client:
                writer.write(data.encode() if isinstance(data, str) else data)
                await writer.drain()
        telling.cancel()
        writer.close()

    server = await serve(
        pass_on,
        sock=at,
        origins=[None, *map(Origin, orders["origins"])],
        subprotocols=[Subprotocol("mqtt")],
        compression=None,
        max_size=orders["limits"]["payload_octets"] + (1 << 18),
        process_request=_refusal if orders["on_loopback"] else None,
    )
    await server.start_serving()


def _refusal(client: ServerConnection, request: Request) -> Response | None:
    """Answer those whose page has a name of its own for this machine."""
    from plotfeed.feeds.transport.local_hosts import LOOPBACK_NAMES, name_in_host

    if name_in_host(request.headers.get("Host", "")) in LOOPBACK_NAMES:
        return None
    return client.respond(http.HTTPStatus.FORBIDDEN, "This is not the host that was asked for.\n")


if __name__ == "__main__":
    main()

"""Who listens to what commands send: a socket for datagrams, and a broker of few words."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field

from digest_items import without_pace

BUFFER_OCTETS = 32 << 20
CONNECT, PUBLISH, SUBSCRIBE, PING = 0x10, 0x30, 0x80, 0xC0


@dataclass
class Listener:
    port: int
    heard: list[bytes] = field(default_factory=list)


@contextlib.contextmanager
def datagrams() -> Iterator[Listener]:
    """Takes datagrams; all that were sent by then are in it after the block."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        for option in (getattr(socket, "SO_RCVBUFFORCE", 33), socket.SO_RCVBUF):
            with contextlib.suppress(OSError):
                server.setsockopt(socket.SOL_SOCKET, option, BUFFER_OCTETS)
                break
        server.bind(("127.0.0.1", 0))
        server.settimeout(0.1)
        listener = Listener(server.getsockname()[1])
        ended = threading.Event()
        thread = threading.Thread(target=_take, args=(server, listener, ended))
        thread.start()
        try:
            yield listener
        finally:
            ended.set()
            thread.join()


def _take(server: socket.socket, listener: Listener, ended: threading.Event) -> None:
    while True:
        try:
            listener.heard.append(server.recv(65536))
        except TimeoutError:
            if ended.is_set():
                return


@dataclass
class Broker:
    """MQTT 5 without subscribers: it takes what is published, by topic.

    Packet identifiers and client ids are left out, for they are new in each run; and so is the
    order between topics, since each sensor has a connection of its own.
    """

    port: int = 0
    topics: dict[str, list[str]] = field(default_factory=dict)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def serve(self, client: socket.socket) -> None:
        gone = contextlib.suppress(OSError, IndexError)
        with gone, client, client.makefile("rb") as stream:
            while head := stream.read(1):
                self._answer(client, head[0], stream.read(_length(stream)))

    def _answer(self, client: socket.socket, kind: int, body: bytes) -> None:
        if kind & 0xF0 == CONNECT:
            client.sendall(bytes([0x20, 3, 0, 0, 0]))
        elif kind & 0xF0 == SUBSCRIBE:
            client.sendall(bytes([0x90, 4, *body[:2], 0, 1]))
        elif kind & 0xF0 == PING:
            client.sendall(bytes([0xD0, 0]))
        elif kind & 0xF0 == PUBLISH:
            self._take(client, kind, body)

    def _take(self, client: socket.socket, kind: int, body: bytes) -> None:
        end = 2 + int.from_bytes(body[:2], "big")
        topic, rest = body[2:end].decode(), body[end:]
        if kind & 0x06:
            client.sendall(bytes([0x40, 2]) + rest[:2])
            rest = rest[2:]
        length, at, shift = 0, 0, 0
        while True:
            length |= (rest[at] & 0x7F) << shift
            at, shift = at + 1, shift + 7
            if not rest[at - 1] & 0x80:
                break
        with self.lock:
            properties, payload = rest[at : at + length], rest[at + length :]
            line = f"{kind & 0x07} {properties.hex()} {without_pace(topic, payload).hex()}"
            self.topics.setdefault(topic, []).append(line)


def _length(stream: object) -> int:
    length = shift = 0
    while True:
        octet = stream.read(1)[0]  # type: ignore[attr-defined]
        length |= (octet & 0x7F) << shift
        shift += 7
        if not octet & 0x80:
            return length


@contextlib.contextmanager
def broker() -> Iterator[Broker]:
    """On loopback, until the block is left and all who have come are gone."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        found = Broker(server.getsockname()[1])
        server.settimeout(0.1)
        ended = threading.Event()
        thread = threading.Thread(target=_welcome, args=(server, found, ended))
        thread.start()
        try:
            yield found
        finally:
            ended.set()
            thread.join()


def _welcome(server: socket.socket, found: Broker, ended: threading.Event) -> None:
    threads = []
    while not ended.is_set():
        with contextlib.suppress(TimeoutError):
            client, _ = server.accept()
            client.settimeout(None)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threads.append(threading.Thread(target=found.serve, args=(client,)))
            threads[-1].start()
    for thread in threads:
        thread.join(10.0)

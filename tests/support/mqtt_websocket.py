"""MQTT 3.1.1 over WebSocket as a browser does it: RFC 6455 by hand, and nothing is forgiven."""

from __future__ import annotations

import base64
import hashlib
import os
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from support.waiting import PATIENCE_S

GUID = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
ORIGIN = "http://127.0.0.1:8000"
FOR_BROWSERS = f'[mqtt.embedded]\nwebsocket_origins = ["{ORIGIN}"]'  # Lets a page of that origin in
BINARY, CLOSE, PING, PONG = 2, 8, 9, 10


@dataclass(frozen=True)
class Published:
    topic: str
    payload: bytes
    retained: bool


class BrowserClient:
    """A page's connection: it asks for the subprotocol mqtt and must be granted it."""

    def __init__(
        self, port: int, *filters: str, origin: str = ORIGIN, host: str = "127.0.0.1"
    ) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
        self._octets = b""
        self._stream = b""
        try:
            self._connect(host, origin, filters)
        except BaseException:
            self._socket.close()
            raise

    def _connect(self, host: str, origin: str, filters: tuple[str, ...]) -> None:
        port = self._socket.getpeername()[1]
        self._greet(f"{host}:{port}", origin)
        self._send(0x10, _text("MQTT") + bytes([4, 2]) + b"\0\x3c" + _text(f"page-{os.getpid()}"))
        assert self._packet() == (0x20, b"\0\0")
        for i, topic_filter in enumerate(filters, 1):
            self._send(0x82, struct.pack(">H", i) + _text(topic_filter) + b"\0")
        self._early: list[Published] = []
        acknowledged = 0
        while acknowledged < len(filters):  # retained messages may come before
            kind, body = self._packet()
            acknowledged += kind == 0x90
            self._early += [_published(kind, body)] if kind & 0xF0 == 0x30 else []

    def published(self) -> Iterator[Published]:
        """What comes, one after the other; fails if nothing does for long."""
        yield from self._early
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            kind, body = self._packet()
            if kind & 0xF0 == 0x30:
                yield _published(kind, body)
        raise AssertionError("what was waited for never came")

    def close(self) -> None:
        self._socket.close()

    def _greet(self, host: str, origin: str) -> None:
        key = base64.b64encode(os.urandom(16)).decode()
        lines = [
            "GET /mqtt HTTP/1.1",
            f"Host: {host}",
            "Connection: Upgrade",
            "Upgrade: websocket",
            f"Origin: {origin}",
            f"Sec-WebSocket-Key: {key}",
            "Sec-WebSocket-Version: 13",
            "Sec-WebSocket-Protocol: mqtt",
            "Sec-WebSocket-Extensions: permessage-deflate; client_max_window_bits",
        ]
        self._socket.sendall("\r\n".join([*lines, "", ""]).encode())
        while b"\r\n\r\n" not in self._octets:
            self._octets += self._received()
        head, _, self._octets = self._octets.partition(b"\r\n\r\n")
        status, *fields = head.decode().split("\r\n")
        if not status.startswith("HTTP/1.1 101 "):
            self.close()
            raise ConnectionRefusedError(status)
        named = {name.strip().lower(): value.strip() for name, value in _pairs(fields)}
        digest = hashlib.sha1((key + GUID).encode(), usedforsecurity=False).digest()
        assert named["sec-websocket-accept"] == base64.b64encode(digest).decode()
        assert named["sec-websocket-protocol"] == "mqtt"  # else a browser closes the connection
        assert "sec-websocket-extensions" not in named  # frames are read as they are

    def _send(self, kind: int, body: bytes) -> None:
        assert len(body) < 128
        self._send_frame(BINARY, bytes([kind, len(body)]) + body)

    def _send_frame(self, opcode: int, data: bytes) -> None:
        mask = os.urandom(4)
        masked = bytes(octet ^ mask[i % 4] for i, octet in enumerate(data))
        self._socket.sendall(bytes([0x80 | opcode, 0x80 | len(data)]) + mask + masked)

    def _packet(self) -> tuple[int, bytes]:
        """The next MQTT packet, wherever frames begin and end."""
        kind = self._taken(1)[0]
        length = shift = 0
        while True:
            octet = self._taken(1)[0]
            length |= (octet & 0x7F) << shift
            shift += 7
            if not octet & 0x80:
                return kind, self._taken(length)

    def _taken(self, n: int) -> bytes:
        while len(self._stream) < n:
            opcode, data = self._frame()
            assert opcode != CLOSE, data
            if opcode == PING:
                self._send_frame(PONG, data)
            elif opcode in (0, BINARY):
                self._stream += data
        taken, self._stream = self._stream[:n], self._stream[n:]
        return taken

    def _frame(self) -> tuple[int, bytes]:
        first, length = self._read(2)
        assert not length & 0x80, "a server does not mask"
        if length == 126:
            (length,) = struct.unpack(">H", self._read(2))
        elif length == 127:
            (length,) = struct.unpack(">Q", self._read(8))
        return first & 0x0F, self._read(length)

    def _read(self, n: int) -> bytes:
        while len(self._octets) < n:
            self._octets += self._received()
        read, self._octets = self._octets[:n], self._octets[n:]
        return read

    def _received(self) -> bytes:
        octets = self._socket.recv(1 << 16)
        if not octets:
            self.close()
            raise ConnectionResetError
        return octets


@contextmanager
def browsing(port: int, *filters: str, **headers: str) -> Iterator[BrowserClient]:
    client = BrowserClient(port, *filters, **headers)
    try:
        yield client
    finally:
        client.close()


def _pairs(fields: list[str]) -> Iterator[tuple[str, str]]:
    for line in fields:
        name, _, value = line.partition(":")
        yield name, value


def _text(value: str) -> bytes:
    return struct.pack(">H", len(value.encode())) + value.encode()


def _published(kind: int, body: bytes) -> Published:
    end = 2 + int.from_bytes(body[:2], "big")
    assert not kind & 0x06, "it was subscribed with QoS 0"
    return Published(body[2:end].decode(), body[end:], bool(kind & 1))

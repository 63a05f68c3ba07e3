"""A receiver of MQTT 3.1.1 and 5 on a bare socket, sharing nothing with what sessions send by."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Self
from uuid import uuid4

PATIENCE_S = 120.0  # On a machine that may be busy
AT_ONCE = 1 << 16  # Octets that are read together


@dataclass(frozen=True)
class MqttMessage:
    """A message as the broker delivered it."""

    topic: str
    payload: bytes
    retained: bool
    content_type: str | None = None
    user_properties: dict[str, str] = field(default_factory=dict)
    expiry_s: int | None = None  # What was left until it expires
    qos: int = 0
    at_s: float = field(default=0.0, compare=False)  # When it came, by the monotonic clock


class MqttReceiver:
    """A subscriber of a broker on this machine, which keeps every message that comes.

    It is connected and subscribed once it is made, and receives in a thread until it is closed, as
    it is at the end of a `with`.
    """

    def __init__(
        self, port: int, version: int, *filters: str, user: tuple[str, str] | None = None
    ) -> None:
        """`version` is 4 for MQTT 3.1.1 and 5 for MQTT 5; `filters` are those of topics.

        `user` is a name and its password. Raises `OSError` where no broker answers, or it refuses.
        """
        self.version = version
        self.heard: list[MqttMessage] = []  # All that came, in order
        self.ended = False  # Whether the broker has ended the connection
        self._has_left = False
        self._news = threading.Condition()
        self._socket = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
        self._incoming = self._socket.makefile("rb", AT_ONCE)
        try:
            self._greet(user)
            for i, topic_filter in enumerate(filters):
                self._send(0x82, _u16(i + 1) + self._none() + _text(topic_filter) + b"\x01")
                while (got := self._packet())[0] != 0x90:
                    self._take(*got)  # retained messages may come before the acknowledgement
        except BaseException:
            self._incoming.close()
            self._socket.close()
            raise
        self._socket.settimeout(None)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _greet(self, user: tuple[str, str] | None) -> None:
        flags, keep_alive_s = 0x02 if user is None else 0xC2, 0  # None: who listens says nothing
        name = _text(f"test-{uuid4().hex[:12]}")
        self._send(
            0x10,
            _text("MQTT")
            + bytes([self.version, flags])
            + _u16(keep_alive_s)
            + self._none()
            + name
            + b"".join(map(_text, user or ())),
        )
        kind, answer = self._packet()
        if (kind, answer[1]) != (0x20, 0):
            raise ConnectionRefusedError(f"the broker refuses: {answer.hex()}")

    def publish(
        self, topic: str, payload: bytes, content_type: str | None = None, *, retain: bool = False
    ) -> None:
        """Publish with QoS 0; MQTT 3.1.1 has no content type."""
        self._socket.sendall(self._publication(topic, payload, content_type, retain=retain))

    def publish_all(self, messages: Iterable[tuple[str, bytes]]) -> None:
        """Publish topics and payloads as fast as the broker takes them."""
        self._socket.sendall(b"".join(self._publication(*message) for message in messages))

    def _publication(
        self, topic: str, payload: bytes, content_type: str | None = None, *, retain: bool = False
    ) -> bytes:
        properties = self._none()
        if content_type is not None and self.version == 5:
            packed = b"\x03" + _text(content_type)
            properties = _length(len(packed)) + packed
        body = _text(topic) + properties + payload
        return bytes([0x30 | retain]) + _length(len(body)) + body

    def wait_for(self, wanted: Callable[[MqttMessage], bool], since: int = 0) -> MqttMessage:
        """The first message that is wanted, among those from number `since` on, once it has come.

        Raises `AssertionError`, which says what has come instead, if it does not in two minutes.
        """
        deadline = time.monotonic() + PATIENCE_S
        with self._news:
            while True:
                for message in self.heard[since:]:
                    if wanted(message):
                        return message
                left_s = deadline - time.monotonic()
                topics = sorted({m.topic for m in self.heard})
                if left_s <= 0 or self.ended:
                    why = "cut off" if self.ended else "never came"
                    raise AssertionError(f"{why}; heard {len(self.heard)} messages on {topics}")
                self._news.wait(left_s)

    def wait_until_cut_off(self) -> None:
        """Return when the broker has ended the connection; raises `AssertionError` if it stays."""
        self._reader.join(PATIENCE_S)
        if not self.ended:
            raise AssertionError("the connection goes on")

    def on(self, topic: str) -> list[bytes]:
        """The payloads that have come on a topic, in order."""
        with self._news:
            return [m.payload for m in self.heard if m.topic == topic]

    def close(self) -> None:
        """Say goodbye, and end the connection once the broker has: it has read what was published.

        What it still sends is read: a connection that ends with octets unread is reset.
        """
        with suppress(OSError):
            self._has_left = True
            self._send(0xE0, b"")
            self._socket.shutdown(socket.SHUT_WR)
        self._reader.join(PATIENCE_S)
        self._incoming.close()
        self._socket.close()

    def _none(self) -> bytes:
        """No properties, where the version has them."""
        return b"\0" if self.version == 5 else b""

    def _send(self, kind: int, body: bytes) -> None:
        self._socket.sendall(bytes([kind]) + _length(len(body)) + body)

    def _packet(self) -> tuple[int, bytes]:
        kind = self._octets(1)[0]
        length = shift = 0
        while True:
            octet = self._octets(1)[0]
            length |= (octet & 0x7F) << shift
            shift += 7
            if not octet & 0x80:
                return kind, self._octets(length)

    def _octets(self, n: int) -> bytes:
        data: bytes = self._incoming.read(n)
        if len(data) < n:
            raise ConnectionResetError
        return data

    def _read(self) -> None:
        try:
            while True:
                self._take(*self._packet())
        except OSError:
            pass
        finally:
            with self._news:
                self.ended = True
                self._news.notify_all()

    def _take(self, kind: int, body: bytes) -> None:
        if kind & 0xF0 != 0x30:
            return
        topic, rest = _take_text(body)
        if kind & 0x06:
            if not self._has_left:
                self._send(0x40, rest[:2])
            rest = rest[2:]
        properties: dict[str, Any] = {}
        if self.version == 5:
            properties, rest = _take_properties(rest)
        properties |= {"qos": kind >> 1 & 3, "at_s": time.monotonic()}
        message = MqttMessage(topic, rest, bool(kind & 1), **properties)
        with self._news:
            self.heard.append(message)
            self._news.notify_all()


def _length(left: int) -> bytes:
    packed = b""
    while True:
        left, low = divmod(left, 128)
        packed += bytes([low | 0x80 if left else low])
        if not left:
            return packed


def _u16(value: int) -> bytes:
    return struct.pack(">H", value)


def _text(value: str) -> bytes:
    data = value.encode()
    return _u16(len(data)) + data


def _take_text(data: bytes) -> tuple[str, bytes]:
    end = 2 + int.from_bytes(data[:2], "big")
    return data[2:end].decode(), data[end:]


def _take_number(data: bytes) -> tuple[int, bytes]:
    value = shift = 0
    for i, octet in enumerate(data):
        value |= (octet & 0x7F) << shift
        shift += 7
        if not octet & 0x80:
            return value, data[i + 1 :]
    raise AssertionError(data.hex())


def _take_properties(data: bytes) -> tuple[dict[str, Any], bytes]:
    length, data = _take_number(data)
    packed, rest = data[:length], data[length:]
    found: dict[str, Any] = {}
    pairs: dict[str, str] = {}
    while packed:
        which, packed = packed[0], packed[1:]
        if which == 0x02:
            found["expiry_s"], packed = int.from_bytes(packed[:4], "big"), packed[4:]
        elif which == 0x03:
            found["content_type"], packed = _take_text(packed)
        elif which == 0x26:
            name, packed = _take_text(packed)
            pairs[name], packed = _take_text(packed)
        else:
            raise AssertionError(f"property {which:#x} in {data.hex()}")
    return {**found, "user_properties": pairs}, rest

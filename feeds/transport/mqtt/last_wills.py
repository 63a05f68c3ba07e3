"""Last wills of many beside one link: connections that carry nothing, each with a will of its own.

A broker takes one will a connection, and a sensor that dies with its session must be OFFLINE for
whoever listens. Such a connection says CONNECT, and then nothing but pings. It does without gmqtt,
whose client takes ten times as long to make.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Mapping
from functools import partial
from uuid import uuid4

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.user_properties import packed, packed_text
from plotfeed.feeds.transport.mqtt.client import CONNECT_TIMEOUT_S, MqttTransport
from plotfeed.feeds.transport.mqtt.gmqtt_client import KEEP_ALIVE_S, reason_name
from plotfeed.feeds.transport.mqtt.publish_packet import CONTENT_TYPE
from plotfeed.feeds.transport.patience import backoff_s
from plotfeed.proto.varint import varint

log = logging.getLogger(__name__)

AT_ONCE = 10
"""Connections that are made at a time: a broker has a queue for those that come, and others wait
for the loop."""
FIRST_LOOK_S, LOOK_EVERY_S = 0.01, 0.25
"""The latter from one look at what is lost, and to be pinged, to the next."""
PROMPT_KEEP_ALIVE_S = 3
"""A broker takes a connection for lost, and publishes its will, after 1.5 times that."""
PATIENCE_S = 1.0
"""So long a session waits for its wills before it begins without the last of them."""
CONNECT, CONNACK = 0x10, 0x20
CLEAN, WILL, RETAIN, PASSWORD, USERNAME = 0x02, 0x04, 0x20, 0x40, 0x80
PINGREQ, DISCONNECT = b"\xc0\x00", b"\xe0\x00"


class LastWills:
    """A connection for each will, kept up while `run` runs and as long as the link beside it is.

    One that was lost is made again, and then `on_back` is told whose it is, since the broker has
    published its will.
    """

    def __init__(
        self,
        link: MqttTransport,
        wills: Mapping[str, Message],
        on_back: Callable[[str], object],
        *,
        stem: str | None = None,
        prompt: str = "",
    ) -> None:
        """`wills` are retained messages by whose they are; those that join before `run` count.

        With a `stem` of client ids, they are those that another process may have had before, and
        `on_back` is told of the first time too. Then the will that is named by `prompt` is
        published within 1.5 times `PROMPT_KEEP_ALIVE_S` where a machine is gone.
        """
        self.name = f"{link.name}-wills"
        self._link = link
        self._wills = wills
        self._on_back = on_back
        self._stem = stem
        self._prompt = prompt if stem is not None else ""
        self._client_ids: dict[str, str] = {}
        self._up: dict[str, _WillConnection] = {}
        """Those that are up, by whose they are, whoever was pinged last at the end."""
        self._placed = asyncio.Event()
        """All wills have been placed once, or it has been tried."""
        self._complained = False
        self._forgotten = False

    @property
    def placed(self) -> int:
        """How many connections are up, each with its will."""
        return len(self._up)

    async def wait_until_up(self, timeout_s: float | None = None) -> None:
        """Return once all wills are placed, or that has taken long enough; never raises."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(min(timeout_s or PATIENCE_S, PATIENCE_S)):
                await self._placed.wait()

    async def run(self) -> None:
        """Connect, and connect again those that were lost, until cancelled.

        Then say goodbye if the wills are to be forgotten, and else leave them to the broker.
        """
        loop = asyncio.get_running_loop()
        failures, again_s = 0, 0.0
        if self._stem is not None:
            self._client_ids = {whose: f"{self._stem}-{whose}" for whose in self._wills}
        try:
            while True:
                if self._link.is_up and loop.time() >= again_s:
                    if await self._connect_missing():
                        failures = 0
                    else:
                        again_s = loop.time() + backoff_s(failures)
                        failures += 1
                    self._placed.set()
                self._ping_some(loop.time())
                await asyncio.sleep(LOOK_EVERY_S if self._placed.is_set() else FIRST_LOOK_S)
        finally:
            for connection in [*self._up.values()]:
                if self._forgotten:
                    connection.end()
                else:
                    connection.abort()

    def forget(self) -> None:
        """No will shall be published any more when its connection ends."""
        self._forgotten = True

    async def _connect_missing(self) -> bool:
        """Place all wills that are not placed, some at a time; whether that could be done."""
        missing = [whose for whose in self._wills if whose not in self._up]
        for first in range(0, len(missing), AT_ONCE):
            some = missing[first : first + AT_ONCE]
            found = await asyncio.gather(*map(self._place, some))
            why = next((each for each in found if each), "")
            if why:
                if self._link.is_up and not self._complained:
                    self._complained = True
                    log.warning("%s: no last will at %s (%s)", self.name, self._link.address, why)
                return False
        self._complained = False
        return True

    async def _place(self, whose: str) -> str:
        """Connect with that will; why not, if not."""
        address, access = self._link.address, self._link.address.access
        is_back = whose in self._client_ids
        client_id = self._client_ids.setdefault(whose, f"plotfeed-{whose}-{uuid4().hex[:8]}")
        connect = connect_packet(
            client_id,
            self._wills[whose],
            self._link.version,
            access.username,
            access.password,
            keep_alive_s=PROMPT_KEEP_ALIVE_S if whose == self._prompt else KEEP_ALIVE_S,
        )
        loop = asyncio.get_running_loop()
        connection = _WillConnection(connect)
        try:
            async with asyncio.timeout(CONNECT_TIMEOUT_S):
                await loop.create_connection(
                    lambda: connection,
                    address.host,
                    address.port,
                    ssl=access.tls_context() if address.tls else None,
                )
                why = await connection.answer
        except TimeoutError:
            why = "no answer to CONNECT"
        except OSError as error:
            why = error.strerror or str(error)
        except BaseException:
            connection.abort()
            raise
        if why:
            connection.abort()
            return why
        self._up[whose] = connection
        connection.lost.add_done_callback(partial(self._lost, whose, connection))
        if is_back:
            self._on_back(whose)
        return ""

    def _lost(self, whose: str, connection: _WillConnection, _lost: object) -> None:
        if self._up.get(whose) is connection:
            del self._up[whose]

    def _ping_some(self, now_s: float) -> None:
        """Keep alive those whose turn it is: all of them, by and by, in half the time that counts.

        One that has said nothing for as long as twice that time is cut.
        """
        if self._prompt in self._up:
            self._up[self._prompt].ping()
        some = -(-len(self._up) * LOOK_EVERY_S // (KEEP_ALIVE_S / 2))
        for whose in [*self._up][: int(some)]:
            connection = self._up.pop(whose)
            if now_s - connection.heard_s > 2 * KEEP_ALIVE_S:
                connection.abort()
            else:
                self._up[whose] = connection
                connection.ping()


class _WillConnection(asyncio.Protocol):
    """What is heard on it is that the broker has accepted it, and that it lives."""

    def __init__(self, connect: bytes) -> None:
        loop = asyncio.get_running_loop()
        self.answer: asyncio.Future[str] = loop.create_future()
        """Why the broker refuses; empty if it accepts."""
        self.lost: asyncio.Future[None] = loop.create_future()
        self.heard_s = loop.time()
        self._loop = loop
        self._connect = connect
        self._answer = b""
        self._transport: asyncio.WriteTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Say who it is, and its will."""
        assert isinstance(transport, asyncio.WriteTransport)  # noqa: S101 - of a stream  # nosec B101
        self._transport = transport
        transport.write(self._connect)

    def data_received(self, data: bytes) -> None:
        """Read the answer to CONNECT; what follows says no more than that somebody is there."""
        self.heard_s = self._loop.time()
        if self.answer.done():
            return
        self._answer += data[:8]
        after_length = next((i for i, o in enumerate(self._answer[1:], 2) if o < 128), 8)
        if self._answer[0] != CONNACK:
            self._answered("it does not speak MQTT")
        elif len(self._answer) > after_length + 1:
            code = self._answer[after_length + 1]
            self._answered(f"it refuses: {reason_name(code)}" if code else "")

    def connection_lost(self, error: Exception | None) -> None:
        """Nobody is there any more."""
        hung_up = "it hung up without an answer: it may have as many connections as it takes"
        was_reset = error is None or isinstance(error, ConnectionResetError)
        self._answered(hung_up if was_reset else str(error))
        if not self.lost.done():
            self.lost.set_result(None)

    def ping(self) -> None:
        """Say that it lives."""
        self._write(PINGREQ)

    def end(self) -> None:
        """Say goodbye, so that the will is forgotten."""
        self._write(DISCONNECT)
        if self._transport is not None:
            self._transport.close()

    def abort(self) -> None:
        """Cut it, if there is any."""
        if self._transport is not None:
            self._transport.abort()

    def _answered(self, why: str) -> None:
        if not self.answer.done():
            self.answer.set_result(why)

    def _write(self, octets: bytes) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(octets)


def connect_packet(
    client_id: str,
    will: Message,
    version: int,
    username: str | None,
    password: str | None,
    *,
    keep_alive_s: int = KEEP_ALIVE_S,
) -> bytes:
    """A CONNECT that begins a clean session with that will, which is retained.

    MQTT 3.1.1, section 3.1, and MQTT 5.0, the same.
    """
    flags = CLEAN | WILL | will.qos << 3 | (RETAIN if will.retain else 0)
    flags |= (USERNAME if username is not None else 0) | (PASSWORD if password is not None else 0)
    of_will = CONTENT_TYPE + packed_text(will.content_type) + packed(will.properties)
    parts = [
        packed_text("MQTT"),
        bytes((version, flags)),
        keep_alive_s.to_bytes(2, "big"),
        varint(0) if version >= 5 else b"",  # its own properties
        packed_text(client_id),
        varint(len(of_will)) + of_will if version >= 5 else b"",
        packed_text(will.topic),
        len(will.payload).to_bytes(2, "big") + will.payload,
        *(packed_text(text) for text in (username, password) if text is not None),
    ]
    rest = b"".join(parts)
    return bytes((CONNECT,)) + varint(len(rest)) + rest

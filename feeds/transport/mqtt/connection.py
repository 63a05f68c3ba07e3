"""One connection to an MQTT broker: it lives once, and knows whether it is up and has room.

What has not arrived when it is over is handed back.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from plotfeed.feeds.messages.message import Message, OnReceived, ReceivedMessage
from plotfeed.feeds.messages.outgoing import Outgoing
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.gmqtt_client import (
    CONNECT_ERRORS,
    GmqttClient,
    reason_name,
)
from plotfeed.feeds.transport.mqtt.no_connection import (
    MqttError,
    failure,
    hung_up,
    no_answer,
    speaks_tls,
)
from plotfeed.feeds.transport.mqtt.own_echo import OwnEcho
from plotfeed.feeds.transport.mqtt.publish_packet import pack, publish_packet
from plotfeed.feeds.transport.mqtt.qos1_window import Qos1Window
from plotfeed.feeds.transport.mqtt.send_queue import QueueCounts, SocketBuffer

log = logging.getLogger(__name__)

CLOSE_S = 1.0
READ_OCTETS = 8_192
"""At a time, of what a session takes in: a millisecond's work if it is small messages."""
TOGETHER_OCTETS = 1 << 16
"""Of QoS 1: beyond, what is to leave in one write leaves at once."""
HEADER_OCTETS = 1024
"""At most, of what a packet holds besides its payload."""
MOST_COMPLAINTS = 10
"""Topics of a connection on which a broker refuses messages, and that are named."""
REFUSED = 128
"""The codes of SUBACK and PUBACK from here on."""

OnMessage = Callable[[str, bytes, str | None], None]
"""Called with topic, payload and content type."""


class MqttConnection:
    """Made, opened, closed; never opened again."""

    def __init__(
        self,
        address: BrokerAddress,
        version: int,
        client_id: str,
        *,
        counts: QueueCounts,
        on_room: Callable[[], None],
        on_message: OnMessage | None = None,
        on_received: OnReceived | None = None,
        echo: OwnEcho | None = None,
    ) -> None:
        """`on_room` is called whenever there may be room again."""
        self.lost = asyncio.Event()
        self.good_bye = ""
        """Why the broker says that it ends the connection, if it does."""
        self.version = version
        self._address = address
        self._on_message = on_message
        self._on_received = on_received
        self._echo = echo
        self._counts = counts
        self._on_room = on_room
        self._window = Qos1Window(counts, on_room)
        self._packets: list[bytes] = []
        """Of QoS 1, which are written next."""
        self._packed_octets = 0
        self._buffer: SocketBuffer
        """There is one as soon as it is open."""
        self._subscriptions: dict[int, str] = {}
        """Filters that the broker has not answered for, by the number of their subscription."""
        self._refused_topics: set[str] = set()
        self._largest_payload: int | None = None
        self._client = GmqttClient(
            client_id,
            version,
            username=address.access.username,
            password=address.access.password,
            on_accepted=self._accepted,
            on_granted=self._subscribed,
            on_message=self._received,
            on_acknowledged=self._acknowledged,
            on_ended=self._ended,
        )

    @property
    def unacknowledged(self) -> int:
        """Messages of QoS 1 of which it is not known that they have arrived."""
        return self._window.unacknowledged

    async def open(self, timeout_s: float) -> None:
        """Connect, and have the broker's consent; raises `MqttError`."""
        try:
            await self._open(timeout_s)
        except BaseException:
            self.abort()
            raise
        self._buffer = SocketBuffer(self._client.transport, self._on_room)
        self._client.watch_buffer(self._buffer.hold, self._buffer.release)
        if self._on_message is not None:
            self._client.read_at_most(READ_OCTETS)

    def subscribe(self, topic_filter: str) -> None:
        """Have what comes there."""
        if self.lost.is_set():
            return
        as_published = self._on_received is not None and self.version >= 5
        number = self._client.subscribe(topic_filter, as_published=as_published)
        self._subscriptions[number] = topic_filter

    def unsubscribe(self, topic: str) -> None:
        """Have what comes on that topic no more."""
        if not self.lost.is_set():
            self._client.unsubscribe(topic)

    def has_room(self, qos: int) -> bool:
        """Whether a message of that QoS may be sent now."""
        if not self._buffer.has_room or self.lost.is_set():
            return False
        return qos == 0 or self._window.has_room

    def takes(self, message: Message) -> bool:
        """Whether it is not larger than what the broker says that it takes."""
        return self._largest_payload is None or len(message.payload) <= self._largest_payload

    def send(self, outgoing: Sequence[Outgoing]) -> bool:
        """Hand messages of QoS 0, at least one, to the socket, where there is room.

        In one go, since a system call costs more than a message. True if it has taken all; else
        each is settled when it has left the socket's buffer.
        """
        version = self.version
        packets = [
            one.message.packets.get(version) or publish_packet(one.message, version)
            for one in outgoing
        ]
        octets = b"".join(packets)
        self._client.write(octets)
        if self._echo is not None and self._echo.wants:
            self._echo.published([one.message for one in outgoing])
        if self._buffer.given(len(octets)):
            return True
        left = len(octets)
        for packet, one in zip(packets, outgoing, strict=True):
            left -= len(packet)
            if not one.sent_utc_ns:
                one.leave()
            self._buffer.keep(one, left)
        return False

    def prepare(self, messages: Sequence[Message]) -> None:
        """Make the packets of what will be sent soon."""
        pack(messages, self.version)

    def send_until_acknowledged(self, one: Outgoing) -> None:
        """Send a message of QoS 1, and keep it until the broker has answered.

        Small ones of one turn of the loop leave in one write at its end.
        """
        one.leave()
        number = self._window.put(one)
        if not self._packets:
            asyncio.get_running_loop().call_soon(self._write_packets)
        packet = publish_packet(one.message, self.version, number=number)
        self._packets.append(packet)
        if self._echo is not None and self._echo.wants:
            self._echo.published([one.message])
        self._packed_octets += len(packet)
        if self._packed_octets > TOGETHER_OCTETS:
            self._write_packets()

    def is_idle(self) -> bool:
        """Whether the socket has taken everything, and QoS 1 is acknowledged."""
        return not self.unacknowledged and not self._buffer.octets

    def give_up(self) -> list[Outgoing]:
        """Drop what the socket has not taken, and hand back what is unacknowledged."""
        self._counts.dropped += self._buffer.give_up(self._counts.destination)
        return self._window.take_all()

    def end_if_stuck(self) -> None:
        """Cut a connection whose socket takes nothing any more; to be called now and then."""
        if self.lost.is_set():
            return
        if self._buffer.is_stuck():
            self.good_bye = "it takes nothing any more"
            self.abort()
        elif self._buffer.octets:
            self._client.note_life(self._buffer.moved_s)

    async def close(self) -> None:
        """Say goodbye, if there is still anybody."""
        try:
            with contextlib.suppress(Exception):
                self._write_packets()
                async with asyncio.timeout(CLOSE_S):
                    await self._client.disconnect()
        finally:
            self.abort()

    def abort(self) -> None:
        """Cut it, if there is any, and keep nothing of it."""
        self._client.abort()

    async def _open(self, timeout_s: float) -> None:
        address = self._address
        greeting = asyncio.ensure_future(
            self._client.connect(
                address.host, address.port, address.access.tls_context() if address.tls else None
            )
        )
        lost = asyncio.ensure_future(self.lost.wait())
        try:
            await asyncio.wait(
                {greeting, lost}, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED
            )
            if greeting.done():
                greeting.result()
            if lost.done():
                raise await self._hung_up()
            if not greeting.done():
                raise no_answer()
        except ConnectionResetError:
            raise await self._hung_up() from None
        except CONNECT_ERRORS as error:
            raise failure(error) from None
        finally:
            for task in (greeting, lost):
                task.cancel()
            await asyncio.gather(greeting, lost, return_exceptions=True)

    async def _hung_up(self) -> MqttError:
        wants_tls = await speaks_tls(self._address)
        broke = self._client.what_broke()
        return hung_up(self._address, self.version, broke, wants_tls=wants_tls)

    def _write_packets(self) -> None:
        octets = b"".join(self._packets)
        self._packets.clear()
        self._packed_octets = 0
        if octets and not self.lost.is_set():
            self._client.write(octets)
            self._buffer.given(len(octets))

    def _accepted(self, answer: Mapping[str, Any]) -> None:
        for largest in answer.get("maximum_packet_size", ()):
            self._largest_payload = max(0, largest - HEADER_OCTETS)
        for window in answer.get("receive_maximum", ()):
            self._window.limit = min(self._window.limit, window)

    def _ended(self, packet: bytes) -> None:
        if packet and self.version >= 5:
            self.good_bye = reason_name(packet[0])
        self.lost.set()

    def _acknowledged(self, packet: bytes) -> None:
        """A PUBACK; those of MQTT 5 may have a reason code."""
        number = int.from_bytes(packet[:2], "big")
        if len(packet) <= 2 or packet[2] < REFUSED:
            self._window.acknowledge(number)
        else:
            topic = self._window.refuse(number)
            if topic not in self._refused_topics and len(self._refused_topics) < MOST_COMPLAINTS:
                self._refused_topics.add(topic)
                reason = reason_name(packet[2])
                log.warning("%s refuses what is published on %s: %s", self._address, topic, reason)

    def _subscribed(self, number: int, granted: Sequence[int]) -> None:
        topic_filter = self._subscriptions.pop(number, "")
        for code in granted:
            refusal = None
            if code >= REFUSED:
                refusal = "refused" if code == REFUSED else reason_name(code)
            if self._echo is not None and topic_filter == self._echo.topic:
                self._echo.answered(refusal)
            elif refusal is not None:
                log.warning(
                    "%s does not grant the subscription to %s (%s): what comes there is not heard",
                    self._address,
                    topic_filter,
                    refusal,
                )

    def _received(
        self, topic: str, payload: bytes, qos: int, retain: bool, properties: Mapping[str, Any]
    ) -> None:
        if self._echo is not None and self._echo.heard(topic, payload):
            return
        content_type = properties["content_type"][0] if "content_type" in properties else None
        if self._on_message is not None:
            self._on_message(topic, payload, content_type)
        if self._on_received is not None:
            self._on_received(
                ReceivedMessage(
                    topic=topic,
                    payload=payload,
                    content_type=content_type,
                    properties=tuple(properties.get("user_property", ())),
                    retain=retain,
                    qos=qos,
                )
            )

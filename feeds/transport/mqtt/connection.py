"""One connection to an MQTT broker, by gmqtt; nothing else in plotfeed knows that library.

gmqtt reconnects by itself, but drops what is published meanwhile without a word and forgets
subscriptions. So here a connection lives once, knows whether it is up and whether there is room,
and hands back what has not arrived.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gmqtt

from plotfeed.feeds.delivery.delivery import Delivery
from plotfeed.feeds.messages.message import Message, OnHeard, ReceivedMessage
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.mqtt_errors import failure, hung_up, no_answer, reason_name
from plotfeed.feeds.transport.mqtt.publish_packet import publish_packet
from plotfeed.feeds.transport.mqtt.qos1_window import Qos1Window
from plotfeed.feeds.transport.mqtt.send_queue import QueueCounts
from plotfeed.feeds.transport.mqtt.socket_buffer import SocketBuffer

log = logging.getLogger(__name__)
logging.getLogger("gmqtt").setLevel(logging.CRITICAL + 1)  # it logs tracebacks; we say it in a line

KEEP_ALIVE_S = 15
"""A broker that has said nothing for twice as long is gone."""
CLOSE_S = 1.0
MESSAGE_EXPIRY_S = 60
HEADER_OCTETS = 1024
"""At most, of what a packet holds besides its payload."""
REFUSED = 128
"""The codes of SUBACK and PUBACK from here on."""
PUBACK = 0x40
GMQTTS_IDS = 65_536
NEVER_RECONNECT = {"reconnect_retries": -2, "reconnect_delay": 0}

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
        will: Message | None = None,
        on_message: OnMessage | None = None,
        on_heard: OnHeard | None = None,
    ) -> None:
        """`on_room` is called whenever there may be room again."""
        self.lost = asyncio.Event()
        self.good_bye = ""
        """Why the broker says that it ends the connection, if it does."""
        self.version = version
        self._address = address
        self._on_message = on_message
        self._on_heard = on_heard
        self._counts = counts
        self._on_room = on_room
        self._in_flight = Qos1Window(counts, on_room)
        self._unsent: SocketBuffer
        """There is one as soon as it is open."""
        self._complained = False
        self._largest_payload: int | None = None
        self._client = gmqtt.Client(
            client_id,
            clean_session=True,
            will_message=will and self._packed(will),
            persistent_storage=self._in_flight,
        )
        self._client.set_config(NEVER_RECONNECT)
        if address.access.username is not None:
            self._client.set_auth_credentials(address.access.username, address.access.password)
        self._client.on_connect = self._accepted
        self._client.on_disconnect = self._ended
        self._client.on_subscribe = self._subscribed
        self._client.on_message = self._received
        # gmqtt takes a PUBACK that refuses for one that accepts.
        self._client._package_handler._handler_cache[PUBACK] = self._answered

    @property
    def unacknowledged(self) -> int:
        """Messages of QoS 1 of which it is not known that they have arrived."""
        return self._in_flight.unacknowledged

    @property
    def unsent_octets(self) -> int:
        """What the socket has not taken yet."""
        return self._unsent.octets

    async def open(self, timeout_s: float) -> None:
        """Connect, and have the broker's consent; raises `MqttError`."""
        try:
            await self._open(timeout_s)
        except BaseException:
            self.abort()
            raise
        wire = self._client._connection
        self._unsent = SocketBuffer(wire._transport, wire._protocol, self._on_room)

    def subscribe(self, topic_filter: str) -> None:
        """Hear what comes there."""
        as_published = self._on_heard is not None and self.version >= 5
        self._client.subscribe(topic_filter, qos=1, retain_as_published=as_published)

    def has_room(self, qos: int) -> bool:
        """Whether a message of that QoS may be sent now."""
        if not self._unsent.has_room or self.lost.is_set():
            return False
        return qos == 0 or self._in_flight.has_room

    def takes(self, message: Message) -> bool:
        """Whether it is not larger than what the broker says that it takes."""
        return self._largest_payload is None or len(message.payload) <= self._largest_payload

    def send(self, *deliveries: Delivery) -> None:
        """Hand messages of QoS 0 to the socket, where there is room.

        In one go, since a system call costs more than a message.
        """
        packets = []
        for delivery in deliveries:
            delivery.leave()
            message = delivery.message
            packets.append(message.packets.get(self.version) or self._packet(message))
        self._client._connection.send_package(b"".join(packets))
        for delivery in deliveries:
            if self._unsent.given(len(delivery.message.payload)):
                delivery.settle(delivered=True)
            else:
                self._unsent.keep(delivery)

    def prepare(self, messages: Sequence[Message]) -> None:
        """Make the packets of what will be sent soon."""
        for message in messages:
            if not message.qos:
                message.packets[self.version] = self._packet(message)

    def _packet(self, message: Message) -> bytes:
        return publish_packet(message, self.version, MESSAGE_EXPIRY_S)

    def send_until_acknowledged(self, delivery: Delivery) -> None:
        """Hand a message of QoS 1 to the socket, and keep it until the broker has answered."""
        message = delivery.message
        delivery.leave()
        self._in_flight.sending = delivery
        self._client.publish(self._packed(message))
        self._in_flight.sending = None
        self._unsent.given(len(message.payload))

    def is_idle(self) -> bool:
        """Whether the socket has taken everything, and QoS 1 is acknowledged."""
        return not self.unacknowledged and not self.unsent_octets

    def give_up(self) -> list[Delivery]:
        """It is over: drop what the socket has not taken, hand back what is unacknowledged."""
        self._counts.dropped += self._unsent.give_up()
        return self._in_flight.take_all()

    def end_if_stuck(self) -> None:
        """Cut a connection whose socket takes nothing any more; to be called now and then."""
        if self.lost.is_set():
            return
        if self._unsent.is_stuck():
            self.good_bye = "it takes nothing any more"
            self.abort()
        elif self._unsent.octets:  # else gmqtt takes a slow network for a dead one
            wire = self._client._connection
            wire._last_data_in = max(wire._last_data_in, self._unsent.moved_s)

    async def close(self) -> None:
        """Say goodbye, if there is still anybody."""
        try:
            with contextlib.suppress(Exception):
                async with asyncio.timeout(CLOSE_S):
                    await self._client.disconnect()
        finally:
            self.abort()

    def abort(self) -> None:
        """Cut it, if there is any, and keep nothing of it."""
        wire = self._client._connection
        if wire is not None:
            wire._keep_connection_callback.cancel()
            wire._transport.abort()

    async def _open(self, timeout_s: float) -> None:
        address = self._address
        greeting = asyncio.ensure_future(
            self._client.connect(
                address.host,
                address.port,
                ssl=address.access.tls_context() if address.tls else False,
                version=self.version,
                keepalive=KEEP_ALIVE_S,
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
                raise hung_up(address, self.version, self._what_broke())
            if not greeting.done():
                raise no_answer()
        except (OSError, ValueError, gmqtt.mqtt.handler.MQTTError) as error:
            raise failure(error) from None
        finally:
            for task in (greeting, lost):
                task.cancel()
            await asyncio.gather(greeting, lost, return_exceptions=True)

    def _packed(self, message: Message) -> gmqtt.Message:
        properties: Mapping[str, Any] = self._properties(message) if self.version >= 5 else {}
        return gmqtt.Message(
            message.topic, message.payload, qos=message.qos, retain=message.retain, **properties
        )

    def _properties(self, message: Message) -> Mapping[str, Any]:
        properties: dict[str, Any] = {"content_type": message.content_type}
        if message.properties:
            properties["user_property"] = list(message.properties)
        if not message.retain:
            properties["message_expiry_interval"] = MESSAGE_EXPIRY_S
        return properties

    def _what_broke(self) -> BaseException | None:
        """The error that ended the connection; gmqtt tells it to its log alone."""
        closed: asyncio.Future[None] = self._client._connection._protocol.closed
        return closed.exception() if closed.done() and not closed.cancelled() else None

    def _accepted(self, _client: object, _flags: int, _code: int, answer: dict[str, Any]) -> None:
        for largest in answer.get("maximum_packet_size", ()):
            self._largest_payload = max(0, largest - HEADER_OCTETS)
        for window in answer.get("receive_maximum", ()):
            self._in_flight.window = min(self._in_flight.window, window)
        # Else gmqtt counts subscriptions too, and raises an error where we wait.
        self._client._package_handler.id_generator._max = GMQTTS_IDS

    def _ended(self, _client: object, packet: bytes, *_: object) -> None:
        if packet and self.version >= 5:
            self.good_bye = reason_name(packet[0])
        self.lost.set()

    def _answered(self, command: int, packet: bytes) -> None:
        """A PUBACK; those of MQTT 5 may have a reason code."""
        if len(packet) > 2 and packet[2] >= REFUSED:
            self._in_flight.refuse(int.from_bytes(packet[:2], "big"))
            if not self._complained:
                self._complained = True
                reason = reason_name(packet[2])
                log.warning("%s refuses what is published: %s", self._address, reason)
        self._client._package_handler._handle_puback_packet(command, packet)

    def _subscribed(
        self, _client: object, _id: int, granted: Sequence[int], _properties: object
    ) -> None:
        if any(code >= REFUSED for code in granted):
            log.warning("%s does not grant a subscription", self._address)

    def _received(
        self, _client: object, topic: str, payload: bytes, qos: int, properties: dict[str, Any]
    ) -> int:
        content_type = (properties.get("content_type") or [None])[0]
        if self._on_message is not None:
            self._on_message(topic, bytes(payload), content_type)
        if self._on_heard is not None:
            heard = ReceivedMessage(
                topic=topic,
                payload=bytes(payload),
                content_type=content_type,
                properties=tuple(properties.get("user_property", ())),
                retain=bool(properties.get("retain")),
                qos=qos,
            )
            self._on_heard(heard)
        return 0

"""One connection to an MQTT broker, by gmqtt; nothing else in plotfeed knows that library.

gmqtt reconnects by itself, but drops what is published meanwhile without a word and forgets
subscriptions. So here a connection lives once, and knows whether it is up.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gmqtt

from plotfeed.feeds.broker_address import BrokerAddress
from plotfeed.feeds.in_flight import InFlight
from plotfeed.feeds.message import Message
from plotfeed.feeds.mqtt_failure import failure, hung_up, no_answer, reason_name

log = logging.getLogger(__name__)
logging.getLogger("gmqtt").setLevel(logging.CRITICAL + 1)  # it logs tracebacks; we say it in a line

KEEP_ALIVE_S = 30
MAX_UNSENT_OCTETS = 8 << 20
"""What may wait in the socket for a broker that has stalled; more is not taken."""
MESSAGE_EXPIRY_S = 60
HEADER_OCTETS = 1024
"""At most, of what a packet holds besides its payload."""
REFUSED = 128
"""SUBACK's codes from here on."""
NEVER_RECONNECT = {"reconnect_retries": -2, "reconnect_delay": 0}

OnMessage = Callable[[str, bytes, str | None], None]
"""Called with topic, payload and content type."""


class Connection:
    """Made, opened, closed; never opened again."""

    def __init__(
        self,
        address: BrokerAddress,
        version: int,
        client_id: str,
        *,
        will: Message | None = None,
        on_message: OnMessage | None = None,
    ) -> None:
        self.lost = asyncio.Event()
        self.good_bye = ""
        """Why the broker says that it ends the connection, if it does."""
        self.version = version
        self._address = address
        self._on_message = on_message
        self._in_flight = InFlight(self._send)
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

    @property
    def unacknowledged(self) -> int:
        """Messages of QoS 1 of which it is not known that they have arrived."""
        return self._in_flight.unacknowledged

    async def open(self, timeout_s: float) -> None:
        """Connect, and have the broker's consent; raises `MqttError`."""
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

    def subscribe(self, topic_filter: str) -> None:
        """Hear what comes there."""
        self._client.subscribe(topic_filter, qos=1)

    def publish(self, message: Message) -> bool:
        """Hand a message to the socket; False if that has stalled, or it is too large."""
        if self._unsent_octets() > MAX_UNSENT_OCTETS:
            return False
        if self._largest_payload is not None and len(message.payload) > self._largest_payload:
            return False
        if message.qos:
            return self._in_flight.send(message)
        self._send(message)
        return True

    async def drain(self, timeout_s: float) -> None:
        """Wait until the socket has taken what was published, or the time is up.

        What was published with QoS 1 has been acknowledged then.
        """
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        while not self.lost.is_set() and (self.unacknowledged or self._unsent_octets()):
            if loop.time() > deadline:
                return
            await asyncio.sleep(0.001)

    async def close(self) -> None:
        """Say goodbye, if there is still anybody."""
        with contextlib.suppress(Exception):
            async with asyncio.timeout(1.0):
                await self._client.disconnect()

    def _send(self, message: Message) -> None:
        """Raises `OverflowError` if as much is unacknowledged as the broker allows."""
        self._client.publish(self._packed(message))

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

    def _unsent_octets(self) -> int:
        """What the socket has not taken yet; gmqtt has no public way to ask."""
        return int(self._client._connection._transport.get_write_buffer_size())

    def _what_broke(self) -> BaseException | None:
        """The error that ended the connection; gmqtt tells it to its log alone."""
        closed: asyncio.Future[None] = self._client._connection._protocol.closed
        return closed.exception() if closed.done() and not closed.cancelled() else None

    def _accepted(self, _client: object, _flags: int, _code: int, answer: dict[str, Any]) -> None:
        for largest in answer.get("maximum_packet_size", ()):
            self._largest_payload = max(0, largest - HEADER_OCTETS)
        for window in answer.get("receive_maximum", ()):
            self._in_flight.window = min(self._in_flight.window, window)

    def _ended(self, _client: object, packet: bytes, *_: object) -> None:
        if packet and self.version >= 5:
            self.good_bye = reason_name(packet[0])
        self.lost.set()

    def _subscribed(
        self, _client: object, _id: int, granted: Sequence[int], _properties: object
    ) -> None:
        if any(code >= REFUSED for code in granted):
            log.warning("%s does not grant a subscription", self._address)

    def _received(
        self, _client: object, topic: str, payload: bytes, _qos: int, properties: dict[str, Any]
    ) -> int:
        if self._on_message is not None:
            content_types = properties.get("content_type") or [None]
            self._on_message(topic, bytes(payload), content_types[0])
        return 0

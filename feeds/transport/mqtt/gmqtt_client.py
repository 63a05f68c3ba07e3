"""The one file that knows gmqtt: its client as plotfeed uses it, and all of it that is private.

gmqtt reconnects by itself, but drops what is published meanwhile without a word, looks at no
buffer, takes a refusal for an acknowledgement and tells what broke a connection to its log alone.
So more of it is used here than it offers; `PRIVATE` lists that, and a test holds each entry.
PUBLISH packets of QoS 0, the only ones of which there are thousands a second, it does not make:
`publish_packet` does.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping, Sequence
from ssl import SSLContext
from typing import Any

import gmqtt
from gmqtt.mqtt.handler import MQTTConnectError, MQTTError

logging.getLogger("gmqtt").setLevel(logging.CRITICAL + 1)  # it logs tracebacks; we say it in a line

PRIVATE = {
    "Client._connection": "the connection that there is, None before any",
    "Client._package_handler": "what it does with each packet that comes",
    "MqttPackageHandler._handler_cache": "by the first octet of a packet, who is given it",
    "MqttPackageHandler._handle_publish_packet": "what it would do with a PUBLISH itself",
    "MqttPackageHandler._parse_properties": "properties of MQTT 5 from octets, and what follows",
    "MqttPackageHandler.id_generator._max": "how many packets may have an id at a time",
    "MQTTConnection.send_package": "writes octets that we have packed",
    "MQTTConnection._transport": "the socket's transport: its buffer, and its end",
    "MQTTConnection._protocol": "the transport's protocol, which is told of a full buffer",
    "MQTTConnection._protocol.closed": "a future with the error that ended the connection",
    "MQTTConnection._last_data_in": "monotonic time at which the broker last gave a sign of life",
    "MQTTConnection._keep_connection_callback": "its timer, which would outlive the connection",
    "MQTTConnectError._code": "CONNACK's reason code",
    "MQTTConnectError.__messages__": "words for reason codes",
}
"""What of gmqtt is used although it is not its public interface, and what that is."""

KEEP_ALIVE_S = 15
"""A broker that has said nothing for twice as long is gone."""
PUBLISH, PUBACK = 0x30, 0x40
ACKNOWLEDGED = b"\x40\x02"
"""A PUBACK, but for the id."""
MORE = 0x80
"""Of an octet of a length that is not its last."""
MOST_KNOWN = 256
_NO_PROPERTIES: Mapping[str, Any] = {}
ALL_IDS = 65_536
NEVER_RECONNECT = {"reconnect_retries": -2, "reconnect_delay": 0}
CONNECT_ERRORS = (OSError, ValueError, MQTTError)
"""What `GmqttClient.connect` may raise."""


class GmqttClient:
    """A client of gmqtt that connects once; what it is told is passed on to `on_` callbacks."""

    def __init__(
        self,
        client_id: str,
        version: int,
        *,
        username: str | None,
        password: str | None,
        on_accepted: Callable[[Mapping[str, Any]], object],
        on_granted: Callable[[int, Sequence[int]], object],
        on_message: Callable[[str, bytes, int, bool, Mapping[str, Any]], object],
        on_acknowledged: Callable[[bytes], object],
        on_ended: Callable[[bytes], object],
    ) -> None:
        """`on_accepted` and `on_message` are given properties of MQTT 5, the latter last of all.

        Before them, of a message: topic, payload, QoS, and whether it is retained.
        `on_granted` is given the number of a subscription, and the codes for its filters.
        `on_acknowledged` is given a PUBACK, `on_ended` a DISCONNECT or nothing.
        """
        self._version = version
        self._client = gmqtt.Client(
            client_id,
            clean_session=True,
        )
        self._client.set_config(NEVER_RECONNECT)
        if username is not None:
            self._client.set_auth_credentials(username, password)
        handler = self._client._package_handler

        def accepted(_client: object, _flags: int, _code: int, answer: Mapping[str, Any]) -> None:
            # Else gmqtt counts subscriptions too, and raises an error where we wait.
            handler.id_generator._max = ALL_IDS
            on_accepted(answer)

        def received(
            _client: object, topic: str, payload: bytes, qos: int, properties: Mapping[str, Any]
        ) -> int:
            on_message(topic, bytes(payload), qos, bool(properties["retain"]), properties)
            return 0

        self._client.on_connect = accepted
        self._client.on_disconnect = lambda _client, packet, *_: on_ended(packet or b"")
        self._client.on_subscribe = lambda _client, number, granted, _: on_granted(number, granted)
        self._client.on_message = received
        # gmqtt takes a PUBACK that refuses for one that accepts, and knows nothing of our ids.
        handler._handler_cache[PUBACK] = lambda _command, packet: on_acknowledged(packet)
        handler._handler_cache[PUBLISH] = _Publications(self._client, version, on_message)

    async def connect(self, host: str, port: int, tls: SSLContext | None) -> None:
        """Connect, and have the broker's consent; raises `CONNECT_ERRORS`."""
        await self._client.connect(
            host, port, ssl=tls or False, version=self._version, keepalive=KEEP_ALIVE_S
        )

    def subscribe(self, topic_filter: str, *, as_published: bool) -> int:
        """Have what comes there; `as_published` says that retained messages are marked.

        The number by which the answer names the subscription.
        """
        number: int = self._client.subscribe(topic_filter, qos=1, retain_as_published=as_published)
        return number

    def unsubscribe(self, topic: str) -> None:
        """Have what comes on that topic no more."""
        self._client.unsubscribe(topic)

    def write(self, octets: bytes) -> None:
        """Send packets that are packed."""
        self._client._connection.send_package(octets)

    @property
    def transport(self) -> Any:
        """The socket's transport, of asyncio."""
        return self._client._connection._transport

    def watch_buffer(self, pause: Callable[[], None], resume: Callable[[], None]) -> None:
        """Be told when the socket does not take everything at once, and when it has."""
        protocol = self._client._connection._protocol
        protocol.pause_writing, protocol.resume_writing = pause, resume
        self.transport.set_write_buffer_limits(high=1, low=0)  # TLS takes 0 for always full

    def read_at_most(self, octets: int) -> None:
        """Have the socket read no more at a time, so that others have their turn in the loop."""
        self.transport.max_size = octets  # of asyncio: what it passes to recv; TLS has its own

    def note_life(self, monotonic_s: float) -> None:
        """The broker gave a sign of life then; else gmqtt takes a slow network for a dead one."""
        connection = self._client._connection
        connection._last_data_in = max(connection._last_data_in, monotonic_s)

    def what_broke(self) -> BaseException | None:
        """The error that ended the connection."""
        if self._client._connection is None:
            return None
        closed: asyncio.Future[None] = self._client._connection._protocol.closed
        return closed.exception() if closed.done() and not closed.cancelled() else None

    async def disconnect(self) -> None:
        """Say goodbye."""
        await self._client.disconnect()

    def abort(self) -> None:
        """Cut the connection, if there is any, and keep nothing of it."""
        connection = self._client._connection
        if connection is not None:
            connection._keep_connection_callback.cancel()
            connection._transport.abort()


class _Publications:
    """Takes what comes: as gmqtt does, but thousands a second.

    What few messages have, gmqtt reads. Those of QoS 1 that come together are acknowledged so.
    """

    def __init__(
        self,
        client: gmqtt.Client,
        version: int,
        on_message: Callable[[str, bytes, int, bool, Mapping[str, Any]], object],
    ) -> None:
        self._client = client
        self._by_gmqtt = client._package_handler._handle_publish_packet
        self._read = client._package_handler._parse_properties
        self._on_message = on_message
        self._has_properties = version >= 5
        self._known: dict[bytes, Mapping[str, Any]] = {}
        """Properties by their octets: mostly those of the message before."""
        self._acknowledgements: list[bytes] = []

    def __call__(self, command: int, packet: bytes) -> None:
        """A PUBLISH, but for its length: its first octet, and what follows; MQTT 5.0, 3.3."""
        qos, place = command >> 1 & 3, 2 + (packet[0] << 8 | packet[1])
        topic = packet[2:place]
        properties: Mapping[str, Any] | None = _NO_PROPERTIES
        end = place = place + 2 if qos else place
        if self._has_properties:
            end = place + 1 + packet[place]
            if packet[place] >= MORE:  # iotcore cuts us off where gmqtt acknowledges it
                end = _end_of_long(packet, place)
            octets = packet[place:end]
            properties = self._known.get(octets)
            if properties is None and end <= len(packet):
                properties = self._learnt(octets)
        if properties is None or not topic or qos > 1 or end > len(packet):
            self._by_gmqtt(command, packet)
            return
        try:
            name = topic.decode()
        except UnicodeDecodeError:
            self._by_gmqtt(command, packet)
            return
        if qos:
            if not self._acknowledgements:
                asyncio.get_running_loop().call_soon(self._acknowledge)
            self._acknowledgements.append(ACKNOWLEDGED + packet[place - 2 : place])
        self._on_message(name, packet[end:], qos, bool(command & 1), properties)

    def _learnt(self, octets: bytes) -> Mapping[str, Any] | None:
        """Properties, for the next time too; None where they are no ordinary ones."""
        properties, _ = self._read(octets)
        if properties is None or "topic_alias" in properties:
            return None
        if len(self._known) >= MOST_KNOWN:
            self._known.clear()
        self._known[octets] = found = dict(properties)
        return found

    def _acknowledge(self) -> None:
        octets = b"".join(self._acknowledgements)
        self._acknowledgements.clear()
        connection = self._client._connection
        if connection is not None and not connection._transport.is_closing():
            connection.send_package(octets)


def _end_of_long(packet: bytes, place: int) -> int:
    """Where what has its length at that place ends; beyond the packet, if it is no length."""
    length = 0
    for octet in range(4):
        found = packet[place + octet] if place + octet < len(packet) else MORE
        length |= (found & MORE - 1) << 7 * octet
        if found < MORE:
            return place + octet + 1 + length
    return len(packet) + 1


def refusal_code(error: Exception) -> int | None:
    """CONNACK's reason code, if that is what the error is."""
    return int(error._code) if isinstance(error, MQTTConnectError) else None


def reason_name(code: int) -> str:
    """A reason code of CONNACK, PUBACK or DISCONNECT in words."""
    known = MQTTConnectError.__messages__.get(code, "").partition(": ")[2].lower()
    return known or f"reason {code:#04x}"

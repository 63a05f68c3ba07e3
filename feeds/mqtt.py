"""Connections to MQTT brokers, by gmqtt; nothing else in plotfeed knows that library.

gmqtt reconnects by itself, but drops what is published meanwhile without a word and forgets
subscriptions. So here every connection is a new client, and a link knows whether it is up.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any
from uuid import uuid4

import gmqtt

from plotfeed.feeds.broker_address import BrokerAddress
from plotfeed.feeds.message import Message
from plotfeed.proto.errors import PlotfeedError

log = logging.getLogger(__name__)
logging.getLogger("gmqtt").setLevel(logging.CRITICAL + 1)  # it logs tracebacks; we say it in a line

CONNECT_TIMEOUT_S = 3.0
OTHER_VERSION_AFTER_S = 1.0
"""A broker that does not know a version may just not answer."""
KEEP_ALIVE_S = 30
BACKOFF_S = (0.25, 0.5, 1.0, 2.0, 4.0)
MAX_UNSENT_OCTETS = 8 << 20
"""What may wait in the socket for a broker that has stalled; more is not taken."""
MESSAGE_EXPIRY_S = 60
NEVER_RECONNECT = {"reconnect_retries": -2, "reconnect_delay": 0}

OnMessage = Callable[[str, bytes, str | None], None]
"""Called with topic, payload and content type."""


class MqttError(PlotfeedError):
    """A broker that cannot be reached."""

    exit_code = 1


class MqttLink:
    """One client's connection: kept up while `run` runs, and publishing when it is up."""

    def __init__(
        self,
        address: BrokerAddress,
        name: str,
        *,
        will: Message | None = None,
        subscribe: Sequence[str] = (),
        on_message: OnMessage | None = None,
        on_connect: Callable[[MqttLink], None] | None = None,
    ) -> None:
        self.address = address
        self.name = name
        self.connections = 0
        self.last_error = ""
        """Why the last attempt to connect failed."""
        self._client_id = f"{name}-{uuid4().hex[:8]}"
        self._will = will
        self._subscribe = subscribe
        self._on_message = on_message
        self._on_connect = on_connect
        self._versions = address.versions
        self._tls = address.access.tls_context() if address.tls else False
        self._client: gmqtt.Client | None = None
        self._up = asyncio.Event()
        self._down = asyncio.Event()

    @property
    def is_up(self) -> bool:
        """Whether a broker has accepted the connection and has not gone away since."""
        return self._up.is_set()

    async def wait_until_up(self, timeout_s: float | None = None) -> None:
        """Return once there is a connection; raises `MqttError` if there is none in that time."""
        try:
            async with asyncio.timeout(timeout_s):
                await self._up.wait()
        except TimeoutError:
            why = f" ({self.last_error})" if self.last_error else ""
            raise MqttError(f"no MQTT broker answers at {self.address}{why}") from None

    async def run(self) -> None:
        """Connect, and connect again whenever the connection is lost, until cancelled."""
        attempt = 0
        try:
            while True:
                try:
                    await self._connect()
                except MqttError as error:
                    self.last_error = str(error)
                    if attempt == 0 and self.connections:  # else whoever waits is told
                        log.warning("%s: no connection to %s (%s)", self.name, self.address, error)
                    await asyncio.sleep(BACKOFF_S[min(attempt, len(BACKOFF_S) - 1)])
                    attempt += 1
                    continue
                if attempt or self.connections > 1:
                    log.info("%s: connected to %s again", self.name, self.address)
                attempt = 0
                await self._down.wait()
                self._up.clear()
                log.warning("%s: lost the connection to %s", self.name, self.address)
        finally:
            self._up.clear()
            await self._disconnect()

    def publish(self, message: Message) -> bool:
        """Hand a message to the socket; False if there is no connection, or it has stalled."""
        client = self._client
        if client is None or not self._up.is_set() or unsent_octets(client) > MAX_UNSENT_OCTETS:
            return False
        try:
            client.publish(
                message.topic,
                message.payload,
                qos=message.qos,
                retain=message.retain,
                **self._properties(message),
            )
        except OverflowError:  # as much is unacknowledged as the broker allows
            return False
        return True

    async def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until the socket has taken what was published, or the time is up."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        while self._client is not None and self._up.is_set() and unsent_octets(self._client):
            if loop.time() > deadline:
                return
            await asyncio.sleep(0.001)

    def _properties(self, message: Message) -> Mapping[str, Any]:
        if self._versions[0] < 5:
            return {}
        properties: dict[str, Any] = {"content_type": message.content_type}
        if message.properties:
            properties["user_property"] = list(message.properties)
        if not message.retain:
            properties["message_expiry_interval"] = MESSAGE_EXPIRY_S
        return properties

    async def _connect(self) -> None:
        """One attempt with each version that may be spoken; raises `MqttError`."""
        reason = ""
        for version in self._versions:
            client = self._new_client(version)
            last = version == self._versions[-1]
            try:
                async with asyncio.timeout(CONNECT_TIMEOUT_S if last else OTHER_VERSION_AFTER_S):
                    await client.connect(
                        self.address.host,
                        self.address.port,
                        ssl=self._tls,
                        version=version,
                        keepalive=KEEP_ALIVE_S,
                    )
            except TimeoutError:
                reason = "no answer to CONNECT"
            except (OSError, gmqtt.mqtt.handler.MQTTError) as error:
                reason = str(error) or type(error).__name__
            else:
                if not self._down.is_set():
                    self._versions = (version,)
                    self._connected(client)
                    return
                reason = "the connection was closed"
            await _close(client)
        raise MqttError(reason)

    def _new_client(self, version: int) -> gmqtt.Client:
        will = self._will and gmqtt.Message(
            self._will.topic,
            self._will.payload,
            qos=self._will.qos,
            retain=self._will.retain,
            **({"content_type": self._will.content_type} if version >= 5 else {}),
        )
        client = gmqtt.Client(self._client_id, clean_session=True, will_message=will)
        client.set_config(NEVER_RECONNECT)
        access = self.address.access
        if access.username is not None:
            client.set_auth_credentials(access.username, access.password)
        down = self._down = asyncio.Event()
        client.on_disconnect = lambda *_: down.set()
        client.on_message = self._received
        return client

    def _connected(self, client: gmqtt.Client) -> None:
        self._client = client
        self.connections += 1
        self._up.set()
        for topic in self._subscribe:
            client.subscribe(topic, qos=1)
        if self._on_connect is not None:
            self._on_connect(self)

    def _received(
        self, _client: object, topic: str, payload: bytes, _qos: int, properties: dict[str, Any]
    ) -> int:
        if self._on_message is not None:
            content_types = properties.get("content_type") or [None]
            self._on_message(topic, bytes(payload), content_types[0])
        return 0

    async def _disconnect(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            await _close(client)


def unsent_octets(client: gmqtt.Client) -> int:
    """What the socket has not taken yet; gmqtt has no public way to ask."""
    return int(client._connection._transport.get_write_buffer_size())


async def _close(client: gmqtt.Client) -> None:
    with contextlib.suppress(Exception):
        async with asyncio.timeout(1.0):
            await client.disconnect()

"""A link to an MQTT broker: it is kept up, and connects again whenever the connection is lost."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Sequence
from uuid import uuid4

from plotfeed.feeds.messages.message import Message, OnHeard
from plotfeed.feeds.scene.output_keys import MqttQueueKeys
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.connection import MqttConnection, MqttError, OnMessage, no_answer
from plotfeed.feeds.transport.mqtt.sender import MqttSender

log = logging.getLogger(__name__)

CONNECT_TIMEOUT_S = 3.0
OTHER_VERSION_AFTER_S = 1.0
"""A broker that does not know a version may just not answer."""
BACKOFF_S = (0.25, 0.5, 1.0, 2.0, 4.0)
STABLE_S = 5.0
"""A connection that lasted longer was a good one; a broker may also take us and end it at once."""
WATCH_EVERY_S = 5.0


class MqttLink(MqttSender):
    """One client's link: kept up while `run` runs.

    What a lost connection leaves unacknowledged is sent again on the next one, so that a message of
    QoS 1 may arrive twice.
    """

    def __init__(
        self,
        address: BrokerAddress,
        name: str,
        *,
        will: Message | None = None,
        subscribe: Sequence[str] = (),
        on_message: OnMessage | None = None,
        on_heard: OnHeard | None = None,
        on_connect: Callable[[MqttLink], None] | None = None,
        queue: MqttQueueKeys | None = None,
    ) -> None:
        super().__init__(queue)
        if address.tls:
            address.access.tls_context()  # files that cannot be used are an error at once
        self.address = address
        self.name = name
        self.connections = 0
        self.last_error = ""
        """Why the last attempt to connect failed."""
        self._client_id = f"{name}-{uuid4().hex[:8]}"
        self._will = will
        self._subscribe = subscribe
        self._on_message = on_message
        self._on_heard = on_heard
        self._on_connect = on_connect
        self._versions = address.versions
        self._settled = asyncio.Event()
        """There has been a connection, or it is known that there will be none."""

    @property
    def is_up(self) -> bool:
        """Whether a broker has accepted the connection and has not gone away since."""
        return self._connection is not None and not self._connection.lost.is_set()

    async def wait_until_up(self, timeout_s: float | None = None) -> None:
        """Return once there has been a connection.

        Raises `MqttError` if there is none in that time, or the broker refuses for good.
        """
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                await self._settled.wait()
        if not self.connections:
            raise MqttError(f"MQTT broker {self.address}: {self.last_error or no_answer()}")

    async def run(self) -> None:
        """Connect, and connect again whenever the connection is lost, until cancelled."""
        attempt, loop = 0, asyncio.get_running_loop()
        try:
            while True:
                try:
                    connection = await self._connect()
                except MqttError as error:
                    self._failed(error)
                else:
                    began_s = loop.time()
                    await self._watch(connection)
                    self._lose(connection)
                    if loop.time() - began_s > STABLE_S:
                        attempt = 0
                self.expire()
                await asyncio.sleep(BACKOFF_S[min(attempt, len(BACKOFF_S) - 1)])
                attempt += 1
        finally:
            still_up = self.end()
            if still_up is not None:
                await still_up.close()

    async def _watch(self, connection: MqttConnection) -> None:
        """Return when it is lost; end it when its socket takes nothing any more."""
        while not connection.lost.is_set():
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(WATCH_EVERY_S):
                    await connection.lost.wait()
            connection.end_if_stuck()
            self.expire()

    def _lose(self, connection: MqttConnection) -> None:
        log.warning("%s: %s", self.name, self._loss(connection))
        self.send_by(None)
        connection.abort()

    async def _connect(self) -> MqttConnection:
        """One attempt with each version that may be spoken; raises `MqttError`."""
        error = no_answer()
        for version in self._versions:
            connection = MqttConnection(
                self.address,
                version,
                self._client_id,
                counts=self.counts,
                on_room=self._has_room_again,
                will=self._will,
                on_message=self._on_message,
                on_heard=self._on_heard,
            )
            last = version == self._versions[-1]
            try:
                await connection.open(CONNECT_TIMEOUT_S if last else OTHER_VERSION_AFTER_S)
            except MqttError as found:
                error = found
                if not error.other_version:
                    break
            else:
                self._connected(connection)
                return connection
        raise error

    def _connected(self, connection: MqttConnection) -> None:
        self._versions = (connection.version,)
        self.connections += 1
        self.last_error = ""
        self._settled.set()
        if self.connections > 1:
            log.info("%s: connected to %s again", self.name, self.address)
        for topic_filter in self._subscribe:
            connection.subscribe(topic_filter)
        self.send_by(connection)
        if self._on_connect is not None:
            self._on_connect(self)

    def _failed(self, error: MqttError) -> None:
        if self.connections and str(error) != self.last_error:  # before, whoever waits is told
            log.warning("%s: no connection to %s (%s)", self.name, self.address, error)
        self.last_error = str(error)
        if error.final:
            self._settled.set()

    def _loss(self, connection: MqttConnection) -> str:
        """What there is to say of a connection that is lost."""
        why = f" ({connection.good_bye})" if connection.good_bye else ""
        lost = connection.unacknowledged
        unheard = f"; {lost} unacknowledged messages will be sent again" if lost else ""
        return f"lost the connection to {self.address}{why}{unheard}"

"""A link to an MQTT broker: kept up, and sending by its connection; else messages wait.

Beside it are last wills of many: a broker takes one will a connection, and a sensor that dies with
its session must be OFFLINE for whoever listens.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from functools import partial
from typing import Self
from uuid import uuid4

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.transports import Client
from plotfeed.feeds.scene.output_keys import MqttQueueKeys
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.connection import (
    MqttConnection,
    MqttError,
    OnMessage,
    OnReceived,
    no_answer,
)
from plotfeed.feeds.transport.mqtt.own_echo import OwnEcho
from plotfeed.feeds.transport.mqtt.send_queue import SendQueue, loop_s
from plotfeed.feeds.transport.ways_out import backoff_s, wait_while

log = logging.getLogger(__name__)

CONNECT_TIMEOUT_S = 3.0
AT_FIRST_S = 0.5  # A broker that is not up by then is waited for with a line
OTHER_VERSION_AFTER_S = 1.0  # A broker that does not know a version may just not answer
# A connection that lasted longer was a good one; a broker may also take us and end it at once.
STABLE_S = 5.0
WATCH_EVERY_S = 5.0
SLICE = 100  # Messages that are sent before others have their turn in the loop


class MqttTransport:
    """One client's link: kept up while `run` runs.

    What cannot leave at once waits, or is dropped, as the settings of the queue have it. Messages
    of one QoS keep their order. What a lost connection leaves unacknowledged is sent again on the
    next one, so that a message of QoS 1 may arrive twice.
    """

    def __init__(
        self,
        address: BrokerAddress,
        name: str,
        *,
        subscribe: Sequence[str] = (),
        on_message: OnMessage | None = None,
        on_received: OnReceived | None = None,
        on_connect: Callable[[MqttTransport], None] | None = None,
        queue: MqttQueueKeys | None = None,
        on_echo: Callable[[bool], object] | None = None,
        client_id: str | None = None,
    ) -> None:
        """`on_echo` is told of samples of what is published whether they come back."""
        if address.tls:
            address.access.tls_context()  # files that cannot be used are an error at once
        self.address = address
        self.name = name
        self.connections = 0
        self.last_error = ""  # Why the last attempt to connect failed
        self._subscribe, self._on_connect = subscribe, on_connect
        self._echo = None if on_echo is None else OwnEcho(address, subscribe, on_echo)
        self._new_connection = partial(
            MqttConnection,
            address,
            client_id=client_id or f"{name}-{uuid4().hex[:8]}",
            on_room=self._has_room_again,
            on_message=on_message,
            on_received=on_received,
            echo=self._echo,
        )
        self._versions = address.versions
        # There has been a connection, or it is known that there will be none.
        self._settled = asyncio.Event()
        keys, self._destination = queue or MqttQueueKeys(), address.destination
        self._queues = [SendQueue(keys, qos, self._destination) for qos in (0, 1)]
        self._connection: MqttConnection | None = None
        self._sending: asyncio.Handle | None = None
        self._room = asyncio.Event()
        self._ended = False

    @property
    def is_up(self) -> bool:
        """Whether a broker has accepted the connection and has not gone away since."""
        return self._connection is not None and not self._connection.lost.is_set()

    @property
    def version(self) -> int:
        """The version of MQTT that it speaks, 4 for 3.1.1; the first to try, before it is up."""
        return self._versions[0]

    @contextlib.asynccontextmanager
    async def connected(self, timeout_s: float) -> AsyncIterator[Self]:
        """Keep the link up meanwhile; raises `MqttError` if it is not up in that time."""
        running = asyncio.create_task(self.run(), name=f"link[{self.name}]")
        try:
            await self.wait_until_up(timeout_s)
            yield self
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)

    async def wait_until_up(self, timeout_s: float | None = None) -> None:
        """Return once there has been a connection, however long that takes if the address waits.

        Raises `MqttError` if there is none in that time, or the broker refuses for good.
        """
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(AT_FIRST_S if self.address.waits else timeout_s):
                await self._settled.wait()
        if self.address.waits and not self._settled.is_set():
            found = self.last_error or no_answer()
            log.info("waits for the MQTT broker %s (%s); stop: Ctrl-C", self.address, found)
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
                    if self.connections and str(error) != self.last_error:
                        log.warning("%s: no connection to %s (%s)", self.name, self.address, error)
                    self.last_error = str(error)  # of the first attempts whoever waits is told
                    if error.final:
                        self._settled.set()
                else:
                    began_s = loop.time()
                    await self._watch(connection)
                    lost = connection.unacknowledged
                    why = f" ({connection.good_bye})" if connection.good_bye else ""
                    why += f"; {lost} unacknowledged messages will be sent again" if lost else ""
                    log.warning("%s: lost the connection to %s%s", self.name, self.address, why)
                    self._send_by(None)
                    connection.abort()
                    if loop.time() - began_s > STABLE_S:
                        attempt = 0
                self._expire()
                await asyncio.sleep(backoff_s(attempt))
                attempt += 1
        finally:
            self._ended = True
            still_up = self._connection
            self._send_by(None)
            self.give_up()
            if still_up is not None:
                await still_up.close()

    @property
    def waiting(self) -> int:
        """Messages that wait for a connection, or for room on it."""
        return sum(map(len, self._queues))

    def waiting_of(self, client: Client) -> int:
        """Messages of that client that wait for a connection, or for room on it."""
        return sum(queue.waiting_of(client) for queue in self._queues)

    @property
    def is_full(self) -> bool:
        """Whether whoever publishes should wait for `room` first; only by the policy "wait"."""
        return any(queue.is_full for queue in self._queues)

    async def room(self) -> None:
        """Return when it is not full, or its end has come."""
        while self.is_full:
            self._room.clear()
            await self._room.wait()

    def carries(self, _message: Message) -> bool:
        """Say that it is for the broker, as everything is."""
        return True

    def publish(self, messages: Sequence[Message]) -> bool:
        """Send all in one write where they may go; else send each, let it wait, or drop it.

        Delivered is what the socket has taken, with QoS 0, and what the broker has acknowledged,
        with QoS 1. True if that is so of all; else each is settled as soon as it is known.
        """
        connection = self._connection
        if (
            not (connection is None or self._ended or self._queues[0])
            and connection.has_room(0)
            and not any(message.qos for message in messages)
            and connection.takes(*messages)
        ):
            return connection.send(messages)
        for one in messages:
            self._publish(one)
        return False

    def _publish(self, one: Message) -> None:
        qos = one.qos
        queue, connection = self._queues[qos], self._connection
        if self._ended:
            one.settle(delivered=False, to=self._destination)
        elif connection is None or queue or not connection.has_room(qos):
            queue.put(one)
        else:
            if qos:
                one.since_s = loop_s()
            self._send(connection, one)

    def prepare(self, messages: Sequence[Message]) -> None:
        """Do ahead of time what can be done for messages that will be published soon."""
        if self._connection is not None:
            self._connection.prepare(messages)

    async def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until nothing waits and sockets have taken everything, or the time is up.

        What was published with QoS 1 has been acknowledged then.
        """
        await wait_while(
            lambda: self.waiting or not (self._connection is None or self._connection.is_idle()),
            timeout_s,
        )

    def give_up(self) -> None:
        """Settle all that is not delivered by now, waiting or unacknowledged, as undelivered."""
        if self._connection is not None:
            self._queues[1].put_back(self._connection.give_up())
        for queue in self._queues:
            queue.give_up()
        self._room.set()

    def _expire(self) -> None:
        """Drop what has waited too long."""
        for queue in self._queues:
            queue.expire()
        if not self.is_full:
            self._room.set()

    def _send_by(self, connection: MqttConnection | None) -> None:
        """Send by this one, or by none; what another had not delivered waits for it."""
        lost, self._connection = self._connection, connection
        if self._echo is not None:
            self._echo.begin(connection)
        if lost is not None:
            self._queues[1].put_back(lost.give_up())
        self._has_room_again()

    def _has_room_again(self) -> None:
        """Go on sending, as soon as it is this link's turn in the loop."""
        if self._sending is None and self.waiting:
            self._sending = asyncio.get_running_loop().call_soon(self._send_waiting)

    def _send_waiting(self) -> None:
        """Send what waits, in its order and a slice at a time, as far as there is room."""
        self._sending = None
        more = False
        for qos, queue in enumerate(self._queues):
            for _ in range(SLICE):
                if self._connection is None or not self._connection.has_room(qos):
                    break
                found = queue.take()
                if found is None:
                    break
                self._send(self._connection, found)
            else:
                more = True
        if more:
            self._has_room_again()
        if not self.is_full:
            self._room.set()

    def _send(self, connection: MqttConnection, one: Message) -> None:
        if not connection.takes(one):
            one.settle(delivered=False, to=self._destination)
        elif one.qos:
            connection.send_until_acknowledged(one)
        else:
            one.leave()
            if connection.send([one]):
                one.settle(delivered=True)

    async def _watch(self, connection: MqttConnection) -> None:
        """Return when it is lost; end it when its socket takes nothing any more."""
        while not connection.lost.is_set():
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(WATCH_EVERY_S):
                    await connection.lost.wait()
            connection.end_if_stuck()
            self._expire()

    async def _connect(self) -> MqttConnection:
        """One attempt with each version that may be spoken; raises `MqttError`."""
        error = no_answer()
        for version in self._versions:
            connection = self._new_connection(version=version)
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
        self._send_by(connection)
        if self._on_connect is not None:
            self._on_connect(self)


# Connections that are made at a time: a broker has a queue for those that come, and others wait for
# the loop.
AT_ONCE = 10
FIRST_LOOK_S, LOOK_EVERY_S = 0.01, 0.25  # The latter from one look at what is lost to the next
# A broker takes a connection for lost, and publishes its will, after 1.5 times that.
PROMPT_KEEP_ALIVE_S = 3
PATIENCE_S = 1.0  # So long a session waits for its wills before it begins without the last of them


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
        self._stem = stem or f"plotfeed-{uuid4().hex[:8]}"
        self._prompt = prompt if stem is not None else ""
        self._were_there = stem is not None  # Before this process
        self._tried: set[str] = set()
        self._connections: dict[str, MqttConnection] = {}  # By whose they are, up or lost
        self._placed = asyncio.Event()  # All wills have been placed once, or it has been tried
        self._complained = False
        self._forgotten = False

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
        try:
            while True:
                if self._link.is_up and loop.time() >= again_s:
                    if await self._connect_missing():
                        failures = 0
                    else:
                        again_s = loop.time() + backoff_s(failures)
                        failures += 1
                    self._placed.set()
                await asyncio.sleep(LOOK_EVERY_S if self._placed.is_set() else FIRST_LOOK_S)
        finally:
            for connection in self._connections.values():
                if self._forgotten:
                    connection.say_goodbye()
                else:
                    connection.abort()

    def forget(self) -> None:
        """No will shall be published any more when its connection ends."""
        self._forgotten = True

    async def _connect_missing(self) -> bool:
        """Place all wills that are not placed, some at a time; whether that could be done."""
        up = {whose for whose, each in self._connections.items() if not each.lost.is_set()}
        missing = [whose for whose in self._wills if whose not in up]
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
        is_back = self._were_there or whose in self._tried
        self._tried.add(whose)
        connection = MqttConnection(
            self._link.address,
            self._link.version,
            f"{self._stem}-{whose}",
            will=self._wills[whose],
            keep_alive_s=PROMPT_KEEP_ALIVE_S if whose == self._prompt else None,
        )
        try:
            await connection.open(CONNECT_TIMEOUT_S)
        except MqttError as error:
            return str(error)
        self._connections[whose] = connection
        if is_back:
            self._on_back(whose)
        return ""

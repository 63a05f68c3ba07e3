"""One connection to an MQTT broker: it lives once, and knows whether it is up and has room.

What has not arrived when it is over is handed back. Why there is none is an `MqttError`, in words
and without secrets.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import ssl
from collections.abc import Callable, Sequence
from itertools import cycle

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.own_echo import OwnEcho
from plotfeed.feeds.transport.mqtt.packets import (
    CONNACK,
    DISCONNECT,
    GOODBYE,
    MAXIMUM_PACKET_SIZE,
    PINGREQ,
    PUBACK,
    RECEIVE_MAXIMUM,
    REFUSED,
    SERVER_KEEP_ALIVE,
    SUBACK,
    BrokenPacketError,
    BrokerAnswer,
    BrokerReader,
    Publication,
    acknowledgements,
    connect_packet,
    publish_packet,
    reason_name,
    subscribe_packet,
    unsubscribe_packet,
)
from plotfeed.feeds.transport.mqtt.send_queue import SocketBuffer
from plotfeed.proto.errors import PlotfeedError

log = logging.getLogger(__name__)

KEEP_ALIVE_S = 15  # A broker that has said nothing for twice as long is gone
CLOSE_S = 1.0
# At a time, of what a session takes in: a millisecond's work if it is small messages.
READ_OCTETS = 8_192
TOGETHER_OCTETS = 1 << 16  # Of QoS 1: beyond, what is to leave in one write leaves at once
HEADER_OCTETS = 1024  # At most, of what a packet holds besides its payload
# Topics of a connection on which a broker refuses messages, and that are named.
MOST_COMPLAINTS = 10
# At once, where the broker does not say how many (Receive Maximum: mosquitto takes 20).
MAX_UNACKNOWLEDGED = 1000
MAX_UNACKNOWLEDGED_OCTETS = 32 << 20  # Of payloads, besides the one that goes beyond it
FIRST_ID, LAST_ID = 1000, 65_535  # Of messages; those below are of subscriptions
# CONNACK's codes, in MQTT 3.1.1 and 5, for a version of MQTT that the broker does not speak.
UNKNOWN_VERSION = frozenset({1, 132})
# CONNACK's codes for what a broker may think better of: busy, not available yet.
TRANSIENT = frozenset({3, 131, 136, 137, 151, 159})
TLS_TIMEOUT_S = 1.0
HUNG_UP = "it hung up without an answer"
TOO_MANY = "it may have as many connections as it takes"

OnMessage = Callable[[str, bytes, str | None], None]  # Called with topic, payload and content type
OnReceived = Callable[[Publication], None]


class MqttError(PlotfeedError):
    """A broker with which there is no connection."""

    exit_code = 1

    def __init__(self, reason: str, *, final: bool = False, versions: bool = False) -> None:
        super().__init__(reason)
        self.final = final  # It would be no better a second time
        self.other_version = versions  # It may be better with another version of MQTT


class MqttConnection(asyncio.BufferedProtocol):
    """Made, opened, closed; never opened again."""

    def __init__(
        self,
        address: BrokerAddress,
        version: int,
        client_id: str,
        *,
        on_room: Callable[[], None] = lambda: None,
        on_message: OnMessage | None = None,
        on_received: OnReceived | None = None,
        echo: OwnEcho | None = None,
        will: Message | None = None,
        keep_alive_s: int | None = None,
    ) -> None:
        """`on_room` is called whenever there may be room again; `will` is a last one."""
        self.lost = asyncio.Event()
        self.good_bye = ""  # Why the connection ends, as far as the broker or this client says
        self.version = version
        self._address, self._client_id, self._will = address, client_id, will
        self._destination = address.destination
        self._on_message, self._on_received = on_message, on_received
        self._echo = echo
        self._on_room = on_room
        self._loop = asyncio.get_running_loop()
        self._keep_alive_s = keep_alive_s or KEEP_ALIVE_S
        # CONNACK's code; None if the connection is lost before.
        self._answer: asyncio.Future[int | None] = self._loop.create_future()
        self._error: Exception | None = None  # What broke it
        self._reader = BrokerReader(version)
        at_a_time = READ_OCTETS if will is None else READ_OCTETS // 32
        self._incoming = memoryview(bytearray(at_a_time))
        self._heard_s = self._loop.time()
        self._timer: asyncio.TimerHandle | None = None
        self._transport: asyncio.WriteTransport | None = None
        self._buffer: SocketBuffer  # There is one as soon as there is a transport
        # Of QoS 1, by the numbers of their packets, in the order in which they were sent.
        self._unacknowledged: dict[int, Message] = {}
        self._unacknowledged_octets = 0
        self._most_unacknowledged = MAX_UNACKNOWLEDGED
        self._last_id = FIRST_ID - 1
        self._packets: list[bytes] = []  # Of QoS 1, which are written next
        self._packed_octets = 0
        self._asks = cycle(range(1, FIRST_ID))
        # Filters that the broker has not answered for, by the number of their subscription.
        self._subscriptions: dict[int, str] = {}
        self._refused_topics: set[str] = set()
        self._largest_payload: int | None = None

    @property
    def unacknowledged(self) -> int:
        """Messages of QoS 1 of which it is not known that they have arrived."""
        return len(self._unacknowledged)

    async def open(self, timeout_s: float) -> None:
        """Connect, and have the broker's consent; raises `MqttError`."""
        address = self._address
        try:
            async with asyncio.timeout(timeout_s):
                tls = address.access.tls_context() if address.tls else None
                await self._loop.create_connection(
                    lambda: self, address.host, address.port, ssl=tls
                )
                code = await self._answer
            if code is None:
                raise await self._hung_up()
            if code:
                raise MqttError(
                    f"it refuses: {reason_name(code)}",
                    final=code not in TRANSIENT,
                    versions=code in UNKNOWN_VERSION,
                )
        except BaseException as error:
            self.abort()
            if isinstance(error, ConnectionResetError):
                raise await self._hung_up() from None
            if isinstance(error, TimeoutError) and error.errno is None:
                raise no_answer() from None
            if isinstance(error, OSError | ValueError):
                raise _failure(error) from None
            raise

    def subscribe(self, topic_filter: str) -> None:
        """Have what comes there."""
        number, as_published = next(self._asks), self._on_received is not None
        self._subscriptions[number] = topic_filter
        self._write(subscribe_packet(number, topic_filter, self.version, as_published=as_published))

    def unsubscribe(self, topic_filter: str) -> None:
        """Have what comes on that topic no more."""
        self._write(unsubscribe_packet(next(self._asks), topic_filter, self.version))

    def has_room(self, qos: int) -> bool:
        """Whether a message of that QoS may be sent now."""
        if not self._buffer.has_room or self.lost.is_set():
            return False
        return qos == 0 or (
            len(self._unacknowledged) < self._most_unacknowledged
            and self._unacknowledged_octets < MAX_UNACKNOWLEDGED_OCTETS
        )

    def takes(self, *messages: Message) -> bool:
        """Whether none is larger than what the broker says that it takes."""
        most = self._largest_payload
        return most is None or all(len(message.payload) <= most for message in messages)

    def send(self, messages: Sequence[Message]) -> bool:
        """Hand these messages of QoS 0, at least one, to the socket, where there is room.

        In one go, since a system call costs more than a message. True if it has taken all; else
        each is settled when it has left the socket's buffer.
        """
        version = self.version
        packets = [
            message.packets.get(version) or publish_packet(message, version) for message in messages
        ]
        octets = b"".join(packets)
        all_left = self._buffer.write(octets)
        if self._echo is not None and self._echo.wants:
            self._echo.published(messages)
        if all_left:
            return True
        left = len(octets)
        for packet, one in zip(packets, messages, strict=True):
            left -= len(packet)
            if not one.sent_utc_ns:
                one.leave()
            self._buffer.keep(one, left)
        return False

    def prepare(self, messages: Sequence[Message]) -> None:
        """Make the packets of what will be sent soon; those of QoS 1 need a number first."""
        version = self.version
        for message in messages:
            if not message.qos:
                packet = publish_packet(message, version)
                message.packets = {**message.packets, version: packet}

    def send_until_acknowledged(self, one: Message) -> None:
        """Send a message of QoS 1, and keep it until the broker has answered.

        Small ones of one turn of the loop leave in one write at its end.
        """
        one.leave()
        number = self._last_id
        while (number := number + 1 if number < LAST_ID else FIRST_ID) in self._unacknowledged:
            pass
        self._last_id = number
        self._unacknowledged[number] = one
        self._unacknowledged_octets += len(one.payload)
        if not self._packets:
            self._loop.call_soon(self._write_packets)
        packet = publish_packet(one, self.version, number=number)
        self._packets.append(packet)
        if self._echo is not None and self._echo.wants:
            self._echo.published([one])
        self._packed_octets += len(packet)
        if self._packed_octets > TOGETHER_OCTETS:
            self._write_packets()

    def is_idle(self) -> bool:
        """Whether the socket has taken everything, and QoS 1 is acknowledged."""
        return not self._unacknowledged and not self._buffer.octets

    def give_up(self) -> list[Message]:
        """Drop what the socket has not taken, and hand back what is unacknowledged."""
        self._buffer.give_up(self._destination)
        left, self._unacknowledged = list(self._unacknowledged.values()), {}
        self._unacknowledged_octets = 0
        return left

    def end_if_stuck(self) -> None:
        """Cut a connection whose socket takes nothing any more; to be called now and then."""
        if not self.lost.is_set() and self._buffer.is_stuck():
            self._end("it takes nothing any more")

    def say_goodbye(self) -> None:
        """Have the broker forget the last will, and close when the socket has taken that."""
        self._write_packets()
        self._write(GOODBYE)
        if self._transport is not None:
            self._transport.close()

    async def close(self) -> None:
        """Say goodbye, if there is still anybody."""
        try:
            self.say_goodbye()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(CLOSE_S):
                    await self.lost.wait()
        finally:
            self.abort()

    def abort(self) -> None:
        """Cut it, if there is any, and keep nothing of it."""
        if self._timer is not None:
            self._timer.cancel()
        if self._transport is not None:
            self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Say who it is."""
        assert isinstance(transport, asyncio.WriteTransport)  # noqa: S101 - of a stream  # nosec B101
        self._transport, self._buffer = transport, SocketBuffer(transport, self._on_room)
        transport.set_write_buffer_limits(high=1, low=0)  # TLS takes 0 for always full
        access = self._address.access
        self._buffer.write(
            connect_packet(
                self._client_id,
                self.version,
                access.username,
                access.password,
                will=self._will,
                keep_alive_s=self._keep_alive_s,
            )
        )

    def connection_lost(self, error: Exception | None) -> None:
        """Nobody is there any more."""
        self._error = error
        self.lost.set()
        if self._timer is not None:
            self._timer.cancel()
        if not self._answer.done():
            self._answer.set_result(None)

    def pause_writing(self) -> None:
        """The socket has not taken everything."""
        self._buffer.hold()

    def resume_writing(self) -> None:
        """The socket has taken everything."""
        self._buffer.release()

    def get_buffer(self, _sizehint: int) -> memoryview:
        """Where the socket's octets go: so many at a time that others have their turn."""
        return self._incoming

    def buffer_updated(self, octets: int) -> None:
        """Take what has come; messages of QoS 1 that came together are acknowledged together."""
        self._heard_s = self._loop.time()
        taken: list[int] = []
        try:
            for event in self._reader.receive(self._incoming[:octets]):
                if not self._answer.done() and getattr(event, "kind", 0) != CONNACK:
                    raise BrokenPacketError("something else before CONNACK")
                if isinstance(event, BrokerAnswer):
                    self._answered(event)
                    continue
                if event.number is not None:
                    taken.append(event.number)
                self._received(event)
        except BrokenPacketError as error:
            self._end(f"it does not keep to MQTT: {error}")
        if taken:
            self._write(acknowledgements(taken))

    def _write(self, octets: bytes) -> None:
        transport = self._transport
        if not (transport is None or transport.is_closing() or self.lost.is_set()):
            self._buffer.write(octets)

    def _write_packets(self) -> None:
        octets = b"".join(self._packets)
        self._packets.clear()
        self._packed_octets = 0
        if octets:
            self._write(octets)

    def _end(self, why: str) -> None:
        self.good_bye = why
        self.abort()

    def _keep_alive(self) -> None:
        """Ask for a sign of life, or cut it; a slow network is none that is dead."""
        heard_s = max(self._heard_s, self._buffer.moved_s)
        if self._loop.time() - heard_s > 2 * self._keep_alive_s:
            self._end("it says nothing any more")
            return
        self._write(PINGREQ)
        self._timer = self._loop.call_later(self._keep_alive_s / 2, self._keep_alive)

    def _answered(self, answer: BrokerAnswer) -> None:
        if answer.kind == CONNACK:
            if self._answer.done():
                raise BrokenPacketError("a second CONNACK")
            numbers = answer.properties.numbers
            if MAXIMUM_PACKET_SIZE in numbers:
                self._largest_payload = max(0, numbers[MAXIMUM_PACKET_SIZE] - HEADER_OCTETS)
            self._most_unacknowledged = min(
                self._most_unacknowledged, numbers.get(RECEIVE_MAXIMUM) or LAST_ID
            )
            self._keep_alive_s = numbers.get(SERVER_KEEP_ALIVE) or self._keep_alive_s
            self._timer = self._loop.call_later(self._keep_alive_s / 2, self._keep_alive)
            self._answer.set_result(answer.codes[0])
        elif answer.kind == PUBACK:
            self._acknowledged(answer.number, answer.codes[0])
        elif answer.kind == SUBACK:
            self._granted(self._subscriptions.pop(answer.number, ""), answer.codes)
        elif answer.kind == DISCONNECT:
            self.good_bye = reason_name(answer.codes[0])
            self.lost.set()

    def _acknowledged(self, number: int, code: int) -> None:
        one = self._unacknowledged.pop(number, None)
        if one is None:
            return
        self._unacknowledged_octets -= len(one.payload)
        delivered, topic = code < REFUSED, one.topic
        one.settle(delivered=delivered, to=self._destination)
        self._on_room()
        if delivered or topic in self._refused_topics:
            return
        if len(self._refused_topics) < MOST_COMPLAINTS:
            self._refused_topics.add(topic)
            reason = reason_name(code)
            log.warning("%s refuses what is published on %s: %s", self._address, topic, reason)

    def _granted(self, topic_filter: str, codes: bytes) -> None:
        for code in codes:
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

    def _received(self, message: Publication) -> None:
        topic, payload = message.topic, message.payload
        if self._echo is not None and self._echo.heard(topic, payload):
            return
        if self._on_message is not None:
            self._on_message(topic, payload, message.properties.content_type)
        if self._on_received is not None:
            self._on_received(message)

    async def _hung_up(self) -> MqttError:
        """The error for a broker that ended the connection before it had answered."""
        address, access = self._address, self._address.access
        if isinstance(self._error, ssl.SSLError):
            return _failure(self._error)
        if self._will is not None:  # else it has taken what is alike
            return MqttError(f"{HUNG_UP}: {TOO_MANY}")
        if not address.tls and await _speaks_tls(address):
            return MqttError(f"{HUNG_UP}: it wants TLS (mqtts://)")
        if self.good_bye:
            return MqttError(self.good_bye, versions=True)
        may_want = []
        if address.tls:
            may_want.append(f"{'a' if access.certificate_file is None else 'another'} certificate")
        may_want.append(f"{'a' if access.username is None else 'another'} user name and password")
        may_want.append(f"another version of MQTT than {'5' if self.version >= 5 else '3.1.1'}")
        return MqttError(f"{HUNG_UP}: {TOO_MANY}, or want {', or '.join(may_want)}", versions=True)


def no_answer() -> MqttError:
    """The error for a broker that takes the connection and says nothing."""
    return MqttError("no answer to CONNECT", versions=True)


def _failure(error: Exception) -> MqttError:
    """The error for what went wrong before the broker had an answer."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return MqttError(f"its certificate is not good: {error.verify_message}", final=True)
    if isinstance(error, ssl.SSLError):
        words = (error.reason or "no more is known").replace("_", " ").lower()
        return MqttError(f"TLS failed: {words}")
    if isinstance(error, UnicodeError):
        return MqttError("no host can have this name", final=True)
    text = error.strerror if isinstance(error, OSError) else None
    return MqttError(text or str(error) or type(error).__name__)


async def _speaks_tls(address: BrokerAddress) -> bool:
    """Whether it answers TLS where it was spoken to without, whatever its certificate."""
    anybody = ssl.create_default_context()
    anybody.check_hostname = False
    anybody.verify_mode = ssl.CERT_NONE
    try:
        async with asyncio.timeout(TLS_TIMEOUT_S):
            _, writer = await asyncio.open_connection(address.host, address.port, ssl=anybody)
    except (OSError, TimeoutError):
        return False
    writer.transport.abort()
    return True

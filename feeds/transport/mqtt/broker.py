"""An MQTT broker as a function: octets of clients in, octets for clients out; nothing waits here.

It speaks MQTT 3.1.1 and 5.0 on the same port, so that a message is published once and heard by
clients of both. Each client has a name with rights (`Rights`), a queue of its own with a size, and
is cut off alone when it breaks the protocol or takes what is meant for it too slowly. Section
numbers are those of MQTT 5.0. What is not here is said to clients of 5.0 in CONNACK: shared
subscriptions and topic aliases of clients.
"""

from __future__ import annotations

import hmac
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from plotfeed.feeds.messages.message import checked_topic_filter, packed_text, topic_matches
from plotfeed.feeds.transport.mqtt.packets import (
    CLEAN,
    CONNACK,
    CONNECT,
    DISCONNECT,
    MAXIMUM_PACKET_SIZE,
    NUMBERS,
    OF_SUBSCRIPTION,
    OF_USER,
    PASSWORD,
    PINGREQ,
    PINGRESP,
    PUBACK,
    PUBLISH,
    RECEIVE_MAXIMUM,
    RETAIN,
    SUBACK,
    SUBSCRIBE,
    TEXTS,
    UNSUBACK,
    UNSUBSCRIBE,
    USERNAME,
    WILL,
    BrokenPacketError,
    PacketSplitter,
    packet,
    read_length,
    read_octets,
    read_properties,
    reason_name,
)
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.varint import varint

PUBREC, PUBREL, PUBCOMP = 0x50, 0x62, 0x70
OF_FORMAT, OF_EXPIRY, OF_CORRELATION, OF_SESSION_EXPIRY, OF_WILL_DELAY = 1, 2, 9, 0x11, 0x18
NOT_AUTHORIZED, BAD_PASSWORD, BUSY, KEEP_ALIVE, TAKEN_OVER = 0x87, 0x86, 0x89, 0x8D, 0x8E
BAD_FILTER, TOO_MANY, TOO_LARGE, QUOTA, NOT_SHARED = 0x8F, 0x93, 0x95, 0x97, 0x9E
BAD_NAME, BAD_VERSION, MALFORMED, WITH_WILL, NO_SUCH = 0x85, 0x84, 0x81, 0x04, 0x11
# In 3.1.1 a session that is not clean has no end; the most that 5.0 can say stands for that.
NEVER_S = 0xFFFF_FFFF
MAX_CONNECT_OCTETS = 1 << 18  # A will of 65,535 octets, names and properties
MAX_QUEUE_OCTETS = 16 << 20  # That wait for a client who takes them slowly, or is away
MAX_UNACKNOWLEDGED = 1000  # Of QoS 1 and 2, on their way to or from a client at a time
MAX_FILTERS = 1000  # That a client may have subscribed to
MAX_KNOWN_TOPICS = 4096  # Of which it is kept who hears them
MESSAGE_OCTETS = 200  # That a queue counts for each message besides what it carries
CONNECT_PATIENCE_S = 10.0  # For the first packet of a connection
# Reason codes of 5.0 that a CONNACK of 3.1.1 says with a number of its own.
CODES_OF_3 = {BAD_VERSION: 1, BAD_NAME: 2, BUSY: 3, BAD_PASSWORD: 4, NOT_AUTHORIZED: 5}


@dataclass(frozen=True, slots=True)
class Rights:
    """What a user may publish and hear, as topic filters; without filters, nothing."""

    publishes: Sequence[str] = ("#",)
    hears: Sequence[str] = ("#",)
    # What is none of these all the same.
    publishes_not: Sequence[str] = ()
    hears_not: Sequence[str] = ()

    def may_publish(self, topic: str) -> bool:
        """Whether a message on that topic is passed on."""
        return _one_of(topic, self.publishes) and not _one_of(topic, self.publishes_not)

    def may_hear(self, topic: str) -> bool:
        """Whether a message on that topic is delivered."""
        return _one_of(topic, self.hears) and not _one_of(topic, self.hears_not)


@dataclass(frozen=True, slots=True)
class User:
    """A name that opens the door, with its password and its rights."""

    password: str
    rights: Rights


@dataclass(frozen=True, slots=True)
class BrokerLimits:
    """What a broker bears."""

    connections: int = 1000
    payload_octets: int = 1 << 20
    held_octets: int = 512 << 20  # Of what is retained and what waits, of all clients together


@dataclass(slots=True)
class _Message:
    """A PUBLISH on its way; `properties` begin with their length, as packets have them."""

    topic: bytes
    properties: bytes
    payload: bytes
    qos: int = 0
    retain: bool = False
    expiry_s: int | None = None
    since_s: float = 0.0  # When it came
    # The packets of QoS 0 that are alike for all, made when first asked for.
    made: dict[int, bytes] = field(default_factory=dict)

    @property
    def octets(self) -> int:
        return len(self.topic) + len(self.properties) + len(self.payload) + MESSAGE_OCTETS

    def packet_of(self, version: int, *, retain: bool = False) -> bytes:
        """The packet of QoS 0 for a client of that version of MQTT."""
        kind = version << 1 | retain
        made = self.made.get(kind)
        if made is None:
            properties = self.properties if version >= 5 else b""
            made = packet(PUBLISH | retain, _sized(self.topic), properties, self.payload)
            if not self.retain:
                self.made[kind] = made
        return made


@dataclass(frozen=True, slots=True)
class _Subscription:
    filter: str
    qos: int
    no_local: bool = False
    as_published: bool = False
    number: bytes = b""  # The property that names it to its client


class _Delivery(NamedTuple):
    """A message on its way to one client; `numbers` are properties that name its subscriptions."""

    message: _Message
    qos: int
    retain: bool
    numbers: bytes = b""


@dataclass(slots=True, eq=False)
class _Session:
    """What a client has here, whether it is connected or away."""

    client_id: str
    rights: Rights
    subscriptions: dict[str, _Subscription] = field(default_factory=dict)
    connection: Connection | None = None
    expiry_s: int = 0
    away_since_s: float = 0.0
    waiting: deque[_Delivery] = field(default_factory=deque)
    waiting_octets: int = 0
    unacknowledged: dict[int, bytes] = field(default_factory=dict)  # Packets, by their ids
    last_id: int = 0
    taken: set[int] = field(default_factory=set)  # Ids of QoS 2 that were not released yet
    will: _Message | None = None
    will_delay_s: int = 0
    will_due_s: float | None = None
    dropped: int = 0


class Broker:
    """Retained messages, sessions, and who hears what; each client has a `Connection`."""

    def __init__(
        self,
        limits: BrokerLimits | None = None,
        users: Mapping[str, User] | None = None,
        *,
        anonymous: Rights | None = None,
        tell: Callable[[str], object] = str,
    ) -> None:
        """`anonymous` is what clients without a name may do; None turns them away.

        `tell` is called with a line about each client that is cut off, refused or loses messages.
        """
        self.limits = limits or BrokerLimits()
        self.users, self.anonymous, self.tell = users or {}, anonymous, tell
        self.connections = 0
        self.now_s = 0.0
        self._sessions: dict[str, _Session] = {}
        self._open: set[Connection] = set()
        self._retained: dict[bytes, _Message] = {}
        self._held_octets = 0
        self._heard_by: dict[bytes, list[tuple[_Session, _Subscription]]] = {}
        self._named = 0

    def connect(self, write: Callable[[bytes], None], close: Callable[[], None]) -> Connection:
        """Somebody who has come; `write` takes octets for it, `close` ends it after those."""
        connection = Connection(self, write, close)
        self.connections += 1
        self._open.add(connection)
        return connection

    def tick(self, now_s: float) -> None:
        """Time has come so far: who is silent for too long is cut off, what is over forgotten."""
        self.now_s = now_s
        for connection in [*self._open]:
            if now_s - connection.heard_s > connection.patience_s:
                connection.cut(KEEP_ALIVE, "it has been silent for too long")
        for session in [*self._sessions.values()]:
            if session.will_due_s is not None and now_s >= session.will_due_s:
                self._say_will(session)
            away_s = 0.0 if session.connection is not None else now_s - session.away_since_s
            if away_s > session.expiry_s != NEVER_S:
                self._forget(session)

    # What a connection asks for.

    def open_session(
        self, connection: Connection, client_id: str, rights: Rights, *, clean: bool, expiry_s: int
    ) -> tuple[_Session, bool]:
        """The client's session, and whether there was one before; another's connection ends."""
        if not client_id:
            self._named += 1
            client_id = f"auto-{self._named}"
        session = self._sessions.get(client_id)
        if session is not None and session.connection is not None:
            session.connection.cut(TAKEN_OVER, "another client has come with its name")
            session = self._sessions.get(client_id)
        if session is not None and clean:
            self._forget(session)
            session = None
        was_there = session is not None
        if session is None:
            session = self._sessions[client_id] = _Session(client_id, rights)
        session.rights, session.expiry_s, session.will_due_s = rights, expiry_s, None
        session.connection = connection
        self._heard_by.clear()
        return session, was_there

    def close_session(self, session: _Session, *, with_will: bool) -> None:
        """The client's connection is gone."""
        session.connection, session.away_since_s = None, self.now_s
        if not with_will:
            session.will = None
        if session.will is not None:
            delay_s = min(session.will_delay_s, session.expiry_s)
            session.will_due_s = self.now_s + delay_s
            if not delay_s:
                self._say_will(session)
        if not session.expiry_s:
            self._forget(session)

    def gone(self, connection: Connection) -> None:
        """Nothing comes of it any more."""
        if connection in self._open:
            self._open.remove(connection)
            self.connections -= 1

    def _say_will(self, session: _Session) -> None:
        will, session.will, session.will_due_s = session.will, None, None
        if will is not None:
            will.since_s = self.now_s
            self.publish(will, session)

    def _forget(self, session: _Session) -> None:
        self._say_will(session)
        self._held_octets -= session.waiting_octets
        if self._sessions.get(session.client_id) is session:
            del self._sessions[session.client_id]
        self._heard_by.clear()

    def subscribe(self, session: _Session, wanted: _Subscription, handling: int) -> None:
        """`handling` says of which retained messages it is told now: 0 all, 1 if new, 2 none."""
        is_new = wanted.filter not in session.subscriptions
        session.subscriptions[wanted.filter] = wanted
        self._heard_by.clear()
        if handling == 2 or (handling == 1 and not is_new):
            return
        for message in [*self._retained.values()]:
            topic = message.topic.decode()
            if _matches(wanted.filter, topic) and session.rights.may_hear(topic):
                qos = min(message.qos, wanted.qos)
                self._deliver(session, _Delivery(message, qos, True, wanted.number))

    def unsubscribe(self, session: _Session, topic_filter: str) -> bool:
        """Whether there was such a subscription."""
        self._heard_by.clear()
        return session.subscriptions.pop(topic_filter, None) is not None

    def publish(self, message: _Message, origin: _Session | None) -> bool:
        """Deliver to all who hear the topic; False if it should be retained and cannot be."""
        kept = not message.retain or self._retain(message)
        hearers = self._heard_by.get(message.topic)
        if hearers is None:
            hearers = self._hearers_of(message.topic)
        told: dict[str, tuple[_Session, _Delivery]] = {}
        for session, subscription in hearers:
            if subscription.no_local and session is origin:
                continue
            qos, numbers = min(message.qos, subscription.qos), subscription.number
            retain = message.retain and subscription.as_published
            if session.client_id in told:
                _, before = told[session.client_id]
                qos, retain = max(qos, before.qos), retain or before.retain
                numbers = before.numbers + numbers
            told[session.client_id] = session, _Delivery(message, qos, retain, numbers)
        for session, delivery in told.values():
            self._deliver(session, delivery)
        return kept

    def _hearers_of(self, topic_octets: bytes) -> list[tuple[_Session, _Subscription]]:
        topic = topic_octets.decode()
        found = [
            (session, subscription)
            for session in self._sessions.values()
            if session.subscriptions and session.rights.may_hear(topic)
            for subscription in session.subscriptions.values()
            if _matches(subscription.filter, topic)
        ]
        if len(self._heard_by) >= MAX_KNOWN_TOPICS:
            self._heard_by.clear()
        self._heard_by[topic_octets] = found
        return found

    def _retain(self, message: _Message) -> bool:
        before = self._retained.pop(message.topic, None)
        self._held_octets -= before.octets if before else 0
        if not message.payload:
            return True
        if self._held_octets + message.octets > self.limits.held_octets:
            return False
        self._held_octets += message.octets
        self._retained[message.topic] = message
        return True

    def _deliver(self, session: _Session, delivery: _Delivery) -> None:
        message, qos, retain, numbers = delivery
        connection = session.connection
        if connection is not None and connection.has_room and not session.waiting:
            is_new = message.expiry_s is None or self.now_s - message.since_s < 1
            if qos == 0 and is_new and not numbers:
                made = message.packet_of(connection.version, retain=retain)
                if len(made) <= connection.largest_packet:
                    connection.write(made)
                return
            if qos == 0 or len(session.unacknowledged) < connection.most_unacknowledged:
                self._write(connection, delivery)
                return
        elif connection is None and qos == 0:
            return
        octets = message.octets
        full = session.waiting_octets + octets > MAX_QUEUE_OCTETS
        if not full and self._held_octets + octets <= self.limits.held_octets:
            session.waiting.append(delivery)
            session.waiting_octets += octets
            self._held_octets += octets
            return
        if connection is not None and qos:
            connection.cut(QUOTA, "it takes what it has subscribed to too slowly")
            return
        session.dropped += 1
        if session.dropped == 1:
            self.tell(f"client {session.client_id!r} is too slow: it loses messages")

    def send_waiting(self, session: _Session) -> None:
        """What has waited goes on its way, as far as there is room."""
        connection = session.connection
        while session.waiting and connection is not None and connection.has_room:
            delivery = session.waiting[0]
            if delivery.qos and len(session.unacknowledged) >= connection.most_unacknowledged:
                return
            session.waiting.popleft()
            session.waiting_octets -= delivery.message.octets
            self._held_octets -= delivery.message.octets
            self._write(connection, delivery)

    def _write(self, connection: Connection, delivery: _Delivery) -> None:
        message, qos, retain, numbers = delivery
        session, properties, left_s = connection.session, b"", None
        if message.expiry_s is not None:
            left_s = message.expiry_s - int(self.now_s - message.since_s)
            if left_s <= 0:
                return
        if connection.version >= 5:
            properties = message.properties
            if numbers or left_s != message.expiry_s:
                properties = _rewritten(properties, left_s, numbers)
        first, number = PUBLISH | retain, b""
        if qos and session is not None:
            session.last_id = session.last_id % 0xFFFF + 1
            while session.last_id in session.unacknowledged:
                session.last_id = session.last_id % 0xFFFF + 1
            first, number = first | qos << 1, session.last_id.to_bytes(2, "big")
        octets = packet(first, _sized(message.topic), number, properties, message.payload)
        if len(octets) > connection.largest_packet:
            return
        if qos and session is not None:
            session.unacknowledged[session.last_id] = octets
        connection.write(octets)


class Connection:
    """A client's connection: `receive` its octets, `resume` when it has room again, `end` it."""

    def __init__(
        self, broker: Broker, write: Callable[[bytes], None], close: Callable[[], None]
    ) -> None:
        self.write, self._close = write, close
        self.user: str | None = None
        self.session: _Session | None = None
        self.version = 4
        self.has_room = True  # Whoever writes to it says so
        self.messages = 0  # That it has published
        self.most_unacknowledged = MAX_UNACKNOWLEDGED
        self.largest_packet = 1 << 28
        self.patience_s = CONNECT_PATIENCE_S
        self.heard_s = broker.now_s
        self.is_over = False
        self._broker = broker
        self._splitter = PacketSplitter(self._check)
        self._is_told = False

    @property
    def name(self) -> str:
        """What to call it."""
        return repr(self.session.client_id) if self.session is not None else "without a name"

    def receive(self, octets: bytes) -> None:
        """Do what the packets say that are complete with these octets."""
        if self.is_over:
            return
        self.heard_s = self._broker.now_s
        try:
            for first, body in self._splitter.split(octets):
                if self.is_over:
                    return
                self._take(first, body)
        except (BrokenPacketError, IndexError, UnicodeDecodeError) as error:
            self.cut(MALFORMED, f"it does not speak MQTT ({error or 'a packet is cut short'})")

    def resume(self, has_room: bool) -> None:
        """Whether it takes more at the moment."""
        self.has_room = has_room
        if has_room and self.session is not None:
            self._broker.send_waiting(self.session)

    def end(self, *, with_will: bool = True) -> None:
        """The connection is closed, by whomever."""
        if self.is_over:
            return
        self.is_over = True
        self._broker.gone(self)
        session, self.session = self.session, None
        if session is not None and session.connection is self:
            self._broker.close_session(session, with_will=with_will)

    def cut(self, code: int, why: str) -> None:
        """End it from here, for that reason, which is told."""
        if self.is_over:
            return
        self._broker.tell(f"client {self.name} is cut off: {why}")
        if self.version >= 5 and self.session is not None:
            self.write(packet(DISCONNECT, bytes((code,)), b"\0"))
        self.end()
        self._close()

    def _check(self, first: int, length: int) -> None:
        """Wait for no packet that may not come; raises `BrokenPacketError`."""
        most = MAX_CONNECT_OCTETS
        if self.session is not None:
            most += self._broker.limits.payload_octets
        elif first != CONNECT:
            raise BrokenPacketError("its first packet is no CONNECT")
        if length > most:
            self.cut(TOO_LARGE, f"a packet of {length} octets")

    def _take(self, first: int, body: bytes) -> None:
        session, kind = self.session, first & 0xF0
        if session is None:
            self._greet(body)
        elif kind == PUBLISH:
            self._published(session, first, body)
        elif kind in (PUBACK, PUBCOMP) or (kind == PUBREC and body[2:3] >= b"\x80"):
            session.unacknowledged.pop(_number(body), None)
            self._broker.send_waiting(session)
        elif kind == PUBREC:
            released = session.unacknowledged[_number(body)] = packet(PUBREL, body[:2])
            self.write(released)
        elif first == PUBREL:
            session.taken.discard(_number(body))
            self.write(packet(PUBCOMP, body[:2]))
        elif first == SUBSCRIBE:
            self._subscribed(session, body)
        elif first == UNSUBSCRIBE:
            self._unsubscribed(session, body)
        elif first == PINGREQ[0]:
            self.write(bytes((PINGRESP, 0)))
        elif first == DISCONNECT:
            code = body[0] if body else 0
            if self.version >= 5 and len(body) > 1:
                numbers = read_properties(body, 1)[0].numbers
                session.expiry_s = numbers.get(OF_SESSION_EXPIRY, session.expiry_s)
            self.end(with_will=code == WITH_WILL)
            self._close()
        else:
            raise BrokenPacketError(f"a packet of kind {first:#04x}")

    def _greet(self, body: bytes) -> None:
        """The CONNECT (3.1), and what is answered."""
        protocol, at = read_octets(body, 0, len(body))
        self.version, flags = body[at], body[at + 1]
        if protocol != b"MQTT" or self.version not in (4, 5) or flags & 1:
            self.version = 4 if protocol == b"MQIsdp" else 5
            self._refuse(BAD_VERSION, "it speaks another version of MQTT")
            return
        keep_alive_s, at = _number(body[at + 2 :]), at + 4
        properties, numbers = b"", dict[int, int]()
        if self.version >= 5:
            found, at = read_properties(body, at)
            numbers = found.numbers
        octets, at = read_octets(body, at, len(body))
        client_id = octets.decode()
        will, delay_s, expiry_s = None, 0, None
        if flags & WILL:
            if self.version >= 5:
                begin = at
                found, at = read_properties(body, at)
                delay_s = found.numbers.get(OF_WILL_DELAY, 0)
                properties = _rewritten(body[begin:at], None, b"")
                _, expiry_s = _end_of_properties(properties, 0)
            topic, at = read_octets(body, at, len(body))
            payload, at = read_octets(body, at, len(body))
            qos, retain = flags >> 3 & 3, bool(flags & RETAIN)
            _checked_topic(topic)
            will = _Message(*(topic, properties or b"\0", payload, qos, retain, expiry_s))
        rights = self._rights_of(flags, body, at)
        if rights is None:
            self._refuse(BAD_PASSWORD, "its name or password is not one of the broker's")
        elif not client_id and self.version < 5 and not flags & CLEAN:
            self._refuse(BAD_NAME, "it wants to be known again, and has no name")
        elif will is not None and not rights.may_publish(will.topic.decode()):
            self._refuse(NOT_AUTHORIZED, "it may not publish its will")
        elif self._broker.connections > self._broker.limits.connections:
            self._refuse(BUSY, f"{self._broker.limits.connections} are connected already")
        else:
            clean = bool(flags & CLEAN)
            expiry_s = 0 if clean else NEVER_S
            if self.version >= 5:
                expiry_s = numbers.get(OF_SESSION_EXPIRY, 0)
            most = numbers.get(RECEIVE_MAXIMUM) or MAX_UNACKNOWLEDGED
            self.most_unacknowledged = min(MAX_UNACKNOWLEDGED, most)
            self.largest_packet = numbers.get(MAXIMUM_PACKET_SIZE) or self.largest_packet
            self.patience_s = 1.5 * keep_alive_s if keep_alive_s else float("inf")
            session, was_there = self._broker.open_session(
                self, client_id, rights, clean=clean, expiry_s=expiry_s
            )
            self.session, session.will, session.will_delay_s = session, will, delay_s
            self._welcome(session, was_there, is_named=bool(client_id))

    def _rights_of(self, flags: int, body: bytes, at: int) -> Rights | None:
        """What the name at that place of a CONNECT may do with its password; None if not let in."""
        name, password = b"", b""
        if flags & USERNAME:
            name, at = read_octets(body, at, len(body))
        if flags & PASSWORD:
            password, at = read_octets(body, at, len(body))
        known = self._broker.users.get(name.decode())
        if known is None:
            # Who may come without a name may come with any, as long as it is none of the users'.
            return self._broker.anonymous
        self.user = name.decode()
        return known.rights if hmac.compare_digest(known.password.encode(), password) else None

    def _welcome(self, session: _Session, was_there: bool, *, is_named: bool) -> None:
        """The CONNACK (3.2), and what the client has not acknowledged or heard yet."""
        properties = b""
        if self.version >= 5:
            most = MAX_CONNECT_OCTETS + self._broker.limits.payload_octets
            properties = bytes((MAXIMUM_PACKET_SIZE,)) + most.to_bytes(4, "big")
            properties += bytes((RECEIVE_MAXIMUM,)) + MAX_UNACKNOWLEDGED.to_bytes(2, "big")
            properties += b"\x2a\x00"  # no shared subscriptions
            if not is_named:
                properties += b"\x12" + packed_text(session.client_id)
            properties = varint(len(properties)) + properties
        self.write(packet(CONNACK, bytes((was_there, 0)), properties))
        for octets in session.unacknowledged.values():
            again = octets[0] | (8 if octets[0] < PUBREL else 0)
            self.write(bytes((again,)) + octets[1:])
        self._broker.send_waiting(session)

    def _refuse(self, code: int, why: str) -> None:
        self._broker.tell(f"a client is not let in: {why}")
        of_3 = self.version < 5
        self.write(
            packet(
                CONNACK,
                bytes((0, CODES_OF_3.get(code, 5) if of_3 else code)),
                b"" if of_3 else b"\0",
            )
        )
        self.end()
        self._close()

    def _published(self, session: _Session, first: int, body: bytes) -> None:
        """A PUBLISH of the client (3.3)."""
        self.messages += 1
        qos, end = first >> 1 & 3, 2 + _number(body)
        topic, place = body[2:end], end + (2 if qos else 0)
        if qos == 3 or place > len(body):
            raise BrokenPacketError("a PUBLISH that is cut short")
        properties, expiry_s = b"\0", None
        if self.version >= 5:
            behind, expiry_s = _end_of_properties(body, place)
            properties, place = body[place:behind], behind
        number = body[end : end + 2] if qos else b""
        name = _checked_topic(topic)
        message = _Message(
            *(topic, properties, body[place:], qos, bool(first & 1), expiry_s, self._broker.now_s)
        )
        code = 0
        if len(message.payload) > self._broker.limits.payload_octets:
            self.cut(TOO_LARGE, f"a payload of {len(message.payload)} octets")
            return
        if not session.rights.may_publish(name):
            code = NOT_AUTHORIZED
        elif qos < 2 or _number(number) not in session.taken:
            code = 0 if self._broker.publish(message, session) else QUOTA
        if code and not self._is_told:
            self._is_told = True
            self._broker.tell(
                f"client {self.name} may not publish on {name!r}: {reason_name(code)}"
            )
        if qos and not self.is_over:
            answer = number + bytes((code,)) if self.version >= 5 and code else number
            if qos == 2 and not code:
                session.taken.add(_number(number))
                if len(session.taken) > MAX_UNACKNOWLEDGED:
                    self.cut(TOO_MANY, "it has more on its way than it may (QoS 2)")
                    return
            self.write(packet(PUBACK if qos == 1 else PUBREC, answer))

    def _subscribed(self, session: _Session, body: bytes) -> None:
        """A SUBSCRIBE (3.8)."""
        number, at, name = body[:2], 2, b""
        if self.version >= 5:
            found, at = read_properties(body, at)
            if OF_SUBSCRIPTION in found.numbers:
                name = bytes((OF_SUBSCRIPTION,)) + varint(found.numbers[OF_SUBSCRIPTION])
        wanted: list[tuple[_Subscription, int]] = []
        codes = bytearray()
        while at < len(body):
            octets, at = read_octets(body, at, len(body))
            options, at, topic_filter = body[at], at + 1, octets.decode()
            if options & 3 == 3:
                raise BrokenPacketError("a subscription with QoS 3")
            code = self._refusal_of(session, topic_filter)
            codes.append(code or options & 3)
            if not code:
                of_5 = self.version >= 5
                subscription = _Subscription(
                    topic_filter,
                    options & 3,
                    no_local=of_5 and bool(options & 4),
                    as_published=of_5 and bool(options & 8),
                    number=name,
                )
                wanted.append((subscription, options >> 4 & 3 if of_5 else 0))
        if not codes or not _number(number):
            raise BrokenPacketError("a SUBSCRIBE without filters or number")
        of_3 = self.version < 5
        said = bytes(0x80 if of_3 and code >= 0x80 else code for code in codes)
        self.write(packet(SUBACK, number, b"" if of_3 else b"\0", said))
        for subscription, handling in wanted:
            self._broker.subscribe(session, subscription, handling)

    def _refusal_of(self, session: _Session, topic_filter: str) -> int:
        """The reason code with which a filter is refused; 0 if it is not."""
        try:
            checked_topic_filter(topic_filter)
        except PlotfeedError:
            return BAD_FILTER
        if not topic_filter or "\0" in topic_filter:
            return BAD_FILTER
        if topic_filter.startswith("$share/"):
            return NOT_SHARED
        is_topic = not {"+", "#"} & {*topic_filter.split("/")}
        if is_topic and not session.rights.may_hear(topic_filter):
            self._broker.tell(f"client {self.name} may not hear {topic_filter!r}")
            return NOT_AUTHORIZED
        return 0 if len(session.subscriptions) < MAX_FILTERS else QUOTA

    def _unsubscribed(self, session: _Session, body: bytes) -> None:
        """An UNSUBSCRIBE (3.10)."""
        number, at, of_5 = body[:2], 2, self.version >= 5
        if of_5:
            _, at = read_properties(body, at)
        codes = bytearray()
        while at < len(body):
            octets, at = read_octets(body, at, len(body))
            codes.append(0 if self._broker.unsubscribe(session, octets.decode()) else NO_SUCH)
        self.write(packet(UNSUBACK, number, b"\0" + codes if of_5 else b""))


def _one_of(topic: str, filters: Sequence[str]) -> bool:
    return any(topic_matches(each, topic) for each in filters)


def _sized(octets: bytes) -> bytes:
    return len(octets).to_bytes(2, "big") + octets


def _number(octets: bytes) -> int:
    if len(octets) < 2:
        raise BrokenPacketError("a packet without its number")
    return octets[0] << 8 | octets[1]


def _matches(topic_filter: str, topic: str) -> bool:
    """Whether the filter is for the topic; those of the broker's own, at $, are asked by name."""
    if topic[0] == "$" and topic_filter[0] in "+#":
        return False
    return topic_matches(topic_filter, topic)


def _checked_topic(octets: bytes) -> str:
    """The topic of a PUBLISH; raises `BrokenPacketError`."""
    topic = octets.decode()
    if not topic or "\0" in topic or "+" in topic or "#" in topic:
        raise BrokenPacketError("a PUBLISH with no topic, or a filter in its place")
    return topic


def _end_of_properties(data: bytes, at: int) -> tuple[int, int | None]:
    """Where a PUBLISH's properties end, and after how many seconds it expires, if it does.

    Texts have to be UTF-8: what comes of one client is passed on to others. Raises
    `BrokenPacketError`, IndexError or UnicodeDecodeError.
    """
    length, place = read_length(data, at)
    end = place + length
    if end > len(data):
        raise BrokenPacketError("properties that are longer than their packet")
    expiry_s = None
    while place < end:
        kind, place = data[place], place + 1
        if kind == OF_USER or kind in TEXTS:
            for _ in range(2 if kind == OF_USER else 1):
                behind = place + 2 + (data[place] << 8 | data[place + 1])
                if kind != OF_CORRELATION:
                    data[place + 2 : behind].decode()
                place = behind
        elif kind in (OF_EXPIRY, OF_FORMAT):
            octets = data[place : place + NUMBERS[kind]]
            place += NUMBERS[kind]
            expiry_s = int.from_bytes(octets, "big") if kind == OF_EXPIRY else expiry_s
        else:
            raise BrokenPacketError(f"a PUBLISH with property {kind:#04x}")
    if place != end:
        raise BrokenPacketError("properties that are longer than they say")
    return end, expiry_s


def _rewritten(properties: bytes, left_s: int | None, numbers: bytes) -> bytes:
    """Properties of a PUBLISH with the time that is left to it, and numbers of subscriptions.

    What only a will has, its delay, is left out.
    """
    length, place = read_length(properties, 0)
    kept = bytearray(numbers)
    end = place + length
    while place < end:
        begin, kind, place = place, properties[place], place + 1
        if kind in NUMBERS:
            place += NUMBERS[kind]
        else:
            for _ in range(2 if kind == OF_USER else 1):
                place += 2 + _number(properties[place:])
        if kind == OF_EXPIRY and left_s is not None:
            kept += properties[begin : begin + 1] + left_s.to_bytes(4, "big")
        elif kind != OF_WILL_DELAY:
            kept += properties[begin:place]
    return varint(len(kept)) + kept

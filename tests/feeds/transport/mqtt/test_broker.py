"""The embedded broker as a function: what clients of both versions are told, and bear."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from hypothesis import example, given
from hypothesis import strategies as st

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.transport.mqtt.broker import (
    MAX_QUEUE_OCTETS,
    Broker,
    BrokerLimits,
    Connection,
    Rights,
)
from plotfeed.feeds.transport.mqtt.packets import (
    EXPIRY,
    BrokerAnswer,
    BrokerReader,
    Publication,
    acknowledgements,
    connect_packet,
    packet,
    publish_packet,
    subscribe_packet,
)

PINGREQ, SUBACK = b"\xc0\x00", 0x90


Told = TypeVar("Told", Publication, BrokerAnswer)


class Peer:
    """A client of a broker, and what it was told."""

    def __init__(self, broker: Broker, version: int, hello: bytes | None = None) -> None:
        self.version, self.octets, self.is_closed = version, bytearray(), False
        self.connection: Connection = broker.connect(self.octets.extend, self._close)
        self._reader, self._read = BrokerReader(version), 0
        name = f"c{id(self)}"
        self.say(connect_packet(name, version, keep_alive_s=60) if hello is None else hello)

    def _close(self) -> None:
        self.is_closed = True

    def say(self, octets: bytes) -> None:
        self.connection.receive(octets)

    def told(self, kind: type[Told]) -> list[Told]:
        """What has come of that kind since anything was asked for the last time."""
        new = bytes(self.octets[self._read :])
        self._read = len(self.octets)
        return [told for told in self._reader.receive(new) if isinstance(told, kind)]

    def heard(self) -> list[tuple[str, bytes]]:
        return [(p.topic, p.payload) for p in self.told(Publication)]

    def subscribe(self, *filters: str) -> None:
        for number, topic_filter in enumerate(filters, 1):
            self.say(subscribe_packet(number, topic_filter, self.version))

    def publish(self, topic: str, payload: bytes = b"x", **more: object) -> None:
        number = more.pop("number", None)
        message = Message(topic, payload, "text/plain", 0, (("k", "v"),), **more)  # type: ignore[arg-type]
        self.say(publish_packet(message, self.version, number=number))  # type: ignore[arg-type]


def broker(**more: object) -> Broker:
    return Broker(anonymous=Rights(), **more)  # type: ignore[arg-type]


def matches(topic_filter: Sequence[str], topic: Sequence[str]) -> bool:
    """As 4.7 says it, level by level."""
    if not topic_filter:
        return not topic
    head, *rest = topic_filter
    if head == "#":
        return True
    return bool(topic) and head in ("+", topic[0]) and matches(rest, topic[1:])


levels = st.lists(st.sampled_from(["a", "b", "", "$x"]), min_size=1, max_size=4)
filters = st.tuples(
    st.lists(st.sampled_from(["a", "b", "", "+", "$x"]), max_size=3),
    st.sampled_from([["#"], ["+"], ["a"], [""]]),
).map(lambda parts: [*parts[0], *parts[1]])


versions = st.sampled_from([4, 5])


@given(topic_filter=filters, topic=levels, retained=st.booleans(), origin=versions, to=versions)
@example(topic_filter=["#"], topic=["$x"], retained=True, origin=5, to=4)
def test_who_has_subscribed_to_a_topic_hears_it_with_what_a_version_can_carry_and_nobody_else(
    topic_filter: list[str], topic: list[str], retained: bool, origin: int, to: int
) -> None:
    name, wanted = "/".join(topic), "/".join(topic_filter)
    if not name or not wanted:
        return
    one = broker()
    ears, voice = Peer(one, to), Peer(one, origin)
    if retained:
        voice.publish(name, retain=True)
        ears.subscribe(wanted)
    else:
        ears.subscribe(wanted)
        voice.publish(name)
    hidden = name.startswith("$") and wanted[0] in "+#"
    heard = ears.told(Publication)
    assert len(heard) == (matches(topic_filter, topic) and not hidden)
    for publication in heard:
        assert (publication.topic, publication.payload) == (name, b"x")
        said = publication.properties.pairs, publication.properties.content_type
        assert said == (((("k", "v"),), "text/plain") if origin == to == 5 else ((), None))


@given(octets=st.binary(max_size=200), version=versions, greets=st.booleans())
@example(octets=b"\xf0\x00", version=5, greets=True)  # an AUTH
def test_rubbish_ends_its_own_connection_at_most(octets: bytes, version: int, greets: bool) -> None:
    one = broker()
    ears = Peer(one, 5)
    ears.subscribe("#")
    hello = connect_packet("rubbish", version, keep_alive_s=60)
    rubbish = Peer(one, version, (hello if greets else b"") + octets)
    assert rubbish.is_closed == rubbish.connection.is_over
    ears.heard()
    Peer(one, 4).publish("still/here")
    assert ears.heard() == [("still/here", b"x")]


def test_qos_1_is_sent_again_with_the_same_number_until_it_is_acknowledged() -> None:
    one = broker()
    # A session that stays (3.1.1: not clean) is named.
    hello = bytearray(connect_packet("me", 4, keep_alive_s=60))
    hello[9] &= ~2
    ears, voice = Peer(one, 4, bytes(hello)), Peer(one, 5)
    ears.subscribe("a")
    voice.publish("a", b"1", number=1)
    (first,) = ears.told(Publication)
    ears.connection.end()
    voice.publish("a", b"2", number=2)
    again = Peer(one, 4, bytes(hello))
    numbers = {p.payload: p.number for p in again.told(Publication)}
    assert numbers[b"1"] == first.number
    assert numbers.keys() == {b"1", b"2"}
    again.say(acknowledgements(filter(None, numbers.values())))
    again.connection.end()
    assert not Peer(one, 4, bytes(hello)).heard()


def test_no_two_messages_on_their_way_have_one_number() -> None:
    one = broker()
    ears, voice = Peer(one, 5), Peer(one, 5)
    ears.subscribe("a")
    voice.publish("a", number=1)
    assert ears.connection.session is not None
    ears.connection.session.last_id = 0xFFFE  # some 65,000 messages later
    for number in (2, 3):
        voice.publish("a", number=number)
    assert [p.number for p in ears.told(Publication)] == [1, 0xFFFF, 2]


def test_a_last_will_is_said_of_who_goes_without_a_goodbye() -> None:
    one = broker()
    ears = Peer(one, 5)
    ears.subscribe("will")
    will = Message("will", b"gone", "", 0)
    for version in (4, 5):
        left, lost = (
            Peer(one, version, connect_packet(name, version, will=will, keep_alive_s=2))
            for name in ("left", "lost")
        )
        left.say(b"\xe0\x00")
        assert not ears.heard()
        lost.connection.end()
        assert ears.heard() == [("will", b"gone")]
    Peer(one, 5, connect_packet("silent", 5, will=will, keep_alive_s=2))
    ears.say(PINGREQ)
    one.tick(2.9)
    ears.say(PINGREQ)
    assert not ears.heard()
    one.tick(3.1)
    assert ears.heard() == [("will", b"gone")]


def test_what_is_kept_for_a_while_says_how_long_it_has_left_and_then_is_gone() -> None:
    one = broker()
    voice = Peer(one, 5)
    message = Message("a", b"x", "", 0)
    octets = bytearray(publish_packet(message, 5).replace(EXPIRY, b"\x02" + bytes([0, 0, 0, 30])))
    octets[0] |= 1  # which publish_packet leaves without an end
    voice.say(bytes(octets))
    for now_s, left in ((10.0, [20]), (29.0, [1]), (31.0, [])):
        one.tick(now_s)
        later = Peer(one, 5)
        later.subscribe("a")
        assert [p.properties.numbers[2] for p in later.told(Publication)] == left
        voice.say(PINGREQ)


def test_a_slow_client_loses_messages_of_its_own_alone_and_is_told_of() -> None:
    lines: list[str] = []
    one = broker(tell=lines.append)
    slow, ears, voice = Peer(one, 4), Peer(one, 5), Peer(one, 5)
    slow.subscribe("#")
    ears.subscribe("#")
    slow.connection.resume(has_room=False)
    payload, sent = bytes(1 << 20), 0
    while not lines:
        voice.publish("a", payload)
        sent += 1
        assert sent <= MAX_QUEUE_OCTETS >> 20
    assert len(ears.heard()) == sent
    slow.connection.resume(has_room=True)
    assert len(slow.heard()) == sent - 1
    assert "too slow" in lines[0]
    for _ in range(2):  # what has gone takes no room any more
        slow.connection.resume(has_room=False)
        for _ in range(sent - 1):
            voice.publish("a", payload)
        slow.connection.resume(has_room=True)
        assert len(slow.heard()) == sent - 1


def test_retained_messages_of_all_clients_together_have_a_bound() -> None:
    lines: list[str] = []
    one = broker(limits=BrokerLimits(held_octets=100_000), tell=lines.append)
    voice = Peer(one, 5)
    for number in range(20):
        voice.publish(f"kept/{number}", bytes(10_000), retain=True)
    ears = Peer(one, 5)
    ears.subscribe("kept/#")
    assert len(ears.heard()) == 9  # of 10,000 octets and what they cost besides
    assert len(lines) == 1
    for number in range(20):
        voice.publish(f"kept/{number}", b"", retain=True)
    voice.publish("kept/again", bytes(90_000), retain=True)
    later = Peer(one, 5)
    later.subscribe("kept/#")
    assert len(later.heard()) == 1


def test_connections_and_payloads_beyond_a_limit_are_turned_away_and_nobody_else() -> None:
    lines: list[str] = []
    one = broker(limits=BrokerLimits(connections=3, payload_octets=1000), tell=lines.append)
    ears, voice = Peer(one, 5), Peer(one, 4)
    ears.subscribe("#")
    for version, code in ((5, b"\x89"), (4, b"\3")):
        Peer(one, 5).connection.end()
        held, late = Peer(one, 5), Peer(one, version)
        (answer,) = late.told(BrokerAnswer)
        assert (answer.codes, late.is_closed) == (code, True)
        held.connection.end()
    voice.publish("small", bytes(1000))
    voice.publish("large", bytes(1001))
    assert voice.is_closed
    assert [topic for topic, _ in ears.heard()] == ["small"]
    Peer(one, 4).say(b"\x30\xff\xff\xff\x7f")  # too long to be waited for
    assert [("cut off: a p" in line) for line in lines] == [False, False, True, True]


def test_rights_hold_for_what_is_published_subscribed_and_retained() -> None:
    lines: list[str] = []
    one = Broker(anonymous=Rights(publishes_not=["p/#"], hears_not=["p/truth"]), tell=lines.append)
    client = Peer(one, 5)
    client.publish("p/control", number=9)
    assert client.told(BrokerAnswer)[-1].codes == b"\x87"
    assert len(lines) == 1
    client.subscribe("p/truth", "p/#")
    assert [a.codes for a in client.told(BrokerAnswer)] == [b"\x87", b"\x01"]


def test_a_client_with_the_name_of_another_takes_its_place() -> None:
    one = broker()
    first = Peer(one, 5, connect_packet("same", 5, keep_alive_s=60))
    second = Peer(one, 5, connect_packet("same", 5, keep_alive_s=60))
    assert first.is_closed
    assert first.told(BrokerAnswer)[-1].codes == b"\x8e"
    assert not second.is_closed
    assert one.connections == 1


def test_subscriptions_that_overlap_bring_a_message_once_and_nobody_hears_a_filter_amiss() -> None:
    one = broker()
    ears = Peer(one, 5)
    ears.subscribe("a/+", "a/#", "a/b")
    Peer(one, 4).publish("a/b")
    assert ears.heard() == [("a/b", b"x")]
    for amiss in ("a/#/b", "a+", "", "$share/g/a"):
        ears.say(subscribe_packet(9, amiss, 5))
        (answer,) = ears.told(BrokerAnswer)
        assert (answer.kind, answer.codes[0] >= 0x80) == (SUBACK, True)
    ears.say(packet(0x82, b"\0\1\0"))  # with no filter at all
    assert ears.is_closed

"""PUBLISH packets, of which there are thousands a second.

gmqtt packs each property anew, in a tenth of a millisecond a message, and those of our messages are
mostly the same ones again.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

from plotfeed.feeds.messages.message import MESSAGE_EXPIRY_S, Message
from plotfeed.feeds.messages.user_properties import packed_text, pieces_of
from plotfeed.proto.varint import varint

FIRST = {(qos, retain): bytes((0x30 | qos << 1 | retain,)) for qos in (0, 1) for retain in (0, 1)}
"""Their first octets, by QoS and whether they are retained."""
EXPIRY, CONTENT_TYPE = b"\x02", b"\x03"


def pack(messages: Iterable[Message], version: int) -> None:
    """Have messages of QoS 0 hold their packets for a version; others need an id of their own."""
    for message in messages:
        if not message.qos:
            message.packets[version] = publish_packet(message, version)


def publish_packet(
    message: Message, version: int, expiry_s: int = MESSAGE_EXPIRY_S, *, number: int | None = None
) -> bytes:
    """The packet of a message for that version; what is retained does not expire.

    With `number` as its id it is of QoS 1, without of QoS 0. MQTT 3.1.1, section 3.3, and MQTT 5.0,
    sections 2.2.2 and 3.3.
    """
    first = FIRST[number is not None, message.retain]
    topic, payload = packed_text(message.topic), message.payload
    if number is not None:
        topic += number.to_bytes(2, "big")  # they stand one behind the other
    if version < 5:
        return b"".join((first, varint(len(topic) + len(payload)), topic, payload))
    content_type = _content_type(message.content_type)
    octets, properties = pieces_of(message.properties)
    expiry = b"" if message.retain else _expiry(expiry_s)
    octets += len(content_type) + len(expiry)
    length = varint(octets)
    rest = varint(len(topic) + len(length) + octets + len(payload))
    return b"".join((first, rest, topic, length, content_type, *properties, expiry, payload))


@lru_cache(maxsize=256)
def _content_type(text: str) -> bytes:
    return CONTENT_TYPE + packed_text(text)


@lru_cache(maxsize=256)
def _expiry(expiry_s: int) -> bytes:
    return EXPIRY + expiry_s.to_bytes(4, "big")

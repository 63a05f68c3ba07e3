"""PUBLISH packets of QoS 0, the only ones of which there are thousands a second.

gmqtt packs each property anew, in a tenth of a millisecond a message, and those of our messages are
mostly the same ones again.
"""

from __future__ import annotations

from functools import lru_cache

from plotfeed.feeds.messages.message import MESSAGE_EXPIRY_S, Message

PUBLISH, RETAIN = 0x30, 0x01
EXPIRY, CONTENT_TYPE, USER_PROPERTY = b"\x02", b"\x03", b"\x26"


def publish_packet(message: Message, version: int, expiry_s: int = MESSAGE_EXPIRY_S) -> bytes:
    """The packet of a message of QoS 0 for that version; what is retained does not expire.

    MQTT 3.1.1, section 3.3, and MQTT 5.0, sections 2.2.2 and 3.3.
    """
    topic = _text(message.topic)
    rest = topic + message.payload
    if version >= 5:
        properties = _properties(message, expiry_s)
        rest = b"".join((topic, _varint(len(properties)), properties, message.payload))
    return bytes((PUBLISH | (RETAIN if message.retain else 0),)) + _varint(len(rest)) + rest


def _properties(message: Message, expiry_s: int) -> bytes:
    parts = [_content_type(message.content_type)]
    parts += [_user_property(name, value) for name, value in message.properties]
    if not message.retain:
        parts.append(EXPIRY + expiry_s.to_bytes(4, "big"))
    return b"".join(parts)


@lru_cache(maxsize=256)
def _content_type(text: str) -> bytes:
    return CONTENT_TYPE + _text(text)


@lru_cache(maxsize=4096)
def _user_property(name: str, value: str) -> bytes:
    return USER_PROPERTY + _text(name) + _text(value)


@lru_cache(maxsize=4096)
def _text(text: str) -> bytes:
    octets = text.encode()
    return len(octets).to_bytes(2, "big") + octets


def _varint(number: int) -> bytes:
    """Seven bits an octet, the lowest first; the highest bit says that more follow."""
    if number < 128:
        return bytes((number,))
    octets = bytearray()
    while True:
        number, low = number >> 7, number & 0x7F
        octets.append(low | (0x80 if number else 0))
        if not number:
            return bytes(octets)

"""Numbers of no fixed length, as protobuf and the headers of MQTT have them."""

from __future__ import annotations

from functools import lru_cache


@lru_cache(maxsize=4096)
def varint(number: int) -> bytes:
    """Seven bits an octet, the lowest first; the highest bit says that more follow.

    A negative number is one of 64 bits in two's complement, as protobuf has it.
    """
    number &= 0xFFFF_FFFF_FFFF_FFFF
    octets = bytearray()
    while number > 0x7F:
        octets.append(number & 0x7F | 0x80)
        number >>= 7
    octets.append(number)
    return bytes(octets)

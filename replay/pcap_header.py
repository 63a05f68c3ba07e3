"""What the first octets of a capture of libpcap say of all its packets."""

from __future__ import annotations

import base64
import struct
from functools import lru_cache
from typing import NamedTuple

from plotfeed.replay.link_layers import LINK_TYPES

HEADER_OCTETS, RECORD_OCTETS = 24, 16
MAX_PACKET_OCTETS = 1 << 18
"""As captures have it at most; a datagram is shorter."""
FORMATS = {
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\x3c\x4d": (">", 1),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
}
"""Byte order and nanoseconds of a fraction by the first octets of a file."""
_MAGIC_NS = 0xA1B23C4D
_LINK_TYPE_MASK = 0xFFFF  # above it is what a frame check sequence is like


class PcapHeader(NamedTuple):
    """The header of a file."""

    octets: bytes
    unit_ns: int
    """Of the fractions of seconds."""
    link_type: int
    snap_octets: int
    """Of a packet at most; 0 is all."""
    record: struct.Struct
    """Of a packet: seconds, fraction, octets that are there, octets that it had."""

    @property
    def text(self) -> str:
        """In base64, as a property of messages has it."""
        return base64.b64encode(self.octets).decode("ascii")


def header_of(octets: bytes) -> PcapHeader | None:
    """What these octets say; None if they are not the header of a pcap."""
    if len(octets) != HEADER_OCTETS or octets[:4] not in FORMATS:
        return None
    order, unit_ns = FORMATS[octets[:4]]
    snap_octets, network = struct.unpack_from(f"{order}II", octets, 16)
    record = struct.Struct(f"{order}IIII")
    return PcapHeader(octets, unit_ns, network & _LINK_TYPE_MASK, snap_octets, record)


@lru_cache(maxsize=64)
def header_of_text(text: str) -> PcapHeader | None:
    """Of a property; None if it is none, or of packets that cannot be read."""
    try:
        found = header_of(base64.b64decode(text, validate=True))
    except ValueError:
        return None
    return found if found is not None and found.link_type in LINK_TYPES else None


@lru_cache(maxsize=64)
def ns_header(link_type: int) -> PcapHeader:
    """Of a new file, whose times are of nanoseconds."""
    octets = struct.pack("<IHHiIII", _MAGIC_NS, 2, 4, 0, 0, MAX_PACKET_OCTETS, link_type)
    return PcapHeader(octets, 1, link_type, MAX_PACKET_OCTETS, struct.Struct("<IIII"))

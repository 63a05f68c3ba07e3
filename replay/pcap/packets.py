"""Captured packets as messages, and what a packet says besides its payload, as properties."""

from __future__ import annotations

import base64
import struct
from functools import lru_cache
from typing import BinaryIO, NamedTuple
from zlib import crc32

from plotfeed.proto.errors import DecodeError
from plotfeed.replay.asterix_blocks import content_type
from plotfeed.replay.pcap.link_layers import (
    LINK_TYPES,
    Datagram,
    datagram_in,
    with_payload,
)
from plotfeed.replay.recorded import LATEST_NS, UDP_TOPIC, OctetsReader, Recorded

FILE, HEAD, TAIL = "pcap-file", "pcap-head", "pcap-tail"
"""In base64: the header of the file, what is before the payload, what is behind it if anything."""
LENGTH = "pcap-length"
"""Octets of the packet before it was cut; only where it was."""
PAYLOAD_CRC = "pcap-payload-crc"
"""CRC-32 of the payload in hexadecimal, which tells whether it is still that of the packet."""

SOURCE = "udp-source"
"""The property that says who sent a datagram: ADDRESS/PORT."""

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
    """The header in a property; None if it is none, or of packets that cannot be read."""
    try:
        found = header_of(base64.b64decode(text, validate=True))
    except ValueError:
        return None
    return found if found is not None and found.link_type in LINK_TYPES else None


@lru_cache(maxsize=64)
def ns_header(link_type: int) -> PcapHeader:
    """The header of a new file, whose times are of nanoseconds."""
    octets = struct.pack("<IHHiIII", _MAGIC_NS, 2, 4, 0, 0, MAX_PACKET_OCTETS, link_type)
    return PcapHeader(octets, 1, link_type, MAX_PACKET_OCTETS, struct.Struct("<IIII"))


class KeptPacket(NamedTuple):
    """A packet without its payload."""

    header: PcapHeader
    """Of the file that it was in."""
    head: bytes
    tail: bytes
    length: int | None
    payload_crc: int

    def with_payload(self, payload: bytes) -> tuple[bytes, int]:
        """The packet, and its octets before it was cut.

        With another payload, lengths and checksums are of that, and there is no tail. No octets
        if that makes no packet, or one that is longer than those of its file may be.
        """
        if crc32(payload) == self.payload_crc:
            packet = self.head + payload + self.tail
            return packet, len(packet) if self.length is None else self.length
        packet = with_payload(self.header.link_type, self.head, payload)
        if 0 < self.header.snap_octets < len(packet):
            return b"", 0
        return packet, len(packet)


def properties_of(
    header: PcapHeader, packet: bytes, length: int, found: Datagram
) -> tuple[tuple[str, str], ...]:
    """Properties of a packet that had `length` octets before it was cut, and of its datagram."""
    tail = packet[found.payload_at + len(found.payload) :]
    return (
        (FILE, _text(header.octets)),
        (HEAD, _text(packet[: found.payload_at])),
        (PAYLOAD_CRC, f"{crc32(found.payload):08x}"),
        *(((TAIL, _text(tail)),) if tail else ()),
        *(((LENGTH, str(length)),) if length != len(packet) else ()),
    )


def kept_in(properties: tuple[tuple[str, str], ...]) -> KeptPacket | None:
    """The packet that these are of; None if they are of none."""
    found = dict(properties)
    header = header_of_text(found.get(FILE, ""))
    if header is None or HEAD not in found:
        return None
    try:
        head = base64.b64decode(found[HEAD], validate=True)
        tail = base64.b64decode(found.get(TAIL, ""), validate=True)
        length = int(found[LENGTH][:11]) if LENGTH in found else None
        payload_crc = int(found.get(PAYLOAD_CRC, "")[:8], 16)
    except ValueError:
        return None
    if length is not None and not 0 <= length < 1 << 32:
        return None
    return KeptPacket(header, head, tail, length, payload_crc)


def _text(octets: bytes) -> str:
    return base64.b64encode(octets).decode("ascii")


class PacketReader(OctetsReader):
    """Makes messages of packets; notes those that are broken and counts those that are not UDP."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file)
        self._skipped = 0

    @property
    def skipped(self) -> int:
        """Packets that hold no UDP."""
        return self._skipped

    def check_link_type(self, link_type: int, at: int) -> None:
        """Note at that offset that none of its packets can be read."""
        if link_type not in LINK_TYPES:
            expected = ", ".join(map(str, LINK_TYPES))
            self.damage.add(at, f"packets of link type {link_type}; expected one of {expected}")

    def message(
        self, header: PcapHeader, packet: bytes, length: int, t_utc_ns: int, at: int
    ) -> Recorded | None:
        """The message in a packet that was captured at that time; None if it has none.

        `header` is of a pcap that holds it, `length` its octets before it was cut.
        """
        try:
            found = datagram_in(header.link_type, packet)
        except DecodeError as error:
            self.damage.add(at, str(error))
            return None
        if found is None:
            self._skipped += 1
            return None
        if not 0 <= t_utc_ns <= LATEST_NS:
            self.damage.add(at, f"a packet of {t_utc_ns} ns since 1970; expected 1970 to 2554")
            return None
        return Recorded(
            topic=f"{UDP_TOPIC}{found.destination}/{found.port}",
            payload=found.payload,
            log_time_ns=t_utc_ns,
            publish_time_ns=t_utc_ns,
            content_type=content_type(found.payload),
            properties=(
                (SOURCE, f"{found.source}/{found.source_port}"),
                *properties_of(header, packet, length, found),
            ),
        )

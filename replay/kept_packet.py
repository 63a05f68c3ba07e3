"""What a packet says besides its payload, as properties of its message, and the packet again."""

from __future__ import annotations

import base64
from typing import NamedTuple
from zlib import crc32

from plotfeed.proto.errors import DecodeError
from plotfeed.replay.frames import with_payload
from plotfeed.replay.link_layers import Datagram, datagram_in
from plotfeed.replay.pcap_header import MAX_PACKET_OCTETS, PcapHeader, header_of_text

FILE, HEAD, TAIL = "pcap-file", "pcap-head", "pcap-tail"
"""In base64: the header of the file, what is before the payload, what is behind it if anything."""
LENGTH = "pcap-length"
"""Octets of the packet before it was cut; only where it was."""
PAYLOAD_CRC = "pcap-payload-crc"
"""CRC-32 of the payload in hexadecimal, which tells whether it is still that of the packet."""


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
    """Of a packet that had so many octets before it was cut, and the datagram in it."""
    tail = packet[found.payload_at + len(found.payload) :]
    return (
        (FILE, header.text),
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


def datagram_of(link_type: int, packet: bytes) -> Datagram | None:
    """The datagram of a packet; None if it has none or cannot be read."""
    if len(packet) > MAX_PACKET_OCTETS:
        return None
    try:
        return datagram_in(link_type, packet)
    except DecodeError:
        return None


def _text(octets: bytes) -> str:
    return base64.b64encode(octets).decode("ascii")

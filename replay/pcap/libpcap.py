"""Packet captures of libpcap: read and written in either byte order, µs or ns."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from ipaddress import ip_address
from typing import BinaryIO

from plotfeed.proto.errors import DecodeError
from plotfeed.proto.utc import NS
from plotfeed.replay.asterix_blocks import is_asterix
from plotfeed.replay.pcap.link_layers import ETHERNET, datagram_in, frame, holds
from plotfeed.replay.pcap.packets import (
    FORMATS,
    HEADER_OCTETS,
    MAX_PACKET_OCTETS,
    RECORD_OCTETS,
    SOURCE,
    KeptPacket,
    PacketReader,
    PcapHeader,
    header_of,
    kept_in,
    ns_header,
)
from plotfeed.replay.recorded import UDP_TOPIC, Recorded, RecordingWriter

ASTERIX_PORT = 8600
"""Of UDP, where Wireshark takes it for ASTERIX."""
MAX_PAYLOAD_OCTETS = 65_507
MAX_TOPICS = 1 << 16


class PcapReader(PacketReader):
    """The UDP datagrams of a capture. Nothing tells where a packet begins after a broken length."""

    def messages(self) -> Iterator[Recorded]:
        """Each datagram, on the topic udp/ADDRESS/PORT of where it went."""
        beginning = self._octets.take(HEADER_OCTETS)
        if beginning[:4] not in FORMATS:
            self.damage.add(0, f"{beginning[:4].hex()!r}; expected the first octets of a pcap")
            return
        header = header_of(beginning)
        if header is None:
            self.damage.add(0, f"a header of {len(beginning)} octets; it has {HEADER_OCTETS}")
            return
        self.check_link_type(header.link_type, 20)
        yield from self._records(header)

    def _records(self, header: PcapHeader) -> Iterator[Recorded]:
        octets = self._octets
        while True:
            at = octets.at
            record = octets.take(RECORD_OCTETS)
            if len(record) < RECORD_OCTETS:
                if record:
                    self.damage.add(at, "the file ends within the header of a packet")
                return
            seconds, fraction, captured, length = header.record.unpack(record)
            if captured > MAX_PACKET_OCTETS:
                self.damage.add(at, f"a packet of {captured} octets; at most {MAX_PACKET_OCTETS}")
                return
            packet = octets.take(captured)
            if len(packet) < captured:
                self.damage.add(at, f"a packet of {captured} octets, {len(packet)} are there")
                return
            t_utc_ns = seconds * NS + fraction * header.unit_ns
            message = self.message(header, packet, length, t_utc_ns, at)
            if message is not None:
                yield message


class PcapWriter(RecordingWriter):
    """UDP in packets, as they were where the message was read from a capture.

    The file begins as the capture did that the first message is from, else it has Ethernet frames
    at nanoseconds. A message of the topic udp/ADDRESS/PORT goes there. ASTERIX of any other topic
    goes to port 8600 of a loopback address of its topic's own, from 127.1.0.0 on.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._addresses: dict[str, bytes] = {}
        self._header: PcapHeader | None = None
        self._cut_times = 0

    def write(self, message: Recorded) -> str | None:
        """Write a message; why it cannot be held, or None."""
        seconds, fraction = divmod(message.log_time_ns, NS)
        if seconds >> 32:
            return "of a time after 2106"
        if len(message.payload) > MAX_PAYLOAD_OCTETS:
            return f"longer than a datagram's {MAX_PAYLOAD_OCTETS} octets"
        place = self._destination(message)
        if isinstance(place, str):
            return place
        kept = kept_in(message.properties)
        header = self._header or self._begin(ns_header(ETHERNET) if kept is None else kept.header)
        if not holds(header.link_type, len(place[0])):
            return f"of an IP that link type {header.link_type} of the capture does not hold"
        packet, length = _as_it_was(header, message, place, kept) or _anew(header, message, place)
        if not packet:
            return f"longer than the capture's {header.snap_octets} octets of a packet"
        units, lost_ns = divmod(fraction, header.unit_ns)
        self._cut_times += lost_ns > 0
        self._file.write(header.record.pack(seconds, units, len(packet), length) + packet)
        return None

    def notes(self) -> list[str]:
        """What the file does not say; which topics are behind which addresses."""
        became = (
            f"{topic} became {'.'.join(map(str, octets))}:{ASTERIX_PORT}"
            for topic, octets in self._addresses.items()
        )
        notes = ["it has one time of each message, and no topics, content types or stages"]
        if self._cut_times:
            notes.append(f"{self._cut_times} times lost what is less than a microsecond")
        return [*notes, *became]

    def close(self) -> None:
        """Begin the file if nothing was written."""
        if self._header is None:
            self._begin(ns_header(ETHERNET))

    def _begin(self, header: PcapHeader) -> PcapHeader:
        self._file.write(header.octets)
        self._header = header
        return header

    def _destination(self, message: Recorded) -> tuple[bytes, int] | str:
        if message.topic.startswith(UDP_TOPIC):
            place = place_of(message.topic.removeprefix(UDP_TOPIC))
            if place is not None:
                return place
        if not is_asterix(message.content_type, message.payload):
            return "neither UDP nor ASTERIX"
        if message.topic not in self._addresses and len(self._addresses) == MAX_TOPICS:
            return f"of more topics than {MAX_TOPICS}"
        number = len(self._addresses)
        own = bytes([127, 1, number >> 8, number & 255])
        return self._addresses.setdefault(message.topic, own), ASTERIX_PORT


@lru_cache(maxsize=4096)
def place_of(text: str) -> tuple[bytes, int] | None:
    """The address, 4 or 16 octets, and the port of ADDRESS/PORT; None if it is not that."""
    host, _, port = text.rpartition("/")
    try:
        number = int(port) if port.isascii() and port.isdecimal() and len(port) <= 5 else 1 << 16
        return (ip_address(host).packed, number) if number < 1 << 16 else None
    except ValueError:
        return None


def _as_it_was(
    header: PcapHeader, message: Recorded, to: tuple[bytes, int], kept: KeptPacket | None
) -> tuple[bytes, int] | None:
    """The packet that a message was in and its octets before it was cut, if it still fits."""
    if kept is None or kept.header.link_type != header.link_type:
        return None
    packet, length = kept.with_payload(message.payload)
    try:
        found = datagram_in(header.link_type, packet)
    except DecodeError:
        return None
    if found is None or found.payload != message.payload or len(packet) > MAX_PACKET_OCTETS:
        return None
    source = place_of(f"{found.source}/{found.source_port}")
    destination = place_of(f"{found.destination}/{found.port}")
    fits = (source, destination) == (_source_of(message, to[0]), to)
    return (packet, length) if fits else None


def _anew(header: PcapHeader, message: Recorded, to: tuple[bytes, int]) -> tuple[bytes, int]:
    """A packet and its octets; none if it is longer than the file's may be."""
    (destination, port), (source, source_port) = to, _source_of(message, to[0])
    packet = frame(header.link_type, (source_port, port), source, destination, message.payload)
    if 0 < header.snap_octets < len(packet):
        return b"", 0
    return packet, len(packet)


def _source_of(message: Recorded, destination: bytes) -> tuple[bytes, int]:
    """Who sent it, if the recording says so and it is of the destination's kind; else loopback."""
    place = place_of(dict(message.properties).get(SOURCE, ""))
    if place is not None and len(place[0]) == len(destination):
        return place
    loopback = bytes([127, 0, 0, 1]) if len(destination) == 4 else bytes(15) + b"\1"
    return loopback, ASTERIX_PORT

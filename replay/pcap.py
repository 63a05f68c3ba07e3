"""Packet captures of libpcap: read in either byte order, µs or ns; written in ns."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from functools import lru_cache
from ipaddress import ip_address
from typing import BinaryIO

from plotfeed.replay.asterix_payload import is_asterix
from plotfeed.replay.frames import ethernet_frame
from plotfeed.replay.link_layers import ETHERNET
from plotfeed.replay.octets import Octets
from plotfeed.replay.packets import MAX_PACKET_OCTETS, SOURCE, UDP_TOPIC, Packets
from plotfeed.replay.recorded import Recorded
from plotfeed.replay.times import NS

MAGIC_NS = 0xA1B23C4D
FORMATS = {
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\x3c\x4d": (">", 1),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
}
"""Byte order and nanoseconds of a fraction by the first octets of a file."""

HEADER_OCTETS, RECORD_OCTETS = 24, 16
LINK_TYPE_MASK = 0xFFFF  # above it is what a frame check sequence is like

ASTERIX_PORT = 8600
"""Of UDP, where Wireshark takes it for ASTERIX."""
MAX_PAYLOAD_OCTETS = 65_507
MAX_TOPICS = 1 << 16


class PcapReader:
    """The UDP datagrams of a capture. Nothing tells where a packet begins after a broken length."""

    def __init__(self, file: BinaryIO) -> None:
        self._octets = Octets(file)
        self._packets = Packets()
        self.damage = self._packets.damage

    @property
    def at(self) -> int:
        """Octets of the file that were read."""
        return self._octets.at

    @property
    def skipped(self) -> int:
        """Packets that hold no UDP."""
        return self._packets.skipped

    def messages(self) -> Iterator[Recorded]:
        """Each datagram, on the topic udp/ADDRESS/PORT of where it went."""
        header = self._octets.take(HEADER_OCTETS)
        if header[:4] not in FORMATS:
            self.damage.add(0, f"{header[:4].hex()!r}; expected the first octets of a pcap")
            return
        if len(header) < HEADER_OCTETS:
            self.damage.add(0, f"a header of {len(header)} octets; it has {HEADER_OCTETS}")
            return
        order, unit_ns = FORMATS[header[:4]]
        (network,) = struct.unpack_from(f"{order}I", header, 20)
        self._packets.check_link_type(network & LINK_TYPE_MASK, 20)
        yield from self._records(struct.Struct(f"{order}IIII"), unit_ns, network & LINK_TYPE_MASK)

    def _records(self, record: struct.Struct, unit_ns: int, link_type: int) -> Iterator[Recorded]:
        octets = self._octets
        while True:
            at = octets.at
            header = octets.take(RECORD_OCTETS)
            if len(header) < RECORD_OCTETS:
                if header:
                    self.damage.add(at, "the file ends within the header of a packet")
                return
            seconds, fraction, captured, _ = record.unpack(header)
            if captured > MAX_PACKET_OCTETS:
                self.damage.add(at, f"a packet of {captured} octets; at most {MAX_PACKET_OCTETS}")
                return
            packet = octets.take(captured)
            if len(packet) < captured:
                self.damage.add(at, f"a packet of {captured} octets, {len(packet)} are there")
                return
            t_utc_ns = seconds * NS + fraction * unit_ns
            message = self._packets.message(link_type, packet, t_utc_ns, at)
            if message is not None:
                yield message


class PcapWriter:
    """UDP in Ethernet frames, at nanoseconds.

    A message of the topic udp/ADDRESS/PORT goes there. ASTERIX of any other topic goes to port 8600
    of a loopback address of its topic's own, from 127.1.0.0 on.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._addresses: dict[str, bytes] = {}
        file.write(struct.pack("<IHHiIII", MAGIC_NS, 2, 4, 0, 0, MAX_PACKET_OCTETS, ETHERNET))

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
        destination, port = place
        source, source_port = _source_of(message, destination)
        frame = ethernet_frame((source_port, port), source, destination, message.payload)
        header = struct.pack("<IIII", seconds, fraction, len(frame), len(frame))
        self._file.write(header + frame)
        return None

    def notes(self) -> list[str]:
        """What the file does not say; which topics are behind which addresses."""
        became = (
            f"{topic} became {'.'.join(map(str, octets))}:{ASTERIX_PORT}"
            for topic, octets in self._addresses.items()
        )
        return ["it has one time of each message, and no topics, content types or stages", *became]

    def close(self) -> None:
        """Nothing is left to be written."""

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


def _source_of(message: Recorded, destination: bytes) -> tuple[bytes, int]:
    """Who sent it, if the recording says so and it is of the destination's kind; else loopback."""
    place = place_of(dict(message.properties).get(SOURCE, ""))
    if place is not None and len(place[0]) == len(destination):
        return place
    loopback = bytes([127, 0, 0, 1]) if len(destination) == 4 else bytes(15) + b"\1"
    return loopback, ASTERIX_PORT

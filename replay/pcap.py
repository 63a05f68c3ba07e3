"""Packet captures as messages: pcap, both ways, and pcapng, as Wireshark writes it, read only.

UDP is read in packets of every link layer; what a packet says besides is kept as properties.
"""

from __future__ import annotations

import base64
import struct
from abc import abstractmethod
from collections.abc import Iterator
from functools import lru_cache
from ipaddress import ip_address
from typing import BinaryIO, NamedTuple
from zlib import crc32

from plotfeed.proto.errors import DecodeError
from plotfeed.proto.utc import NS
from plotfeed.replay.asterix_files import content_type, is_asterix
from plotfeed.replay.recorded import LATEST_NS, UDP_TOPIC, OctetsReader, Recorded, RecordingWriter

IPV4, IPV6 = 0x0800, 0x86DD
NULL, ETHERNET, RAW, COOKED, COOKED_2 = 0, 1, 101, 113, 276
RAW_OF_SYSTEMS = (12, 14)  # What DLT_RAW is on BSDs, by whose programs some files were written
ONLY_IPV4, ONLY_IPV6 = 228, 229
# What packets without a link layer carry.
_WITHOUT_LINK = {
    **dict.fromkeys((RAW, *RAW_OF_SYSTEMS), (IPV4, IPV6)),
    ONLY_IPV4: (IPV4,),
    ONLY_IPV6: (IPV6,),
}
LINK_TYPES = (NULL, ETHERNET, *RAW_OF_SYSTEMS, RAW, COOKED, ONLY_IPV4, ONLY_IPV6, COOKED_2)
VLAN_TAGS = (0x8100, 0x88A8, 0x9100)
_FAMILIES = {2: IPV4, 24: IPV6, 28: IPV6, 30: IPV6}  # AF_INET; AF_INET6 of the BSDs
_COOKED = {COOKED: (14, 16), COOKED_2: (0, 20)}  # where the protocol is, and the packet

UDP_PROTOCOL, FRAGMENT = 17, 44
_MEASURED = (0, 43, 60)  # IPv6 extensions with a length: hop by hop, routing, destination
IPV4_OCTETS, IPV6_OCTETS = 20, 40
UDP_OCTETS = 8
MORE_FRAGMENTS_OR_OFFSET = 0x3FFF


Place = tuple[bytes, int]  # An address, 4 or 16 octets, and a port


class Datagram(NamedTuple):
    """A UDP payload, from where and to where."""

    source: Place
    destination: Place
    payload: bytes
    payload_at: int  # Octet of the packet


def datagram_in(link_type: int, packet: bytes) -> Datagram | None:
    """The datagram that a packet carries; None if it carries something else.

    Raises `DecodeError` for UDP that is not all there: cut, or a fragment.
    """
    try:
        found = network_in(link_type, packet)
        if found is None:
            return None
        protocol, at = found
        return _of_ipv4(packet, at) if protocol == IPV4 else _of_ipv6(packet, at)
    except (struct.error, IndexError):
        raise DecodeError(f"a packet of {len(packet)} octets ends within its headers") from None


def network_in(link_type: int, packet: bytes) -> tuple[int, int] | None:
    """Which IP a packet carries and where it begins; None if it carries none.

    Raises `IndexError` or `struct.error` for a packet that ends before it.
    """
    if link_type == ETHERNET:
        return _untagged(packet, 12, 14)
    if link_type in _COOKED:
        return _untagged(packet, *_COOKED[link_type])
    if link_type in _WITHOUT_LINK:
        protocol = {4: IPV4, 6: IPV6}.get(packet[0] >> 4)
        return (protocol, 0) if protocol in _WITHOUT_LINK[link_type] else None
    if link_type == NULL:
        # In the byte order of whoever captured it; families are small numbers.
        protocol = _FAMILIES.get(packet[0] | packet[3]) if packet[1:3] == b"\0\0" else None
        return None if protocol is None else (protocol, 4)
    return None


def _untagged(packet: bytes, protocol_at: int, at: int) -> tuple[int, int] | None:
    (protocol,) = struct.unpack_from(">H", packet, protocol_at)
    while protocol in VLAN_TAGS:
        (protocol,) = struct.unpack_from(">H", packet, at + 2)
        at += 4
    return (protocol, at) if protocol in (IPV4, IPV6) else None


def _of_ipv4(packet: bytes, at: int) -> Datagram | None:
    first, length, fragment, protocol = struct.unpack_from(">BxHxxHxB", packet, at)
    if protocol != UDP_PROTOCOL or first >> 4 != 4:
        return None
    if fragment & MORE_FRAGMENTS_OR_OFFSET:
        raise DecodeError("a fragment of an IPv4 packet; fragments are not put together")
    header = (first & 15) * 4
    if header < IPV4_OCTETS:
        raise DecodeError(f"an IPv4 header of {header} octets; it has at least {IPV4_OCTETS}")
    # An offloading card captures a length of 0. What follows the length is padding.
    packet = packet[: at + length] if length else packet
    return _of_udp(packet, at + header, packet[at + 12 : at + 16], packet[at + 16 : at + 20])


def _of_ipv6(packet: bytes, at: int) -> Datagram | None:
    first, length, protocol = struct.unpack_from(">BxxxHB", packet, at)
    if first >> 4 != 6:
        return None
    source, destination = packet[at + 8 : at + 24], packet[at + 24 : at + 40]
    at += IPV6_OCTETS
    packet = packet[: at + length] if length else packet
    while protocol in _MEASURED:
        protocol, octets = packet[at], 8 * (packet[at + 1] + 1)
        at += octets
    if protocol == FRAGMENT and packet[at] == UDP_PROTOCOL:
        raise DecodeError("a fragment of an IPv6 packet; fragments are not put together")
    return _of_udp(packet, at, source, destination) if protocol == UDP_PROTOCOL else None


def _of_udp(packet: bytes, at: int, source: bytes, destination: bytes) -> Datagram:
    source_port, port, length = struct.unpack_from(">HHH", packet, at)
    if length < UDP_OCTETS:
        raise DecodeError(f"a UDP datagram of {length} octets has no header")
    if at + length > len(packet):
        there = max(len(packet) - at - UDP_OCTETS, 0)
        raise DecodeError(f"a UDP payload of {length - UDP_OCTETS} octets, {there} are there")
    payload_at = at + UDP_OCTETS
    payload = packet[payload_at : at + length]
    return Datagram((source, source_port), (destination, port), payload, payload_at)


@lru_cache(maxsize=4096)
def text_of(place: Place) -> str:
    """ADDRESS/PORT."""
    return f"{ip_address(place[0])}/{place[1]}"


TTL = 64
DO_NOT_FRAGMENT = 0x4000
LONGEST = 0xFFFF
_ARP_ETHERNET = 1
_FAMILY_4, _FAMILY_6 = 2, 30  # of the BSDs, where packets without a link layer come from


def frame(link_type: int, source: Place, destination: Place, payload: bytes) -> bytes:
    """The packet of a payload from one place to another; both addresses are of one length."""
    (source_address, source_port), (address, port) = source, destination
    if len(address) == 4:
        ip = struct.pack(">BBHHHBBH", 0x45, 0, 0, 0, DO_NOT_FRAGMENT, TTL, UDP_PROTOCOL, 0)
    else:
        ip = struct.pack(">IHBB", 6 << 28, 0, UDP_PROTOCOL, TTL)
    link = _link_layer(link_type, source_address, address)
    head = link + ip + source_address + address + struct.pack(">HHI", source_port, port, 0)
    return with_payload(link_type, head, payload)


def with_payload(link_type: int, head: bytes, payload: bytes) -> bytes:
    """The packet that begins with these headers; their lengths and checksums are made anew.

    No octets if the headers end before that of UDP does, or the payload is too long.
    """
    try:
        found = network_in(link_type, head)
    except (IndexError, struct.error):
        return b""
    if found is None:
        return b""
    protocol, ip_at = found
    udp_at = len(head) - UDP_OCTETS
    ip = head[ip_at : max(ip_at, udp_at)]
    # Of IPv6, without its own header.
    length = len(ip) + UDP_OCTETS + len(payload) - (0 if protocol == IPV4 else IPV6_OCTETS)
    if len(ip) < (IPV4_OCTETS if protocol == IPV4 else IPV6_OCTETS) or length > LONGEST:
        return b""
    if protocol == IPV4:
        addresses = ip[12:20]
        ip = ip[:2] + length.to_bytes(2, "big") + ip[4:10] + b"\0\0" + ip[12:]
        ip = ip[:10] + checksum(ip).to_bytes(2, "big") + ip[12:]
    else:
        addresses = ip[8:40]
        ip = ip[:4] + length.to_bytes(2, "big") + ip[6:]
    udp = head[udp_at : udp_at + 4] + (UDP_OCTETS + len(payload)).to_bytes(2, "big")
    pseudo = addresses + struct.pack(">II", UDP_OCTETS + len(payload), UDP_PROTOCOL)
    total = checksum(pseudo + udp + b"\0\0" + payload) or 0xFFFF
    return head[:ip_at] + ip + udp + total.to_bytes(2, "big") + payload


def _link_layer(link_type: int, source: bytes, destination: bytes) -> bytes:
    kind = (IPV4 if len(source) == 4 else IPV6).to_bytes(2, "big")
    if link_type == ETHERNET:
        return hardware(destination) + hardware(source) + kind
    if link_type == NULL:
        return struct.pack("<I", _FAMILY_4 if len(source) == 4 else _FAMILY_6)
    if link_type == COOKED:
        return struct.pack(">HHHQ", 0, _ARP_ETHERNET, 0, 0) + kind
    if link_type == COOKED_2:
        return kind + struct.pack(">HIHHQ", 0, 0, _ARP_ETHERNET, 0, 0)
    return b""


def checksum(octets: bytes) -> int:
    """The Internet checksum, RFC 1071: complement of the ones' complement sum of 16-bit words."""
    if len(octets) % 2:
        octets += b"\0"
    # A big-endian number is congruent to the sum of its 16-bit words, modulo 2**16 - 1.
    total = int.from_bytes(octets, "big") % 0xFFFF
    if not total and any(octets):
        total = 0xFFFF
    return 0xFFFF - total


def hardware(ip: bytes) -> bytes:
    """The group address of a multicast one, RFC 1112 and 2464; else a locally administered one."""
    if len(ip) == 4 and 224 <= ip[0] < 240:
        return bytes([0x01, 0x00, 0x5E, ip[1] & 0x7F, ip[2], ip[3]])
    if len(ip) == 16 and ip[0] == 0xFF:
        return b"\x33\x33" + ip[12:]
    return b"\x02\x00" + ip[-4:]


# In base64: the header of the file, what is before the payload, what is behind it if anything.
FILE, HEAD, TAIL = "pcap-file", "pcap-head", "pcap-tail"
LENGTH = "pcap-length"  # Octets of the packet before it was cut; only where it was
# CRC-32 of the payload in hexadecimal, which tells whether it is still that of the packet.
PAYLOAD_CRC = "pcap-payload-crc"

SOURCE = "udp-source"  # The property that says who sent a datagram: ADDRESS/PORT

HEADER_OCTETS, RECORD_OCTETS = 24, 16
MAX_PACKET_OCTETS = 1 << 18  # As captures have it at most; a datagram is shorter
# Byte order and nanoseconds of a fraction by the first octets of a file.
FORMATS = {
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\x3c\x4d": (">", 1),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
}
_MAGIC_NS = 0xA1B23C4D
_LINK_TYPE_MASK = 0xFFFF  # above it is what a frame check sequence is like


class PcapHeader(NamedTuple):
    """The header of a file."""

    octets: bytes
    unit_ns: int  # Of the fractions of seconds
    link_type: int
    snap_octets: int  # Of a packet at most; 0 is all
    # Of a packet: seconds, fraction, octets that are there, octets that it had.
    record: struct.Struct


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

    header: PcapHeader  # Of the file that it was in
    head: bytes
    tail: bytes
    length: int | None
    payload_crc: int

    def carrying(
        self, payload: bytes, source: Place, to: Place, link_type: int
    ) -> tuple[bytes, int] | None:
        """The packet, and its octets before it was cut; None where it is another or too long.

        With another payload, lengths and checksums are of that, and there is no tail.
        """
        if crc32(payload) == self.payload_crc:
            packet = self.head + payload + self.tail
            length, most = self.length, MAX_PACKET_OCTETS
        else:
            packet = with_payload(self.header.link_type, self.head, payload)
            length = None
            most = min(self.header.snap_octets or MAX_PACKET_OCTETS, MAX_PACKET_OCTETS)
        try:
            found = datagram_in(self.header.link_type, packet)
        except DecodeError:
            return None
        fits = found is not None and found[:3] == (source, to, payload) and len(packet) <= most
        if self.header.link_type != link_type or not fits:
            return None
        return packet, len(packet) if length is None else length


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


class Captured(NamedTuple):
    """A packet as a capture has it."""

    header: PcapHeader  # Of a pcap that holds it
    octets: bytes
    length: int  # Its octets before it was cut
    t_utc_ns: int
    at: int  # Octet of the file at which it begins


class PacketReader(OctetsReader):
    """Makes messages of packets; notes those that are broken and counts those that are not UDP."""

    @abstractmethod
    def packets(self) -> Iterator[Captured]:
        """The packets of the file, once."""

    def check_link_type(self, link_type: int, at: int) -> None:
        """Note at that offset that none of its packets can be read."""
        if link_type not in LINK_TYPES:
            expected = ", ".join(map(str, LINK_TYPES))
            self.damage.add(at, f"packets of link type {link_type}; expected one of {expected}")

    def messages(self) -> Iterator[Recorded]:
        """Each datagram, on the topic udp/ADDRESS/PORT of where it went."""
        for header, packet, length, t_utc_ns, at in self.packets():
            try:
                found = datagram_in(header.link_type, packet)
            except DecodeError as error:
                self.damage.add(at, str(error))
                continue
            if found is None:
                self.skipped += 1  # it holds no UDP
                continue
            if not 0 <= t_utc_ns <= LATEST_NS:
                what = f"a packet of {t_utc_ns} ns since 1970; expected 1970 to 2554"
                self.damage.add(at, what)
                continue
            tail = packet[found.payload_at + len(found.payload) :]
            yield Recorded(
                topic=UDP_TOPIC + text_of(found.destination),
                payload=found.payload,
                log_time_ns=t_utc_ns,
                publish_time_ns=t_utc_ns,
                content_type=content_type(found.payload),
                properties=(
                    (SOURCE, text_of(found.source)),
                    (FILE, _text(header.octets)),
                    (HEAD, _text(packet[: found.payload_at])),
                    (PAYLOAD_CRC, f"{crc32(found.payload):08x}"),
                    *(((TAIL, _text(tail)),) if tail else ()),
                    *(((LENGTH, str(length)),) if length != len(packet) else ()),
                ),
            )


ASTERIX_PORT = 8600  # Of UDP, where Wireshark takes it for ASTERIX
MAX_PAYLOAD_OCTETS = 65_507
MAX_TOPICS = 1 << 16


class PcapReader(PacketReader):
    """The UDP datagrams of a capture. Nothing tells where a packet begins after a broken length."""

    def packets(self) -> Iterator[Captured]:
        """The packets up to the first broken length."""
        beginning = self.take(HEADER_OCTETS)
        if beginning[:4] not in FORMATS:
            self.damage.add(0, f"{beginning[:4].hex()!r}; expected the first octets of a pcap")
            return
        header = header_of(beginning)
        if header is None:
            self.damage.add(0, f"a header of {len(beginning)} octets; it has {HEADER_OCTETS}")
            return
        self.check_link_type(header.link_type, 20)
        while True:
            at = self.at
            record = self.take(RECORD_OCTETS)
            if len(record) < RECORD_OCTETS:
                if record:
                    self.damage.add(at, "the file ends within the header of a packet")
                return
            seconds, fraction, captured, length = header.record.unpack(record)
            if captured > MAX_PACKET_OCTETS:
                self.damage.add(at, f"a packet of {captured} octets; at most {MAX_PACKET_OCTETS}")
                return
            if not any(record):  # as in what is left of a file that was to grow
                self.damage.add(at, "zeros in place of a packet")
                return
            packet = self.take(captured)
            if len(packet) < captured:
                self.damage.add(at, f"a packet of {captured} octets, {len(packet)} are there")
                return
            t_utc_ns = seconds * NS + fraction * header.unit_ns
            yield Captured(header, packet, length, t_utc_ns, at)


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
        if header.link_type == (ONLY_IPV6 if len(place[0]) == 4 else ONLY_IPV4):
            return f"of an IP that link type {header.link_type} of the capture does not hold"
        source = _source_of(message, place[0])
        found = kept and kept.carrying(message.payload, source, place, header.link_type)
        if not found:
            packet = frame(header.link_type, source, place, message.payload)
            if 0 < header.snap_octets < len(packet):
                return f"longer than the capture's {header.snap_octets} octets of a packet"
            found = packet, len(packet)
        packet, length = found
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

    def _destination(self, message: Recorded) -> Place | str:
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
def place_of(text: str) -> Place | None:
    """The address and the port of ADDRESS/PORT; None if it is not that."""
    host, _, port = text.rpartition("/")
    try:
        number = int(port) if port.isascii() and port.isdecimal() and len(port) <= 5 else 1 << 16
        return (ip_address(host).packed, number) if number < 1 << 16 else None
    except ValueError:
        return None


def _source_of(message: Recorded, destination: bytes) -> Place:
    """Who sent it, if the recording says so and it is of the destination's kind; else loopback."""
    place = place_of(dict(message.properties).get(SOURCE, ""))
    if place is not None and len(place[0]) == len(destination):
        return place
    loopback = bytes([127, 0, 0, 1]) if len(destination) == 4 else bytes(15) + b"\1"
    return loopback, ASTERIX_PORT


SECTION = b"\n\r\r\n"
ORDERS = {b"\x1a\x2b\x3c\x4d": ">", b"\x4d\x3c\x2b\x1a": "<"}
INTERFACE, OBSOLETE_PACKET, SIMPLE_PACKET, ENHANCED_PACKET = 1, 2, 3, 6
READ = (INTERFACE, OBSOLETE_PACKET, SIMPLE_PACKET, ENHANCED_PACKET)

HEAD_OCTETS, TAIL_OCTETS = 8, 4
ROOM_OCTETS = 1 << 16  # Of a block for what is not packet: its fields and options
MAX_INTERFACES = 1 << 12

TSRESOL, TSOFFSET = 9, 14
MICROSECONDS = 6
BINARY = 0x80


class Interface(NamedTuple):
    """Where packets were captured, and how their times count."""

    header: PcapHeader  # Of a pcap that holds them
    snap_octets: int  # Captured of a packet at most; 0 is all
    ticks_a_second: int
    offset_s: int


class PcapngReader(PacketReader):
    """The UDP datagrams of a capture, through all its sections.

    A packet without a time has that of the one before it. Nothing tells where the block after a
    broken length begins.
    """

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file)
        self._interfaces: list[Interface] = []
        self._order = ""
        self._last_utc_ns = 0

    def packets(self) -> Iterator[Captured]:
        """The packets of the blocks up to the first broken length."""
        for kind, body, at in self._blocks():
            try:
                if kind == INTERFACE:
                    self._take_interface(body, at)
                elif packet := self._packet(kind, body, at):
                    yield packet
            except struct.error:
                self.damage.add(at, f"a block of type {kind} that lacks fields")

    def _blocks(self) -> Iterator[tuple[int, bytes, int]]:
        """The type of each whole block, what lies between its lengths, and where it begins."""
        while True:
            at = self.at
            head = self.take(HEAD_OCTETS)
            if not head:
                return
            what = self._begin(head)
            if what:
                self.damage.add(at, what)
                return
            kind, length = struct.unpack(f"{self._order}II", head)
            left = length - HEAD_OCTETS - TAIL_OCTETS
            if kind in READ and left > MAX_PACKET_OCTETS + ROOM_OCTETS:
                self.damage.add(at, f"a block of {length} octets, which no packet has")
                return
            body = self.take(left) if kind in READ else b""
            there = len(body) if kind in READ else self.skip(left)
            tail = self.take(TAIL_OCTETS)
            if there < left or len(tail) < TAIL_OCTETS:
                whole = HEAD_OCTETS + there + len(tail)
                self.damage.add(at, f"a block of {length} octets, {whole} are there")
                return
            if tail != head[4:]:
                self.damage.add(at, f"a block of {length} octets that ends with another length")
                return
            if kind in READ:
                yield kind, body, at

    def _begin(self, head: bytes) -> str:
        """Take the byte order from the head of a section; what is wrong with it, or nothing."""
        if len(head) < HEAD_OCTETS:
            return "the file ends within the head of a block"
        if head[:4] == SECTION:
            mark = self.peek(4)
            if mark not in ORDERS:
                return f"the byte order {mark.hex()!r}; expected 1a2b3c4d or 4d3c2b1a"
            self._order = ORDERS[mark]
            self._interfaces = []
        if not self._order:
            return f"{head[:4].hex()!r}; expected the first octets of a pcapng"
        (length,) = struct.unpack(f"{self._order}I", head[4:])
        if length < HEAD_OCTETS + TAIL_OCTETS:
            return f"a block of {length} octets; it has at least {HEAD_OCTETS + TAIL_OCTETS}"
        return ""

    def _take_interface(self, body: bytes, at: int) -> None:
        link_type, snap_octets = struct.unpack_from(f"{self._order}HxxI", body)
        if len(self._interfaces) == MAX_INTERFACES:
            self.damage.add(at, f"more interfaces than {MAX_INTERFACES}")
            return
        self.check_link_type(link_type, at)
        resolution, offset_s = MICROSECONDS, 0
        for code, value in self._options(body[8:]):
            if code == TSRESOL and len(value) == 1:
                resolution = value[0]
            elif code == TSOFFSET and len(value) == 8:
                (offset_s,) = struct.unpack(f"{self._order}q", value)
        base, power = (2, resolution - BINARY) if resolution & BINARY else (10, resolution)
        header = ns_header(link_type)
        self._interfaces.append(Interface(header, snap_octets, base**power, offset_s))

    def _options(self, octets: bytes) -> Iterator[tuple[int, bytes]]:
        at = 0
        while len(octets) - at >= 4:
            code, length = struct.unpack_from(f"{self._order}HH", octets, at)
            if not code:
                return
            yield code, octets[at + 4 : at + 4 + length]
            at += 4 + (length + 3 & ~3)

    def _packet(self, kind: int, body: bytes, at: int) -> Captured | None:
        if kind == SIMPLE_PACKET:
            number, begin, ticks = 0, 4, None
            (length,) = struct.unpack_from(f"{self._order}I", body)
            captured = length
        else:
            form = "IIIII" if kind == ENHANCED_PACKET else "HxxIIII"
            number, high, low, captured, length = struct.unpack_from(f"{self._order}{form}", body)
            begin, ticks = 20, high << 32 | low
        if number >= len(self._interfaces):
            self.damage.add(at, f"a packet of interface {number}, which is not described")
            return None
        interface = self._interfaces[number]
        if kind == SIMPLE_PACKET and interface.snap_octets:
            captured = min(captured, interface.snap_octets)
        if captured > len(body) - begin:
            there = len(body) - begin
            self.damage.add(at, f"a packet of {captured} octets, {there} are there")
            return None
        if ticks is not None:
            since_ns = ticks * NS // interface.ticks_a_second
            self._last_utc_ns = since_ns + interface.offset_s * NS
        packet = body[begin : begin + captured]
        return Captured(interface.header, packet, length, self._last_utc_ns, at)

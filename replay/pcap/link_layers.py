"""UDP datagrams in captured packets of every link layer."""

from __future__ import annotations

import struct
from functools import lru_cache
from ipaddress import IPv6Address
from typing import NamedTuple

from plotfeed.proto.errors import DecodeError

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


class Datagram(NamedTuple):
    """A UDP payload, from where and to where."""

    source: str
    source_port: int
    destination: str
    port: int
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
    return Datagram(address(source), source_port, address(destination), port, payload, payload_at)


@lru_cache(maxsize=4096)
def address(octets: bytes) -> str:
    """An IPv4 or IPv6 address as text."""
    if len(octets) == 4:
        return ".".join(map(str, octets))
    return str(IPv6Address(octets))


def holds(link_type: int, address_octets: int) -> bool:
    """Whether packets of that link type carry IP with addresses of so many octets."""
    return link_type != (ONLY_IPV6 if address_octets == 4 else ONLY_IPV4)


TTL = 64
DO_NOT_FRAGMENT = 0x4000
LONGEST = 0xFFFF
_ARP_ETHERNET = 1
_FAMILY_4, _FAMILY_6 = 2, 30  # of the BSDs, where packets without a link layer come from


def frame(
    link_type: int, ports: tuple[int, int], source: bytes, destination: bytes, payload: bytes
) -> bytes:
    """A payload from one address and port to another; addresses are of 4 or both of 16 octets."""
    if len(source) == 4:
        ip = struct.pack(">BBHHHBBH", 0x45, 0, 0, 0, DO_NOT_FRAGMENT, TTL, UDP_PROTOCOL, 0)
    else:
        ip = struct.pack(">IHBB", 6 << 28, 0, UDP_PROTOCOL, TTL)
    link = _link_layer(link_type, source, destination)
    head = link + ip + source + destination + struct.pack(">HHI", *ports, 0)
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

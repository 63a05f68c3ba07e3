"""UDP datagrams in captured packets: link layer, VLAN tags, IPv4 or IPv6, UDP.

Link types are those of pcap: 0 null, 1 Ethernet, 101 raw IP, 113 and 276 Linux cooked.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from ipaddress import IPv6Address
from typing import NamedTuple

from plotfeed.proto.errors import DecodeError

NULL, ETHERNET, RAW, COOKED, COOKED_2 = 0, 1, 101, 113, 276
LINK_TYPES = (NULL, ETHERNET, RAW, COOKED, COOKED_2)
IPV4, IPV6 = 0x0800, 0x86DD
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
    payload_at: int
    """Octet of the packet."""


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
    if link_type == RAW:
        protocol = {4: IPV4, 6: IPV6}.get(packet[0] >> 4)
        return None if protocol is None else (protocol, 0)
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

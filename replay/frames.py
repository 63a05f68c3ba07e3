"""Packets of UDP datagrams in every link layer, with the checksums that readers verify."""

from __future__ import annotations

import struct

from plotfeed.replay.link_layers import (
    COOKED,
    COOKED_2,
    ETHERNET,
    IPV4,
    IPV4_OCTETS,
    IPV6,
    IPV6_OCTETS,
    NULL,
    UDP_OCTETS,
    UDP_PROTOCOL,
    network_in,
)

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
    return head[:ip_at] + ip + _udp(head[udp_at : udp_at + 4], addresses, payload)


def _udp(ports: bytes, addresses: bytes, payload: bytes) -> bytes:
    length = UDP_OCTETS + len(payload)
    header = ports + length.to_bytes(2, "big")
    pseudo = addresses + struct.pack(">II", length, UDP_PROTOCOL)
    total = checksum(pseudo + header + b"\0\0" + payload)
    return header + (total or 0xFFFF).to_bytes(2, "big") + payload


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
    """Of the Internet: the complement of the ones' complement sum of 16-bit words, RFC 1071."""
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

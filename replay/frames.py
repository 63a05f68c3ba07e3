"""Ethernet frames of UDP datagrams, with the checksums that readers verify."""

from __future__ import annotations

import struct

from plotfeed.replay.link_layers import IPV4, IPV4_OCTETS, IPV6, UDP_OCTETS, UDP_PROTOCOL

TTL = 64
DO_NOT_FRAGMENT = 0x4000


def ethernet_frame(
    ports: tuple[int, int], source: bytes, destination: bytes, payload: bytes
) -> bytes:
    """A payload from one address and port to another; addresses are of 4 or both of 16 octets."""
    udp = _udp(ports, source, destination, payload)
    if len(source) == 4:
        length = IPV4_OCTETS + len(udp)
        header = struct.pack(">BBHHHBBH", 0x45, 0, length, 0, DO_NOT_FRAGMENT, TTL, UDP_PROTOCOL, 0)
        header += source + destination
        total = checksum(header).to_bytes(2, "big")
        header = header[:10] + total + header[12:]
        protocol = IPV4
    else:
        header = struct.pack(">IHBB", 6 << 28, len(udp), UDP_PROTOCOL, TTL) + source + destination
        protocol = IPV6
    link = hardware(destination) + hardware(source) + protocol.to_bytes(2, "big")
    return link + header + udp


def _udp(ports: tuple[int, int], source: bytes, destination: bytes, payload: bytes) -> bytes:
    length = UDP_OCTETS + len(payload)
    header = struct.pack(">HHH", *ports, length)
    pseudo = source + destination + struct.pack(">II", length, UDP_PROTOCOL)
    total = checksum(pseudo + header + b"\0\0" + payload)
    return header + (total or 0xFFFF).to_bytes(2, "big") + payload


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

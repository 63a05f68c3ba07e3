"""Multicast groups that sockets join, at an interface that is named or by the system's route."""

from __future__ import annotations

import ipaddress
import socket
import struct

Group = ipaddress.IPv4Address | ipaddress.IPv6Address


def join_group(receiver: socket.socket, group: Group, interface: str | None) -> None:
    """Have a socket receive what is sent to a group; raises `OSError`.

    The interface is the name of one, or its IPv4 address.
    """
    if group.version == 4:
        member = group.packed + _interface_4(interface)
        receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
    else:
        member = group.packed + struct.pack("@I", interface_number(group, interface))
        receiver.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, member)


def interface_number(group: Group, interface: str | None) -> int:
    """The number of the interface for a group of IPv6; 0 is the system's own choice."""
    name = interface or getattr(group, "scope_id", None)
    return socket.if_nametoindex(name) if name else 0


def _interface_4(interface: str | None) -> bytes:
    """The end of a struct ip_mreqn: an address, or the number of a name; neither is the route's."""
    if interface is None:
        return struct.pack("@4si", b"", 0)
    try:
        return struct.pack("@4si", ipaddress.IPv4Address(interface).packed, 0)
    except ValueError:
        return struct.pack("@4si", b"", socket.if_nametoindex(interface))

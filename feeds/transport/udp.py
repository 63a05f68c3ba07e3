"""UDP: multicast groups, and messages that leave, unicast and multicast, each a datagram.

Those are data blocks of ASTERIX, as trackers take them, or events of Cursor on Target, as TAK does.
"""

from __future__ import annotations

import ipaddress
import logging
import socket
import struct
import sys
from collections.abc import Callable

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.transports import ImmediateTransport
from plotfeed.feeds.scene.output_keys import Endpoint, UdpDestination
from plotfeed.feeds.transport.ways_out import TransportError
from plotfeed.proto.content_types import ASTERIX, COT


def receiver_at(
    host: str,
    port: int,
    interface: str | None,
    buffer_octets: int,
    prepare: Callable[[socket.socket], object] = lambda _: None,
) -> socket.socket:
    """A socket that never waits and receives what comes to a host or a group; raises `OSError`.

    A group is joined at the interface of that name, or of that IPv4 address. `prepare` is called
    with the socket before anything may come.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    place = socket.getaddrinfo(host, port, family, socket.SOCK_DGRAM)[0][4]
    opened = socket.socket(family, socket.SOCK_DGRAM)
    try:
        opened.setblocking(False)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer_octets)
        group = ipaddress.ip_address(str(place[0]))
        if group.is_multicast:  # others on this machine may receive the group too
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if group.version == 6:  # whose scope may need its interface
                place = (*place[:3], _interface_6(host, interface))
        prepare(opened)
        opened.bind(place)
        if group.is_multicast and group.version == 4:
            member = group.packed + struct.pack("@4si", *_interface_4(interface))
            opened.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        elif group.is_multicast:
            member = group.packed + struct.pack("@I", _interface_6(host, interface))
            opened.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, member)
    except BaseException:
        opened.close()
        raise
    return opened


def _interface_6(host: str, interface: str | None) -> int:
    """The number of the interface for a group of IPv6; 0 is the system's own choice."""
    name = interface or host.partition("%")[2]
    return socket.if_nametoindex(name) if name else 0


def _interface_4(interface: str | None) -> tuple[bytes, int]:
    """The address of an interface, or the number of its name; neither is that of the route."""
    if interface is None:
        return bytes(4), 0
    try:
        return ipaddress.IPv4Address(interface).packed, 0
    except ValueError:
        return bytes(4), socket.if_nametoindex(interface)


log = logging.getLogger(__name__)


SO_MEMINFO = 55  # Of Linux, which Python does not name
MEMINFO = struct.Struct("@9I")  # Of which the last is how many datagrams the socket had no room for


def lost_of(receiver: socket.socket) -> int | None:
    """Datagrams so far for which the socket had no room; None if the system does not tell."""
    try:
        told = receiver.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, MEMINFO.size)
        return int(MEMINFO.unpack(told)[-1]) if sys.platform == "linux" else None
    except (OSError, struct.error):
        return None


class UdpTransport(ImmediateTransport):
    """A socket that sends what it carries of the messages to one destination, and never waits."""

    def __init__(self, settings: UdpDestination, key: str = "udp") -> None:
        """`key` is the destination's place in the scene."""
        self.settings = settings
        self.to = self.name = f"{key} {settings.destination}"
        self._key = key
        self._carried = ASTERIX if settings.carries == "asterix" else COT
        self._fails = False
        self._socket: socket.socket | None = None
        self._target: tuple[object, ...] = ()

    def open(self) -> None:
        """Make the socket; raises `TransportError`."""
        endpoint = Endpoint.parse(self.settings.destination)
        family = socket.AF_INET if endpoint.address.version == 4 else socket.AF_INET6
        try:
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
            # With the scope of a link-local address, which only the system can number.
            found = socket.getaddrinfo(
                str(endpoint.address), endpoint.port, family, socket.SOCK_DGRAM
            )
            self._target = found[0][4]
            if endpoint.address.is_multicast:
                self._prepare_multicast(self._socket)
            elif family == socket.AF_INET:
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        except OSError as error:
            self.close()
            what = f"{self._key}.destination: {self.settings.destination}"
            raise TransportError(f"{what}: {_why(error)}") from None

    def carries(self, message: Message) -> bool:
        """Whether it is of the kind that goes there."""
        return message.content_type.startswith(self._carried)

    def give(self, message: Message) -> bool:
        """Send it; False if the system does not take it."""
        return self.send(message.payload)

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def send(self, datagram: bytes) -> bool:
        """Send a datagram; False if the system does not take it."""
        if self._socket is None:
            return False
        try:
            self._socket.sendto(datagram, self._target)
        except ConnectionRefusedError:  # nobody listened to an earlier one: that is their affair
            return True
        except OSError as error:
            if not self._fails:  # which is not told of each datagram
                self._fails = True
                log.warning("%s gets nothing: %s; others do", self.name, _why(error))
            return False
        if self._fails:
            self._fails = False
            log.warning("%s gets what is sent again", self.name)
        return True

    def _prepare_multicast(self, opened: socket.socket) -> None:
        is_4 = opened.family == socket.AF_INET
        level = socket.IPPROTO_IP if is_4 else socket.IPPROTO_IPV6
        hops = socket.IP_MULTICAST_TTL if is_4 else socket.IPV6_MULTICAST_HOPS
        opened.setsockopt(level, hops, self.settings.ttl)
        interface = self.settings.interface
        if interface is None:
            return
        try:
            if is_4:
                address, index = _interface_4(interface)
                one = struct.pack("@4s4si", b"", address, index) if index else address
                opened.setsockopt(level, socket.IP_MULTICAST_IF, one)
            else:
                index = socket.if_nametoindex(interface)
                opened.setsockopt(level, socket.IPV6_MULTICAST_IF, index)
        except OSError as error:
            self.close()
            what = f"{self._key}.interface: {interface!a}"
            raise TransportError(f"{what}: {_why(error)}") from None


def _why(error: OSError) -> str:
    return error.strerror or str(error)

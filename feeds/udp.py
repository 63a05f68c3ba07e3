"""ASTERIX over UDP, unicast and multicast: one data block a datagram, as trackers take it."""

from __future__ import annotations

import ipaddress
import socket
from dataclasses import dataclass
from typing import Annotated

from pydantic import AfterValidator, Field

from plotfeed.feeds.message import Message
from plotfeed.feeds.parts import Name, Part
from plotfeed.proto.errors import PlotfeedError

MIN_OCTETS, USUAL_OCTETS, MAX_OCTETS = 64, 1400, 65_000


class UdpError(PlotfeedError):
    """A destination that cannot be sent to."""

    exit_code = 1


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A numeric address and a port."""

    address: ipaddress.IPv4Address | ipaddress.IPv6Address
    port: int

    @classmethod
    def parse(cls, text: str) -> Endpoint:
        """From 239.1.2.3:8600 or [ff02::1]:8600; raises `ValueError`."""
        host, colon, port = text.rpartition(":")
        try:
            address = ipaddress.ip_address(host.removeprefix("[").removesuffix("]"))
            number = int(port) if port.isascii() and port.isdigit() else 0
        except ValueError:
            number, colon = 0, ""
        if not colon or not 0 < number < 65536:
            raise ValueError(f"expected ADDRESS:PORT such as 239.255.0.1:8600, not {text!r}")
        return cls(address, number)


def _endpoint(text: str) -> str:
    Endpoint.parse(text)
    return text


class UdpDestination(Part):
    """A [[udp]] of the scene: where ASTERIX goes besides MQTT."""

    destination: Annotated[str, AfterValidator(_endpoint)]
    """ADDRESS:PORT, numeric; a multicast group or one host."""
    sensors: Annotated[tuple[Name, ...], Field(strict=False)] = ()
    """Whose messages go there; all sensors' if it is left out."""
    ttl: Annotated[int, Field(ge=0, le=255)] = 1
    """Of multicast datagrams: 1 stays in the local network."""
    interface: str | None = None
    """By which multicast leaves: its IPv4 address, or for IPv6 its name."""
    max_octets: Annotated[int, Field(ge=MIN_OCTETS, le=MAX_OCTETS)] = USUAL_OCTETS
    """Of a datagram; data blocks are cut to fit."""

    def takes(self, sensor: str) -> bool:
        """Whether that sensor's messages go there."""
        return not self.sensors or sensor in self.sensors


class UdpLink:
    """A socket that sends the ASTERIX among the messages to one destination, and never waits."""

    def __init__(self, settings: UdpDestination) -> None:
        endpoint = Endpoint.parse(settings.destination)
        family = socket.AF_INET if endpoint.address.version == 4 else socket.AF_INET6
        self._target = (str(endpoint.address), endpoint.port)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            if endpoint.address.is_multicast:
                self._prepare_multicast(family, settings)
        except (OSError, ValueError) as error:
            self._socket.close()
            why = f"interface {settings.interface!r}, ttl {settings.ttl}: {error}"
            raise UdpError(f"udp {settings.destination}: {why}") from None

    def publish(self, message: Message) -> bool:
        """Send what is ASTERIX; False if the system did not take it."""
        if not message.content_type.startswith("application/x-asterix"):
            return True
        try:
            self._socket.sendto(message.payload, self._target)
        except ConnectionRefusedError:  # nobody listened to an earlier one: that is their affair
            return True
        except OSError:
            return False
        return True

    async def drain(self, timeout_s: float = 1.0) -> None:
        """Nothing is kept that could take any time."""

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _prepare_multicast(self, family: int, settings: UdpDestination) -> None:
        if family == socket.AF_INET:
            self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, settings.ttl)
            if settings.interface is not None:
                packed = ipaddress.IPv4Address(settings.interface).packed
                self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, packed)
            return
        self._socket.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, settings.ttl)
        if settings.interface is not None:
            index = socket.if_nametoindex(settings.interface)
            self._socket.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_IF, index)

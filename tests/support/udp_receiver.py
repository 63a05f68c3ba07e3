"""An ordinary socket that receives what sessions send by UDP."""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from support import sessions
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.session.observer import Observer

START = "2026-01-01T12:00:00.05Z"
LOOPBACK_INTERFACE = "lo"


@contextlib.contextmanager
def receiver(host: str = "127.0.0.1", group: str | None = None) -> Iterator[socket.socket]:
    """A socket with much room, so that nothing is lost before it is read."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as ears:
        ears.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        scope = (0, socket.if_nametoindex(interface_of(group))) if group and ":" in group else ()
        ears.bind((group or host, 0, *scope))
        if group is not None:
            try:
                join(ears, group)
            except OSError as error:
                pytest.skip(f"this machine's loopback has no multicast: {error}")
        ears.setblocking(False)
        yield ears


def join(ears: socket.socket, group: str) -> None:
    if ":" not in group:
        both = socket.inet_aton(group) + socket.inet_aton("127.0.0.1")
        ears.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, both)
        return
    index = socket.if_nametoindex(interface_of(group))
    both = socket.inet_pton(socket.AF_INET6, group) + struct.pack("@I", index)
    ears.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, both)


def interface_of(group: str) -> str:
    """Loopback's for IPv4. IPv6 has few routes to it; what is sent to ff11:: stays here anyway."""
    if ":" not in group:
        return LOOPBACK_INTERFACE
    for _, name in socket.if_nameindex():
        with contextlib.suppress(OSError), socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as out:
            index = socket.if_nametoindex(name)
            out.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_IF, index)
            out.sendto(b"", (group, 9))
            return name
    pytest.skip("no interface of this machine has a route for IPv6 multicast")


def heard(ears: socket.socket) -> list[bytes]:
    """What has come; on loopback that is what was sent."""
    datagrams = []
    with contextlib.suppress(BlockingIOError):
        while True:
            datagrams.append(ears.recv(1 << 16))
    return datagrams


def place(ears: socket.socket) -> str:
    host, port = ears.getsockname()[:2]
    host = host.partition("%")[0]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def destination(to: str, **keys: object) -> str:
    lines = [f"{name} = {value!r}".replace("'", '"') for name, value in keys.items()]
    return "\n".join(["[[udp]]", f'destination = "{to}"', *lines, ""])


def scene_with(udp: str, sensors: str | None = None) -> str:
    text = scene_text(start_utc=START, port=1883, sensors=sensors or radar(period_s=0.5))
    return f"{text}\n{udp}"


class Reader(Observer):
    """Reads what a socket has received whenever a message leaves, so that no buffer fills."""

    def __init__(self, ears: socket.socket) -> None:
        self._ears, self.datagrams = ears, list[bytes]()

    def after_link(self, _message: Message, _sent_utc_ns: int) -> None:
        self.datagrams += heard(self._ears)


def simulated(
    folder: Path, text: str, duration_s: float, ears: socket.socket
) -> tuple[SessionCounters, list[Message], list[bytes]]:
    """Totals of a session in simulated time, what left, and what was heard of it."""
    reader = Reader(ears)
    session = sessions.simulated(load(scene_file(folder, text)), duration_s, (), reader)
    return session.totals, [message for message, _ in session.said], reader.datagrams

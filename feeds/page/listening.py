"""The socket that the page is served on."""

from __future__ import annotations

import socket

from plotfeed.feeds.page.access import PageAddress
from plotfeed.proto.errors import PlotfeedError

ABORT_MS = 10_000
"""A connection whose other end takes nothing for so long is given up by the system, on Linux."""


class PageError(PlotfeedError):
    """The page cannot be served."""

    exit_code = 1


def listening(address: PageAddress) -> socket.socket:
    """A socket that listens there; raises `PageError` in one line."""
    where = f"--page {address.host}:{address.port}"
    listener = None
    try:
        found = socket.getaddrinfo(
            address.host, address.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )
        family, _, _, _, target = found[0]
        listener = socket.socket(family, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if hasattr(socket, "TCP_USER_TIMEOUT"):
            listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, ABORT_MS)
        listener.bind(target)
        listener.listen(100)
        listener.setblocking(False)
    except OSError as error:
        if listener is not None:
            listener.close()
        raise PageError(f"{where}: {error.strerror or error}") from None
    return listener

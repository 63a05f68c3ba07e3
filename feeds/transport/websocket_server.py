"""A WebSocket on which maps of others hear of tracks; it listens on loopback unless told not to."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from contextlib import AbstractAsyncContextManager
from http import HTTPStatus
from typing import TYPE_CHECKING

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import WebSocketKeys
from plotfeed.feeds.transport.local_hosts import LOOPBACK_NAMES, name_in_host
from plotfeed.feeds.transport.ways_out import ListeningTransport, wait_while

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

MAX_HEARD_OCTETS = 1 << 12  # Of what a client sends, which nobody reads


class WebSocketTransport(ListeningTransport):
    """A server whose clients are all told the same; who is slow loses the oldest messages."""

    def __init__(self, settings: WebSocketKeys, key: str = "websocket") -> None:
        """`key` is the destination's place in the scene; raises `PlotfeedError`."""
        need_extra("websockets", "a WebSocket", "page")
        super().__init__(settings, key, "ws")
        self.settings = settings
        self._clients: set[asyncio.Queue[bytes]] = set()

    async def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until clients have been given everything, or the time is up."""
        await wait_while(lambda: any(not queue.empty() for queue in self._clients), timeout_s)

    def listening(self) -> AbstractAsyncContextManager[object]:
        """The server, while there is one; entering raises `OSError`."""
        from websockets.asyncio.server import serve
        from websockets.typing import Origin

        # What clients do is their affair, and a page of everyone is not told of each.
        quiet = logging.getLogger(f"{__name__}.connections")
        quiet.setLevel(logging.CRITICAL)
        return serve(
            self._attend,
            self.settings.host,
            self.settings.port,
            process_request=self._refusal,
            origins=[None, *map(Origin, self.settings.origins)],
            max_size=MAX_HEARD_OCTETS,
            server_header=None,
            logger=quiet,
        )

    def give(self, message: Message) -> bool | None:
        """Give each client the message; None where there is none."""
        for queue in self._clients:
            if queue.full():
                queue.get_nowait()
            queue.put_nowait(message.payload)
        return bool(self._clients) or None

    def _refusal(self, connection: ServerConnection, request: Request) -> Response | None:
        """Why a request is not let in: by another name than this host's, or one too many."""
        on_loopback = self.settings.host in LOOPBACK_NAMES
        hosts = {name_in_host(host) for host in request.headers.get_all("Host")}
        if on_loopback and not hosts <= LOOPBACK_NAMES:
            return connection.respond(HTTPStatus.FORBIDDEN, "ask for this host by its own name\n")
        if len(self._clients) >= self.settings.max_clients:
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "too many clients\n")
        return None

    async def _attend(self, client: ServerConnection) -> None:
        """Send one client what it is to be told, until it goes; what it says is not heard."""
        queue: asyncio.Queue[bytes] = asyncio.Queue(self.settings.queue_messages)
        self._clients.add(queue)
        telling = asyncio.create_task(_tell_on(queue, client))
        try:
            async for _ in client:
                pass
        finally:
            telling.cancel()
            self._clients.discard(queue)


async def _tell_on(queue: asyncio.Queue[bytes], client: ServerConnection) -> None:
    from websockets.exceptions import ConnectionClosed

    with contextlib.suppress(ConnectionClosed):
        while True:
            await client.send((await queue.get()).decode())

"""Ports of ours at which others connect: a WebSocket for maps, a service of network Remote ID.

They listen on loopback unless they are told not to.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import logging
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import AbstractAsyncContextManager
from http import HTTPStatus
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, unquote, urlsplit

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.console.printed import bracketed
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.transports import ImmediateTransport
from plotfeed.feeds.scene.output_keys import ListeningDestination, RemoteIdService, WebSocketKeys
from plotfeed.feeds.transport.http import token_of
from plotfeed.feeds.transport.local_hosts import LOOPBACK_NAMES, name_in_host
from plotfeed.feeds.transport.peers import PEER_LIMITS, Places
from plotfeed.feeds.transport.ways_out import TransportError, wait_while
from plotfeed.proto.tracks.remote_id_answers import MAX_DIAGONAL_M, DisplayArea, KnownFlights

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

MAX_HEARD_OCTETS = 1 << 12  # Of what a client sends, which nobody reads
ASKING = PEER_LIMITS["service of network Remote ID: a request"]


class ListeningTransport(ImmediateTransport):
    """Listens on a port while `run` runs, and tells who connects what goes there.

    What finds nobody is left to others.
    """

    to = ""

    def __init__(self, settings: ListeningDestination, key: str, scheme: str) -> None:
        """`key` is the destination's place in the scene, `scheme` that of its address."""
        self.name = f"{key} {scheme}://{bracketed(settings.host)}:{settings.port}"
        self.settings, self._carried = settings, settings.content_type
        self._key = key
        self._is_up = asyncio.Event()
        self._error: TransportError | None = None

    def listening(self) -> AbstractAsyncContextManager[object]:
        """The port, open meanwhile; entering raises `OSError`."""
        raise NotImplementedError

    def is_asked_here(self, hosts: Iterable[str]) -> bool:
        """Whether a request with these headers Host was made to a name of where it listens."""
        names = {name_in_host(host) for host in hosts}
        return self.settings.host not in LOOPBACK_NAMES or names <= LOOPBACK_NAMES

    def carries(self, message: Message) -> bool:
        """Whether it is of the format that goes there."""
        return message.content_type == self._carried

    async def wait_until_up(self, timeout_s: float | None = None) -> None:
        """Return once it listens; raises `TransportError` if it cannot."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                await self._is_up.wait()
        if self._error is not None:
            raise self._error

    async def run(self) -> None:
        """Listen until cancelled; return if the port cannot be had."""
        try:
            async with self.listening():
                self._is_up.set()
                await asyncio.Future()
        except OSError as error:
            what = f"{self._key}.port: {self.settings.port}"
            self._error = TransportError(f"{what}: {error.strerror or error}")
            self._is_up.set()


class WebSocketTransport(ListeningTransport):
    """A server whose clients are all told the same; who is slow loses the oldest messages."""

    def __init__(self, settings: WebSocketKeys, key: str = "websocket") -> None:
        """`key` is the destination's place in the scene; raises `PlotfeedError`."""
        need_extra("websockets", "a WebSocket", "page")
        super().__init__(settings, key, "ws")
        self.settings: WebSocketKeys = settings
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
        if not self.is_asked_here(request.headers.get_all("Host")):
            return connection.respond(HTTPStatus.FORBIDDEN, "ask for this host by its own name\n")
        if len(self._clients) >= self.settings.max_clients:
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "too many clients\n")
        return None

    async def _attend(self, client: ServerConnection) -> None:
        """Send one client what it is to be told, until it goes; what it says is not heard."""
        from websockets.exceptions import ConnectionClosed

        queue: asyncio.Queue[bytes] = asyncio.Queue(self.settings.queue_messages)

        async def tell_on() -> None:
            with contextlib.suppress(ConnectionClosed):
                while True:
                    await client.send((await queue.get()).decode())

        self._clients.add(queue)
        telling = asyncio.create_task(tell_on())
        try:
            async for _ in client:
                pass
        finally:
            telling.cancel()
            self._clients.discard(queue)


class RefusedRequest(Exception):  # noqa: N818 - what happened to it, not what broke
    """A request that gets no answer but a status and a line that says why."""

    def __init__(self, status: HTTPStatus, why: str) -> None:
        super().__init__(why)
        self.status, self.why = status, why


class RemoteIdTransport(ListeningTransport):
    """A port at which the flights of a provider and the data of a display are asked for."""

    def __init__(
        self,
        settings: RemoteIdService,
        now_utc_ns: Callable[[], int],
        key: str = "remote_id_service",
    ) -> None:
        """`key` is the destination's place in the scene; raises `AccessError`."""
        super().__init__(settings, key, "http")
        self._now_utc_ns = now_utc_ns
        self._token = ""
        if settings.token is not None:
            self._token = token_of(settings.token, f"{key}.token")
        self._flights = KnownFlights()
        self._places = Places[asyncio.StreamWriter](ASKING)

    @contextlib.asynccontextmanager
    async def listening(self) -> AsyncIterator[None]:
        """The server, while there is one; entering raises `OSError`."""
        server = await asyncio.start_server(
            self._attend, self.settings.host, self.settings.port, limit=ASKING.octets
        )
        try:
            yield
        finally:
            server.close()

    def give(self, message: Message) -> bool | None:
        """Know what it tells, for whoever will ask."""
        # A link may have flipped a bit of it: what is no JSON any more tells nothing.
        with contextlib.suppress(ValueError, TypeError, KeyError):
            self._flights.take(json.loads(message.payload)["flights"])
        return True

    async def _attend(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer one request, and hang up."""
        host = (writer.get_extra_info("peername") or ("",))[0]
        self._places.take(writer, host, writer.transport.abort)
        try:
            head = await reader.readuntil(b"\r\n\r\n")
            self._places.heard(writer)
            writer.write(self._answer(head.decode("latin-1")))
            await writer.drain()
            writer.close()
            await writer.wait_closed()
        except (OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass  # who does not ask as one does, or has gone, is told nothing
        finally:
            self._places.give_up(writer)
            writer.transport.abort()

    def _answer(self, head: str) -> bytes:
        try:
            status, told = HTTPStatus.OK, self._told(*_request(head))
        except RefusedRequest as refused:
            status, told = refused.status, {"message": refused.why}
        body = json.dumps(told, separators=(",", ":")).encode()
        more = "WWW-Authenticate: Bearer\r\n" if status is HTTPStatus.UNAUTHORIZED else ""
        return (
            f"HTTP/1.1 {status.value} {status.phrase}\r\nContent-Type: application/json\r\n"
            f"Content-Length: {len(body)}\r\n{more}Cache-Control: no-store\r\n"
            "Connection: close\r\n\r\n"
        ).encode() + body

    def _told(self, path: str, fields: dict[str, str]) -> dict[str, Any]:
        """The answer to a request; raises `RefusedRequest`."""
        if not self.is_asked_here([fields.get("host", "")]):
            raise RefusedRequest(HTTPStatus.FORBIDDEN, "ask for this host by its own name")
        if "origin" in fields:
            raise RefusedRequest(HTTPStatus.FORBIDDEN, "web pages are not answered")
        said = fields.get("authorization", "").encode()
        if self._token and not hmac.compare_digest(said, f"Bearer {self._token}".encode()):
            raise RefusedRequest(HTTPStatus.UNAUTHORIZED, "expected the bearer token")
        parts = urlsplit(path)
        asked, now_ns = parse_qs(parts.query), self._now_utc_ns()
        match parts.path.strip("/").split("/"):
            case ["uss", "flights"]:
                return self._flights.flights(_view(asked), now_ns, _recent_s(asked))
            case ["uss", "flights", flight, "details"]:
                return {"details": {"id": self._known(flight, now_ns)}}
            case ["display_data"]:
                return self._flights.display_data(_view(asked), now_ns)
            case ["display_data", flight]:
                return {"uas": {"id": self._known(flight, now_ns)}}
        where = "/uss/flights, /uss/flights/ID/details, /display_data or /display_data/ID"
        raise RefusedRequest(HTTPStatus.NOT_FOUND, f"expected {where}")

    def _known(self, quoted: str, now_ns: int) -> str:
        flight = unquote(quoted)
        if not self._flights.holds(flight, now_ns):
            raise RefusedRequest(HTTPStatus.NOT_FOUND, "no such flight in the last minute")
        return flight


def _request(head: str) -> tuple[str, dict[str, str]]:
    """Path and fields of the head of a request; raises `RefusedRequest`."""
    first, *lines = head.split("\r\n")
    method, _, rest = first.partition(" ")
    path, _, version = rest.rpartition(" ")
    if not version.startswith("HTTP/1") or not path.startswith("/"):
        raise RefusedRequest(HTTPStatus.BAD_REQUEST, "expected HTTP/1.1")
    if method != "GET":
        raise RefusedRequest(HTTPStatus.METHOD_NOT_ALLOWED, "expected GET")
    fields = (line.partition(":") for line in lines)
    return path, {name.strip().lower(): value.strip() for name, _, value in fields}


def _view(asked: dict[str, list[str]]) -> DisplayArea:
    try:
        view = DisplayArea.parse(asked.get("view", [""])[0])
    except ValueError as error:
        raise RefusedRequest(HTTPStatus.BAD_REQUEST, str(error)) from None
    if view.diagonal_m > MAX_DIAGONAL_M:
        what = f"the view's diagonal is {view.diagonal_m:.0f} m; expected at most 7000"
        raise RefusedRequest(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, what)
    return view


def _recent_s(asked: dict[str, list[str]]) -> float:
    text = asked.get("recent_positions_duration", ["0"])[0]
    try:
        return float(text)
    except ValueError:
        what = "expected recent_positions_duration in seconds"
        raise RefusedRequest(HTTPStatus.BAD_REQUEST, what) from None

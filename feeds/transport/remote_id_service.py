"""A service of network Remote ID, which answers whoever asks for tracks over HTTP."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import os
from collections.abc import AsyncIterator, Callable, Mapping
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import RemoteIdService
from plotfeed.feeds.transport.http import token_of
from plotfeed.feeds.transport.local_hosts import LOOPBACK_NAMES, name_in_host
from plotfeed.feeds.transport.peers import PEER_LIMITS, Places
from plotfeed.feeds.transport.ways_out import ListeningTransport
from plotfeed.proto.tracks.remote_id_answers import MAX_DIAGONAL_M, DisplayArea, KnownFlights

ASKING = PEER_LIMITS["service of network Remote ID: a request"]


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
        environment: Mapping[str, str] = os.environ,
    ) -> None:
        """`key` is the destination's place in the scene; raises `AccessError`."""
        super().__init__(settings, key, "http")
        self.settings = settings
        self._now_utc_ns = now_utc_ns
        self._token = ""
        if settings.token is not None:
            self._token = token_of(settings.token, f"{key}.token", environment)
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
        on_loopback = self.settings.host in LOOPBACK_NAMES
        if on_loopback and name_in_host(fields.get("host", "")) not in LOOPBACK_NAMES:
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

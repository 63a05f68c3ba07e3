"""The page's web application: who is let in, its files, its feed; what it forbids a browser."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
import logging
from collections.abc import Callable, Generator, Mapping
from functools import partial
from importlib.resources import files
from typing import TYPE_CHECKING, Any, ClassVar
from urllib.parse import parse_qs

import h11
import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol

from plotfeed.feeds.page.page_access import AUDIENCE_PATH, Audience, PageAccess, Role
from plotfeed.feeds.page.updates import (
    MAX_COMMAND_OCTETS,
    Controls,
    Viewer,
    ViewRequest,
    request_in,
)
from plotfeed.feeds.page.view import View
from plotfeed.feeds.transport.peers import PEER_LIMITS, Places
from plotfeed.proto.errors import PlotfeedError

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'{socket}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
SAFE_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-cache",
}
COOKIE_S = 30 * 86_400


class PageGuard:
    """ASGI middleware that lets requests pass, or answers them."""

    def __init__(self, app: ASGIApp, access: PageAccess) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request pass, or answer it."""
        headers = Headers(scope=scope)
        answer = self._answer(scope, headers)
        if answer is None:
            await self._app(scope, receive, _with_headers(send, headers.get("host", "")))
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 4403})
        else:
            await answer(scope, receive, _with_headers(send, ""))

    def _answer(self, scope: Scope, headers: Headers) -> Response | None:
        access = self._access
        if not access.host_is_ours(headers):
            return PlainTextResponse("This page is not here under that name.\n", 421)
        if scope["type"] == "websocket" and not access.origin_is_ours(headers):
            return PlainTextResponse("Only the page itself may ask this.\n", 403)
        path = scope["path"]
        tokens = parse_qs(scope["query_string"].decode("latin-1")).get("token", [])
        role = access.role_with(tokens[0]) if tokens and scope["type"] == "http" else None
        if role is not None:
            return self._let_in(tokens[0], role, path)
        if not access.may_ask(headers, path):
            return PlainTextResponse(
                "This page needs the address that plotfeed printed, with its token.\n", 403
            )
        return None

    def _let_in(self, token: str, role: Role, path: str) -> Response:
        """Keep the token in a cookie, and out of the address."""
        is_audience = role is Role.AUDIENCE or path.startswith(AUDIENCE_PATH)
        answer = RedirectResponse(f"{AUDIENCE_PATH}/" if is_audience else "/", 303)
        answer.set_cookie(
            self._access.cookie(role), token, max_age=COOKIE_S, httponly=True, samesite="lax"
        )
        return answer


def _with_headers(send: Send, host: str) -> Send:
    # 'self' holds for WebSockets too, but not in every browser that is still about.
    socket = f" ws://{host}" if host and all(c.isalnum() or c in ".-:[]" for c in host) else ""

    async def send_on(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers.update(SAFE_HEADERS)
            headers["Content-Security-Policy"] = POLICY.format(socket=socket)
        await send(message)

    return send_on


STALLED_S = 5.0  # A viewer that takes nothing for so long is dropped
MAX_VIEWERS = 50
MAX_CONNECTIONS = 200
MEDIA_TYPES = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
}
FIRST_FILE = "page.html"
# Errors where a viewer only went or stalled.
WENT = (WebSocketDisconnect, TimeoutError, RuntimeError, OSError)
log = logging.getLogger("plotfeed")


class Application:
    """A view, as browsers ask for it."""

    def __init__(
        self,
        viewers: set[Viewer],
        view: View,
        controls: Controls,
        now_utc_ns: Callable[[], int],
        audience_url: str,
    ) -> None:
        """`viewers` are those who look, here and elsewhere; `now_utc_ns` tells the view's time."""
        self._audience = Audience()
        self._audience_url = audience_url
        self._viewers = viewers
        self._view = view
        self._controls = controls
        self._now_utc_ns = now_utc_ns
        self._files = _static_files()
        self._build = hashlib.sha256(b"".join(self._files.values())).hexdigest()[:16]

    def server(self, access: PageAccess) -> uvicorn.Server:
        """What serves it to those who may see it; loaded to the last library."""
        config = uvicorn.Config(
            PageGuard(self._routes(), access),
            http=_Impatient,
            ws="websockets-sansio",
            ws_max_size=MAX_COMMAND_OCTETS,
            ws_per_message_deflate=False,
            ws_ping_interval=10.0,
            ws_ping_timeout=10.0,
            lifespan="off",
            log_config=None,
            log_level="critical",
            access_log=False,
            server_header=False,
            limit_concurrency=MAX_CONNECTIONS,
            timeout_keep_alive=2,
            timeout_graceful_shutdown=1,
        )
        config.load()
        return _Server(config)

    def _routes(self) -> Starlette:
        return Starlette(
            routes=[
                Route("/basemap", self._basemap),
                Route("/", self._file),
                Route(f"{AUDIENCE_PATH}/", self._file),
                Route(AUDIENCE_PATH, self._audience_page),
                Route("/{name}", self._file),
                WebSocketRoute("/feed", partial(self._feed, role=Role.PRESENTER)),
                WebSocketRoute(f"{AUDIENCE_PATH}/feed", partial(self._feed, role=Role.AUDIENCE)),
            ]
        )

    async def _file(self, request: Request) -> Response:
        name = request.path_params.get("name", FIRST_FILE)
        found = self._files.get(name)
        if found is None:
            return PlainTextResponse("There is no such page.\n", 404)
        return Response(found, media_type=MEDIA_TYPES[name.rpartition(".")[2]])

    async def _basemap(self, _request: Request) -> Response:
        basemap = self._view.basemap
        if basemap is None:
            return PlainTextResponse("The scene names no basemap.\n", 404)
        return Response(basemap.content, media_type=basemap.media_type)

    async def _audience_page(self, _request: Request) -> Response:
        return RedirectResponse(f"{AUDIENCE_PATH}/", 303)

    async def _feed(self, websocket: WebSocket, role: Role) -> None:
        """Serve one viewer for as long as it stays."""
        if sum(viewer.role is role for viewer in self._viewers) >= MAX_VIEWERS:
            await websocket.close(1013)
            return
        await websocket.accept()
        hello = {"build": self._build}
        if role is Role.PRESENTER:
            hello["audience_url"] = self._audience_url
        await websocket.send_text(json.dumps(hello))
        viewer = Viewer(lambda: self._view.snapshot(self._now_utc_ns()), self._audience, role)
        self._viewers.add(viewer)
        sending = asyncio.create_task(_send(websocket, viewer), name="viewer")
        receiving = asyncio.create_task(self._receive(websocket, viewer), name="viewer-commands")
        try:
            await asyncio.wait({sending, receiving}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._viewers.discard(viewer)
            self._watch()
            for task in (sending, receiving):
                task.cancel()
            for result in await asyncio.gather(sending, receiving, return_exceptions=True):
                if isinstance(result, Exception) and not isinstance(result, WENT):
                    log.warning("a viewer of the page was lost: %r", result)

    async def _receive(self, websocket: WebSocket, viewer: Viewer) -> None:
        """Take what a viewer says, one thing after the other."""
        while True:
            message = await websocket.receive()
            if message["type"] == "websocket.disconnect":
                return
            answer = await self._answer(message.get("text"), viewer)
            async with asyncio.timeout(STALLED_S):
                await websocket.send_text(json.dumps(answer, default=str))

    async def _answer(self, text: str | None, viewer: Viewer) -> dict[str, object]:
        """Answer a request about what is shown, or a command."""
        number = None
        try:
            request = request_in(text)
            if isinstance(request, ViewRequest):
                self._look(viewer, request)
                return {"looking": True}
            number = request.number
            self._audience.check_command(viewer.role, request.command)
            in_force = await self._carried_out(request.command)
        except PlotfeedError as error:
            return {"number": number, "ok": False, "error": " ".join(str(error).split())}
        self._audience.log(self._now_utc_ns(), viewer.who, request.command)
        self._view.tell(audience=self._audience.news, actions=self._audience.actions)
        return {"number": number, "ok": True, "in_force": in_force}

    def _look(self, viewer: Viewer, request: ViewRequest) -> None:
        """Show a viewer what he looks at; raises `PlotfeedError` if the truth is not among it."""
        viewer.watched, viewer.name = request.watched, request.name
        self._watch()
        self._audience.check_look(viewer.role, truth=request.truth)
        viewer.show_truth(shown=request.truth)

    async def _carried_out(self, command: dict[str, Any]) -> Mapping[str, Any]:
        """What is in force after a command of who may give it."""
        if "audience" not in command:
            return await self._controls.apply(command)
        before = self._audience.truth
        self._audience.give(command["audience"])
        if self._audience.truth != before:
            for viewer in self._viewers:
                if viewer.role is Role.AUDIENCE:
                    viewer.show_truth(shown=False)
                    viewer.start_again()
        return {**self._audience.news, "url": self._audience_url}

    def _watch(self) -> None:
        self._view.watch(sensor for viewer in self._viewers for sensor in viewer.watched)


class _Impatient(H11Protocol):
    """A connection that is closed when its request does not come; the oldest when many are so."""

    half_asked: ClassVar[Places[_Impatient]] = Places(PEER_LIMITS["live page: a request"])

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Give it some time."""
        super().connection_made(transport)
        self._wait()

    def data_received(self, data: bytes) -> None:
        """Take what comes; a request that has begun anew has as much time as the first."""
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE:
            self.half_asked.give_up(self)
        elif self not in self.half_asked:
            self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing comes any more."""
        self.half_asked.give_up(self)
        super().connection_lost(exc)

    def _wait(self) -> None:
        host = (self.transport.get_extra_info("peername") or ("",))[0]
        self.half_asked.take(self, host, self.transport.abort)


class _Server(uvicorn.Server):
    """A server that leaves signals to the session."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        """Do not."""
        yield


async def _send(websocket: WebSocket, viewer: Viewer) -> None:
    """Send updates as fast as they are taken."""
    while True:
        update = await viewer.next()
        async with asyncio.timeout(STALLED_S):
            await websocket.send_bytes(update)


def _static_files() -> dict[str, bytes]:
    """Every file that browsers may ask for, by name."""
    folder = files("plotfeed.feeds.page") / "static"
    return {
        path.name: path.read_bytes()
        for path in folder.iterdir()
        if path.name.rpartition(".")[2] in MEDIA_TYPES
    }

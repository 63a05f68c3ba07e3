"""The page's web application: its files, its feed, and the commands of who looks at it.

Who loads this loads the libraries that only a page needs.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
import logging
from collections.abc import Callable, Generator
from importlib.resources import files

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from plotfeed.feeds.page.access import Access
from plotfeed.feeds.page.controls import (
    MAX_COMMAND_OCTETS,
    Controls,
    Look,
    refused,
    wish_in,
)
from plotfeed.feeds.page.guard import Guard
from plotfeed.feeds.page.view import View
from plotfeed.feeds.page.viewers import Viewer
from plotfeed.proto.errors import PlotfeedError

STALLED_S = 5.0
"""A viewer that takes nothing for so long is dropped."""
MAX_VIEWERS = 50
MAX_CONNECTIONS = 200
MEDIA_TYPES = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
}
FIRST_FILE = "page.html"
log = logging.getLogger("plotfeed")


class Application:
    """A view, as browsers ask for it."""

    def __init__(
        self,
        viewers: set[Viewer],
        view: View,
        controls: Controls,
        now_utc_ns: Callable[[], int],
    ) -> None:
        """`viewers` are those who look, here and elsewhere; `now_utc_ns` tells the view's time."""
        self._viewers = viewers
        self._view = view
        self._controls = controls
        self._now_utc_ns = now_utc_ns
        self._files = _static_files()
        self._build = hashlib.sha256(b"".join(self._files.values())).hexdigest()[:16]

    def server(self, access: Access) -> uvicorn.Server:
        """What serves it to those who may see it; loaded to the last library."""
        config = uvicorn.Config(
            Guard(self._routes(), access),
            http="h11",
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
            timeout_graceful_shutdown=1,
        )
        config.load()
        return _Server(config)

    def _routes(self) -> Starlette:
        return Starlette(
            routes=[
                Route("/basemap", self._basemap),
                Route("/", self._file),
                Route("/{name}", self._file),
                WebSocketRoute("/feed", self._feed),
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

    async def _feed(self, websocket: WebSocket) -> None:
        """One viewer, for as long as it stays."""
        if len(self._viewers) >= MAX_VIEWERS:
            await websocket.close(1013)
            return
        await websocket.accept()
        await websocket.send_text(json.dumps({"build": self._build}))
        viewer = Viewer(lambda: self._view.snapshot(self._now_utc_ns()))
        self._viewers.add(viewer)
        sending = asyncio.create_task(_send(websocket, viewer), name="viewer")
        hearing = asyncio.create_task(self._hear(websocket, viewer), name="viewer-commands")
        try:
            await asyncio.wait({sending, hearing}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._viewers.discard(viewer)
            self._watch()
            for task in (sending, hearing):
                task.cancel()
            for result in await asyncio.gather(sending, hearing, return_exceptions=True):
                _log_unexpected(result)

    async def _hear(self, websocket: WebSocket, viewer: Viewer) -> None:
        """What a viewer says, one thing after the other."""
        while True:
            text = await websocket.receive_text()
            answer = await self._answer(text, viewer)
            async with asyncio.timeout(STALLED_S):
                await websocket.send_text(json.dumps(answer, default=str))

    async def _answer(self, text: str, viewer: Viewer) -> dict[str, object]:
        """To wishes about what is shown, and to commands."""
        number = None
        try:
            wish = wish_in(text)
            if isinstance(wish, Look):
                viewer.watched = wish.watched
                self._watch()
                viewer.show_truth(shown=wish.truth)
                return {"looking": True}
            number = wish.number
            return {"number": number, **await self._controls.apply(wish.command)}
        except PlotfeedError as error:
            return {"number": number, **refused(str(error))}

    def _watch(self) -> None:
        self._view.watch(sensor for viewer in self._viewers for sensor in viewer.watched)


class _Server(uvicorn.Server):
    """One that leaves signals to the session."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        """Do not."""
        yield


async def _send(websocket: WebSocket, viewer: Viewer) -> None:
    """Frames, as fast as they are taken."""
    while True:
        frame = await viewer.next()
        async with asyncio.timeout(STALLED_S):
            await websocket.send_bytes(frame)


def _log_unexpected(result: object) -> None:
    """That a viewer went or stalled is no news."""
    if isinstance(result, Exception) and not isinstance(
        result, WebSocketDisconnect | TimeoutError | RuntimeError | OSError
    ):
        log.warning("a viewer of the page was lost: %r", result)


def _static_files() -> dict[str, bytes]:
    """Every file that browsers may ask for, by name."""
    folder = files("plotfeed.feeds.page") / "static"
    return {
        path.name: path.read_bytes()
        for path in folder.iterdir()
        if path.name.rpartition(".")[2] in MEDIA_TYPES
    }

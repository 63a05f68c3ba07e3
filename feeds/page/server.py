"""Serves the page from within a session's own event loop, and takes its commands."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
import logging
import socket
import time
from collections.abc import AsyncIterator, Callable, Generator
from importlib.resources import files

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from plotfeed.feeds.page.access import Access, PageAddress
from plotfeed.feeds.page.controls import (
    MAX_COMMAND_OCTETS,
    Controls,
    Look,
    refused,
    wish_in,
)
from plotfeed.feeds.page.guard import Guard
from plotfeed.feeds.page.listening import listening
from plotfeed.feeds.page.view import View
from plotfeed.feeds.page.viewers import Viewer
from plotfeed.proto.errors import PlotfeedError

UPDATE_EVERY_S = 0.1
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


class PageServer:
    """A view, served at an address."""

    def __init__(
        self,
        address: PageAddress,
        view: View,
        controls: Controls,
        now_utc_ns: Callable[[], int],
        *,
        token: str | None = None,
    ) -> None:
        """`now_utc_ns` tells the session's time; without a token, one is drawn where needed."""
        self.viewers: set[Viewer] = set()
        self._view = view
        self._controls = controls
        self._now_utc_ns = now_utc_ns
        self._socket = listening(address)
        port = self._socket.getsockname()[1]
        self._address = PageAddress(address.host, port)
        self._access = Access(self._address, token)
        self._files = _static_files()
        self._build = hashlib.sha256(b"".join(self._files.values())).hexdigest()[:16]

    @property
    def url(self) -> str:
        """Where to look, with the token if one is needed."""
        host = self._address.host
        if host in {"0.0.0.0", "::"}:  # noqa: S104 - of an address to print
            host = socket.gethostname()
        shown = f"[{host}]" if ":" in host else host
        token = f"?token={self._access.token}" if self._access.token else ""
        return f"http://{shown}:{self._address.port}/{token}"

    def close(self) -> None:
        """Give up the address, if it was never served."""
        self._socket.close()

    async def run(self) -> None:
        """Serve until cancelled."""
        server = _Server(
            uvicorn.Config(
                Guard(self._application(), self._access),
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
        )
        serving = asyncio.create_task(server.serve([self._socket]), name="page")
        try:
            await self._publish()
        finally:
            server.should_exit = True
            for viewer in self.viewers:
                viewer.start_again()
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.wait_for(serving, 2.0)
            self._socket.close()

    async def _publish(self) -> None:
        """An update to every viewer, ten times a second on absolute deadlines."""
        due_s = time.monotonic()
        while True:
            due_s = max(due_s + UPDATE_EVERY_S, time.monotonic())
            await asyncio.sleep(due_s - time.monotonic())
            update = self._view.update(self._now_utc_ns(), time.monotonic())
            for viewer in self.viewers:
                if update.is_snapshot:
                    viewer.start_again()
                else:
                    viewer.offer(update)

    def _application(self) -> Starlette:
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
        if len(self.viewers) >= MAX_VIEWERS:
            await websocket.close(1013)
            return
        await websocket.accept()
        await websocket.send_text(json.dumps({"build": self._build}))
        viewer = Viewer(lambda: self._view.snapshot(self._now_utc_ns()))
        self.viewers.add(viewer)
        sending = asyncio.create_task(_send(websocket, viewer), name="viewer")
        hearing = asyncio.create_task(self._hear(websocket, viewer), name="viewer-commands")
        try:
            await asyncio.wait({sending, hearing}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self.viewers.discard(viewer)
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
        self._view.watch(sensor for viewer in self.viewers for sensor in viewer.watched)


class _Server(uvicorn.Server):
    """One that leaves signals to the session."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        """Do not."""
        yield


@contextlib.asynccontextmanager
async def serving(server: PageServer) -> AsyncIterator[str]:
    """The page for as long as this lasts; its URL. What goes wrong with it stops nobody."""
    task = asyncio.create_task(server.run(), name="page-server")
    task.add_done_callback(_told_of_failure)
    try:
        yield server.url
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError, Exception):
            await task


def _told_of_failure(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and task.exception() is not None:
        log.warning("the page is gone: %r", task.exception())


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

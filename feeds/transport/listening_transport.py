"""Ways out at a port of ours: who wants to know connects there, and is told what goes there."""

from __future__ import annotations

import asyncio
import contextlib
from contextlib import AbstractAsyncContextManager

from plotfeed.feeds.console.printed import bracketed
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.outgoing import ImmediateTransport
from plotfeed.feeds.scene.output_keys import ListeningDestination
from plotfeed.proto.errors import PlotfeedError


class PortError(PlotfeedError):
    """A port that cannot be listened on."""

    exit_code = 1


class ListeningTransport(ImmediateTransport):
    """Listens on a port while `run` runs, and tells who connects what goes there.

    What finds nobody is left to others.
    """

    to = ""

    def __init__(self, settings: ListeningDestination, key: str, scheme: str) -> None:
        """`key` is the destination's place in the scene, `scheme` that of its address."""
        self.name = f"{key} {scheme}://{bracketed(settings.host)}:{settings.port}"
        self._key, self._port = key, settings.port
        self._carried = settings.content_type
        self._is_up = asyncio.Event()
        self._error: PortError | None = None

    def listening(self) -> AbstractAsyncContextManager[object]:
        """The port, open meanwhile; entering raises `OSError`."""
        raise NotImplementedError

    def carries(self, message: Message) -> bool:
        """Whether it is of the format that goes there."""
        return message.content_type == self._carried

    async def wait_until_up(self, timeout_s: float | None = None) -> None:
        """Return once it listens; raises `PortError` if it cannot."""
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
            what = f"{self._key}.port: {self._port}"
            self._error = PortError(f"{what}: {error.strerror or error}")
            self._is_up.set()

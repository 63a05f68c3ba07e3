"""A network between a link and a broker, in the test's own event loop: a test cuts it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

HOST = "127.0.0.1"


class Proxy:
    """Passes on what comes, in both directions, as long as it may."""

    def __init__(self, to_port: int) -> None:
        self.port = 0
        self.is_closed = False  # Whether those that connect from now on are cut off at once
        # So many connections there are at a time, and those beyond are hung up on.
        self.most: int | None = None
        self.connections = 0
        self._to_port = to_port
        self._coming = 0
        self._wires: list[_Wire] = []

    def hold(self) -> None:
        """Let nothing through any more on the connections that there are, and say nothing."""
        for wire in self._wires:
            wire.open.clear()

    def cut(self) -> None:
        """Reset the connections that there are; what was not passed on is lost."""
        for wire in self._wires:
            wire.cut()
        self._wires.clear()

    async def came(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self.is_closed:
            writer.transport.abort()
            return
        self._wires = [wire for wire in self._wires if not wire.is_over]
        if self.most is not None and len(self._wires) + self._coming >= self.most:
            writer.close()
            return
        self._coming += 1
        try:
            there = await asyncio.open_connection(HOST, self._to_port)
        except OSError:
            writer.transport.abort()
            return
        finally:
            self._coming -= 1
        self.connections += 1
        self._wires.append(_Wire((reader, writer), there))


Ends = tuple[asyncio.StreamReader, asyncio.StreamWriter]


class _Wire:
    def __init__(self, here: Ends, there: Ends) -> None:
        self.open = asyncio.Event()
        self.open.set()
        self._writers = (here[1], there[1])
        self.tasks = [
            asyncio.create_task(self._pass(here[0], there[1])),
            asyncio.create_task(self._pass(there[0], here[1])),
        ]

    @property
    def is_over(self) -> bool:
        """Whether both sides have ended."""
        return all(task.done() for task in self.tasks)

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while data := await reader.read(1 << 16):
                await self.open.wait()
                writer.write(data)
                await writer.drain()
        writer.close()

    def cut(self) -> None:
        for task in self.tasks:
            task.cancel()
        for writer in self._writers:
            writer.transport.abort()


@asynccontextmanager
async def proxied(to_port: int) -> AsyncIterator[Proxy]:
    proxy = Proxy(to_port)
    server = await asyncio.start_server(proxy.came, HOST, 0)
    proxy.port = server.sockets[0].getsockname()[1]
    try:
        yield proxy
    finally:
        server.close()
        proxy.cut()
        await server.wait_closed()

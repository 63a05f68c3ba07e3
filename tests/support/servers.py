"""Servers in the test's own event loop: a network that a test cuts, and HTTP that does as told."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import AsyncIterator, Callable, Coroutine, Iterable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field

HOST = "127.0.0.1"
HANG_UP, SAY_NOTHING, BABBLE = "hang up", "say nothing", "babble"
Answer = int | str | bytes  # A status, one of these, or octets before it hangs up
Ends = tuple[asyncio.StreamReader, asyncio.StreamWriter]
Attend = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Coroutine[None, None, None]]


@asynccontextmanager
async def serving(
    attend: Attend, port: int = 0, tls: ssl.SSLContext | None = None
) -> AsyncIterator[int]:
    """The port of a server whose connections each have a task, which ends with the server."""
    tasks: set[asyncio.Task[None]] = set()

    def came(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        tasks.add(asyncio.create_task(attend(reader, writer)))

    server = await asyncio.start_server(came, HOST, port, ssl=tls)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


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
        if self.is_closed:  # meanwhile
            for each in (writer, there[1]):
                each.transport.abort()
            return
        self.connections += 1
        self._wires.append(_Wire((reader, writer), there))


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
    async with serving(proxy.came) as proxy.port:
        try:
            yield proxy
        finally:
            proxy.cut()


@dataclass
class HttpReceiver:
    """Answers one request after the other by a list, and with 201 once it is at its end."""

    answers: list[Answer]
    port: int = 0
    # Path, fields of the head in lower case, and body, of all that came whole.
    posts: list[tuple[str, dict[str, str], bytes]] = field(default_factory=list)
    connections: int = 0

    @property
    def bodies(self) -> list[bytes]:
        return [body for _, _, body in self.posts]

    async def attend(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        with suppress(EOFError, ConnectionError, asyncio.CancelledError):
            while True:
                head = (await reader.readuntil(b"\r\n\r\n")).decode().split("\r\n")
                fields = {
                    name.lower(): value.strip()
                    for name, _, value in (line.partition(":") for line in head[1:] if line)
                }
                body = await reader.readexactly(int(fields.get("content-length", 0)))
                self.posts.append((head[0].split()[1], fields, body))
                answer: Answer = self.answers.pop(0) if self.answers else 201
                if answer == HANG_UP:
                    break
                if answer == SAY_NOTHING:
                    await reader.read()
                    break
                if answer == BABBLE:
                    answer = b"\x00\xff" * 50_000
                if isinstance(answer, bytes):
                    writer.write(answer)
                    break
                text = b'{"message":"queued"}'
                length = f"Content-Length: {len(text)}"
                writer.write(f"HTTP/1.1 {answer} said\r\n{length}\r\n\r\n".encode() + text)
        writer.close()


@asynccontextmanager
async def http_receiver(
    answers: Iterable[Answer] = (), port: int = 0
) -> AsyncIterator[HttpReceiver]:
    receiver = HttpReceiver(list(answers))
    async with serving(receiver.attend, port) as receiver.port:
        yield receiver

"""HTTP servers for tests: they keep what is asked and posted, and answer as they are told to."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Iterable
from dataclasses import dataclass, field

HANG_UP, SAY_NOTHING, BABBLE = "hang up", "say nothing", "babble"
Answer = int | str | bytes  # A status, one of these, or octets before it hangs up


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
        with contextlib.suppress(EOFError, ConnectionError, asyncio.CancelledError):
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


@contextlib.asynccontextmanager
async def http_receiver(
    answers: Iterable[Answer] = (), port: int = 0
) -> AsyncIterator[HttpReceiver]:
    receiver = HttpReceiver(list(answers))
    server = await asyncio.start_server(receiver.attend, "127.0.0.1", port)
    receiver.port = server.sockets[0].getsockname()[1]
    try:
        yield receiver
    finally:
        server.close()

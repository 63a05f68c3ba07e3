"""HTTP/1.1 by asyncio's streams: what asks a server, and posts messages to it."""

from __future__ import annotations

import asyncio
import os
import re
import ssl
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import urlsplit
from uuid import uuid4

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import TOKEN_VARIABLE, HttpDestination
from plotfeed.feeds.transport.mqtt.address import AccessError, BrokerAccess
from plotfeed.feeds.transport.ways_out import QueuedTransport, SendError, within

DEFAULT_PORTS = {"http": 80, "https": 443}
MAX_HEAD_OCTETS = 1 << 16
STATUS = re.compile(rb"HTTP/1\.[01] (\d{3})(?: .*)?")


class HttpClient:
    """A server at one URL, and the connection to it, which is kept while its answers allow that.

    Nobody else is asked: neither where a redirect leads, nor a proxy of the environment.
    """

    def __init__(self, url: str, tls: ssl.SSLContext | None, fields: Sequence[str] = ()) -> None:
        """`fields` are lines of the head of each request, such as one with a token."""
        parts = urlsplit(url)
        self._host, self._port = str(parts.hostname), parts.port or DEFAULT_PORTS[parts.scheme]
        self._tls = tls
        target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        self._target = f"{target} HTTP/1.1"
        self._fields = [f"Host: {parts.netloc}", "User-Agent: plotfeed", *fields]
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def ask(
        self, method: str, fields: Sequence[str], body: bytes, *, timeout_s: float, most: int
    ) -> tuple[int, bytes | None]:
        """Status and body of the answer, this None if longer than `most`; raises `SendError`."""
        try:
            async with within(timeout_s, "no answer within"):
                return await self._answer(method, fields, body, most)
        except BaseException as error:
            self.hang_up()
            if isinstance(error, EOFError | ValueError):  # the stream ends, or a line does not
                raise SendError("it hung up, or its answer is not HTTP") from None
            raise

    def hang_up(self) -> None:
        """Close the connection, if there is one."""
        if self._streams is not None:
            self._streams[1].close()
            self._streams = None

    async def _answer(
        self, method: str, fields: Sequence[str], body: bytes, most: int
    ) -> tuple[int, bytes | None]:
        if self._streams is None:
            self._streams = await asyncio.open_connection(
                self._host, self._port, ssl=self._tls, limit=MAX_HEAD_OCTETS
            )
        reader, writer = self._streams
        lines = [f"{method} {self._target}", *self._fields, *fields]
        writer.write("".join(f"{line}\r\n" for line in lines).encode() + b"\r\n" + body)
        await writer.drain()
        status, told = await _head(reader)
        while status < 200:  # such as 100: there is more to come
            status, told = await _head(reader)
        length = told.get("content-length", "0" if status == 204 else "")
        if told.get("transfer-encoding", "").lower() == "chunked":
            answer = await _chunks(reader, most)
        elif length.isdecimal():
            answer = None if int(length) > most else await reader.readexactly(int(length))
        else:
            answer = await _rest(reader, most)
        ends = told.get("connection", "").lower() == "close" or reader.at_eof()
        if answer is None or ends:
            self.hang_up()
        return status, answer


async def _head(reader: asyncio.StreamReader) -> tuple[int, dict[str, str]]:
    """Status and fields of an answer, these in lower case; raises `EOFError` or `ValueError`."""
    try:
        head = await reader.readuntil(b"\r\n\r\n")
    except asyncio.LimitOverrunError:
        raise ValueError("a head without end") from None
    first, *lines = head[:-4].split(b"\r\n")
    found = STATUS.fullmatch(first)
    if found is None:
        raise ValueError("no HTTP")
    pairs = (line.decode("latin-1").partition(":") for line in lines)
    return int(found[1]), {name.strip().lower(): value.strip() for name, _, value in pairs}


async def _chunks(reader: asyncio.StreamReader, most: int) -> bytes | None:
    answer = b""
    while octets := int((await reader.readline()).partition(b";")[0], 16):
        if len(answer) + octets > most:
            return None
        answer += await reader.readexactly(octets)
        await reader.readexactly(2)
    while (await reader.readline()).strip():  # fields behind it
        pass
    return answer


async def _rest(reader: asyncio.StreamReader, most: int) -> bytes | None:
    answer = b""
    while more := await reader.read(MAX_HEAD_OCTETS):
        answer += more
        if len(answer) > most:
            return None
    return answer


# Of an answer, which is read so that the connection can be kept; more, and it is not.
MAX_BODY_OCTETS = 1 << 20
TRY_AGAIN = frozenset({408, 425, 429})  # Answers that ask for patience, as those from 500 on do
MEANINGS = {401: "is the token right?", 403: "may this token do that?", 422: "it wants other keys"}


class HttpTransport(QueuedTransport):
    """One address, and the connection to its server."""

    def __init__(self, settings: HttpDestination, key: str = "http") -> None:
        """`key` is the destination's place in the scene; raises `AccessError`."""
        url = settings.url.replace("{session}", str(uuid4()))
        parts = urlsplit(url)
        super().__init__(
            settings, f"{key} {parts.scheme}://{parts.netloc}{parts.path}", retries=settings.retries
        )
        tls = None
        if parts.scheme == "https":
            ca_file = None if settings.ca_file is None else Path(settings.ca_file)
            tls = BrokerAccess(ca_file=ca_file).tls_context()
        fields = []
        if settings.token is not None:
            token = token_of(settings.token, f"{key}.token")
            fields.append(f"Authorization: Bearer {token}")
        self._server = HttpClient(url, tls, fields)

    async def send(self, message: Message) -> None:
        """Post a message and read the answer; raises `SendError` unless it is one of 200 to 299."""
        kind = message.content_type.partition(";")[0]
        fields = [f"Content-Type: {kind}", f"Content-Length: {len(message.payload)}"]
        status, _ = await self._server.ask(
            "POST", fields, message.payload, timeout_s=self.settings.timeout_s, most=MAX_BODY_OCTETS
        )
        if 200 <= status < 300:
            return
        if 300 <= status < 400:
            why = f"it answers {status} and wants another address, such as one without a slash"
            raise SendError(why, is_final=True)
        what = f"it answers {status}" + (f": {MEANINGS[status]}" if status in MEANINGS else "")
        raise SendError(what, is_final=status < 500 and status not in TRY_AGAIN)

    def hang_up(self) -> None:
        """Close the connection, if there is one."""
        self._server.hang_up()


def token_of(name: str, key: str) -> str:
    """The token of that name in the environment; raises `AccessError`, which does not show it."""
    variable = f"{TOKEN_VARIABLE}{name}"
    token = os.environ.get(variable)
    if not token:
        raise AccessError(f"{key}: the environment has no {variable}")
    if not (token.isascii() and token.isprintable()) or " " in token:
        raise AccessError(f"{variable}: expected a token of printable ASCII without spaces")
    return token

"""Posts messages to a server by HTTP/1.1, one after the other on a connection that is kept."""

from __future__ import annotations

import asyncio
import os
import re
import ssl
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import urlsplit
from uuid import uuid4

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.track_output_keys import TOKEN_VARIABLE, HttpDestination
from plotfeed.feeds.transport.mqtt.address import AccessError, BrokerAccess
from plotfeed.feeds.transport.queued_transport import QueuedTransport, SendError

DEFAULT_PORTS = {"http": 80, "https": 443}
MAX_HEAD_OCTETS = 1 << 16
MAX_BODY_OCTETS = 1 << 20
"""Of an answer, which is read so that the connection can be kept; more, and it is not."""
TRY_AGAIN = frozenset({408, 425, 429})
"""Answers that ask for patience, as those from 500 on do."""
MEANINGS = {401: "is the token right?", 403: "may this token do that?", 422: "it wants other keys"}
STATUS = re.compile(rb"HTTP/1\.[01] (\d{3})(?: .*)?")


class HttpTransport(QueuedTransport):
    """One address, and the connection to its server."""

    def __init__(
        self,
        settings: HttpDestination,
        key: str = "http",
        environment: Mapping[str, str] = os.environ,
    ) -> None:
        """`key` is the destination's place in the scene; raises `AccessError`."""
        parts = urlsplit(settings.url.replace("{session}", str(uuid4())))
        super().__init__(
            settings, f"{key} {parts.scheme}://{parts.netloc}{parts.path}", retries=settings.retries
        )
        self._host, self._port = str(parts.hostname), parts.port or DEFAULT_PORTS[parts.scheme]
        self._timeout_s = settings.timeout_s
        self._tls: ssl.SSLContext | None = None
        if parts.scheme == "https":
            ca_file = None if settings.ca_file is None else Path(settings.ca_file)
            self._tls = BrokerAccess(ca_file=ca_file).tls_context()
        target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        lines = [f"POST {target} HTTP/1.1", f"Host: {parts.netloc}", "User-Agent: plotfeed"]
        if settings.token is not None:
            token = token_of(settings.token, f"{key}.token", environment)
            lines.append(f"Authorization: Bearer {token}")
        self._head = "".join(f"{line}\r\n" for line in lines).encode()
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def send(self, message: Message) -> None:
        """Post a message and read the answer; raises `SendError` unless it is one of 200 to 299."""
        try:
            async with asyncio.timeout(self._timeout_s):
                status = await self._posted(message)
        except TimeoutError:
            self.hang_up()
            raise SendError(f"no answer within {self._timeout_s:g} s") from None
        except ssl.SSLCertVerificationError as error:
            self.hang_up()
            raise SendError(f"its certificate: {error.verify_message}") from None
        except OSError as error:
            self.hang_up()
            raise SendError(error.strerror or str(error)) from None
        except (EOFError, ValueError):  # of a stream that ends, or of a line without end
            self.hang_up()
            raise SendError("it hung up, or its answer is not HTTP") from None
        if 200 <= status < 300:
            return
        if 300 <= status < 400:
            why = f"it answers {status} and wants another address, such as one without a slash"
            raise SendError(why, is_final=True)
        what = f"it answers {status}" + (f": {MEANINGS[status]}" if status in MEANINGS else "")
        raise SendError(what, is_final=status < 500 and status not in TRY_AGAIN)

    async def _posted(self, message: Message) -> int:
        """The status of the answer; raises `OSError`, `EOFError` or `ValueError`."""
        reader, writer = self._streams or await self._connected()
        kind = message.content_type.partition(";")[0]
        head = f"Content-Type: {kind}\r\nContent-Length: {len(message.payload)}\r\n\r\n"
        writer.write(self._head + head.encode() + message.payload)
        await writer.drain()
        status, fields = await _answer_head(reader)
        while status < 200:  # such as 100: there is more to come
            status, fields = await _answer_head(reader)
        length = fields.get("content-length", "0" if status == 204 else "")
        keeps = fields.get("connection", "").lower() != "close" and length.isdecimal()
        if keeps and int(length) <= MAX_BODY_OCTETS:
            await reader.readexactly(int(length))
        else:
            self.hang_up()
        return status

    async def _connected(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        self._streams = await asyncio.open_connection(
            self._host, self._port, ssl=self._tls, limit=MAX_HEAD_OCTETS
        )
        return self._streams

    def hang_up(self) -> None:
        """Close the connection, if there is one."""
        if self._streams is not None:
            self._streams[1].close()
            self._streams = None


async def _answer_head(reader: asyncio.StreamReader) -> tuple[int, dict[str, str]]:
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


def token_of(name: str, key: str, environment: Mapping[str, str]) -> str:
    """The token of that name in the environment; raises `AccessError`, which does not show it."""
    variable = f"{TOKEN_VARIABLE}{name}"
    token = environment.get(variable)
    if not token:
        raise AccessError(f"{key}: the environment has no {variable}")
    if not (token.isascii() and token.isprintable()) or " " in token:
        raise AccessError(f"{variable}: expected a token of printable ASCII without spaces")
    return token

"""Asks a server over HTTP/1.1 by asyncio's streams: one request, then its answer."""

from __future__ import annotations

import asyncio
import re
import ssl
from collections.abc import Sequence
from urllib.parse import urlsplit

from plotfeed.proto.errors import PlotfeedError

DEFAULT_PORTS = {"http": 80, "https": 443}
MAX_HEAD_OCTETS = 1 << 16
STATUS = re.compile(rb"HTTP/1\.[01] (\d{3})(?: .*)?")


class HttpError(PlotfeedError):
    """A server that gave no answer, and why."""


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
        """Status and body of the answer, this None if longer than `most`; raises `HttpError`."""
        answered = False
        try:
            async with asyncio.timeout(timeout_s):
                found = await self._answer(method, fields, body, most)
            answered = True
        except TimeoutError:
            raise HttpError(f"no answer within {timeout_s:g} s") from None
        except ssl.SSLCertVerificationError as error:
            raise HttpError(f"its certificate: {error.verify_message}") from None
        except OSError as error:
            raise HttpError(error.strerror or str(error)) from None
        except (EOFError, ValueError):  # of a stream that ends, or of a line without end
            raise HttpError("it hung up, or its answer is not HTTP") from None
        finally:
            if not answered:
                self.hang_up()
        return found

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

"""A TAK server, over TCP or TLS: events of Cursor on Target, one behind the other."""

from __future__ import annotations

import asyncio
import contextlib
import ssl
from pathlib import Path

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import TakServer, split_server
from plotfeed.feeds.transport.mqtt.address import BrokerAccess
from plotfeed.feeds.transport.ways_out import QueuedTransport, SendError, within

# One that turns its clients away, such as for want of a certificate, takes a first event first.
STEADY_S = 5.0
HEARD_OCTETS = 1 << 16  # Read at once of what a server sends on, which nobody here wants


class TakTransport(QueuedTransport):
    """One server's connection, made when there is something to send, and anew when it is lost."""

    def __init__(self, settings: TakServer, key: str = "tak") -> None:
        """`key` is the destination's place in the scene; raises `AccessError`."""
        super().__init__(settings, f"{key} {settings.server}", retries=None)
        scheme, self._host, self._port = split_server(settings.server)
        self._server_name = settings.server_name
        self._tls: ssl.SSLContext | None = None
        if scheme == "tls":
            files = settings.ca_file, settings.client_certificate_file, settings.client_key_file
            ca, certificate, own = (None if file is None else Path(file) for file in files)
            access = BrokerAccess(ca_file=ca, certificate_file=certificate, key_file=own)
            self._tls = access.tls_context()
        self._writer: asyncio.StreamWriter | None = None
        self._reading: asyncio.Task[None] | None = None
        self._since_s = 0.0

    async def send(self, message: Message) -> None:
        """Write an event, on a new connection where there is none; raises `SendError`."""
        try:
            async with within(self.settings.timeout_s, "it has not read for"):
                writer = self._writer or await self._connected()
                writer.write(message.payload)
                await writer.drain()
                if self._reading is None or self._reading.done():
                    raise SendError("the server has closed the connection")
        except SendError:
            self.hang_up()
            raise

    def is_steady(self) -> bool:
        """Whether the connection has stood for some seconds."""
        return asyncio.get_running_loop().time() - self._since_s > STEADY_S

    async def _connected(self) -> asyncio.StreamWriter:
        name = self._server_name if self._tls is not None else None
        reader, writer = await asyncio.open_connection(
            self._host, self._port, ssl=self._tls, server_hostname=name
        )
        self._writer, self._since_s = writer, asyncio.get_running_loop().time()
        self._reading = asyncio.create_task(_read_and_forget(reader), name=self.name)
        return writer

    def hang_up(self) -> None:
        """Close the connection, if there is one."""
        if self._reading is not None:
            self._reading.cancel()
        if self._writer is not None:
            self._writer.close()
        self._writer = self._reading = None

    async def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until everything is written, or the time is up."""
        await super().drain(timeout_s)
        if self._writer is not None:
            with contextlib.suppress(OSError, TimeoutError):
                async with asyncio.timeout(timeout_s):
                    await self._writer.drain()


async def _read_and_forget(reader: asyncio.StreamReader) -> None:
    """Read until the server closes the connection; one that is not read from would stand still."""
    with contextlib.suppress(OSError):
        while await reader.read(HEARD_OCTETS):
            pass

"""Octets from a serial port, which may be unplugged, and from files, pipes and standard input."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import threading
from collections.abc import Iterator
from io import FileIO

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.console.posix import HAS_POSIX, watched
from plotfeed.feeds.scene.telemetry_keys import SourceAddress
from plotfeed.feeds.transport.octet_sources import OctetsTaker, SourceError

log = logging.getLogger(__name__)

READ_OCTETS = 1 << 16
AGAIN_S = 1.0  # Between attempts to open a port


class SerialOctets:
    """A serial port, raw, 8 bits, no parity, 1 stop bit; opened again when it comes back."""

    bound_port = 0

    def __init__(self, address: SourceAddress, taker: OctetsTaker) -> None:
        """Raises `PlotfeedError` without pyserial."""
        need_extra("serial", "a serial port", "serial")
        self._address, self._taker = address, taker
        self.correspondents = (address.path,)
        self._opened = contextlib.ExitStack()
        self._ended = asyncio.Event()

    async def open(self) -> None:
        """Open the port; raises `SourceError`."""
        from serial import Serial  # an extra

        path, baud = self._address.path, self._address.baud
        if baud not in Serial.BAUDRATES:
            raise SourceError(f"{self._address}: {baud} baud is no usual rate")
        try:
            port = await asyncio.to_thread(Serial, path, baud, timeout=0, write_timeout=0)
        except Exception as error:  # noqa: BLE001 - those of termios are no OSError
            why = getattr(error.__context__, "strerror", f"{error}: expected a serial port")
            raise SourceError(f"{self._address}: {why}") from None
        self._opened.callback(port.close)
        # On POSIX pyserial itself would write again and again until all is taken.
        self._line = FileIO(port.fileno(), "r+", closefd=False) if HAS_POSIX else port
        self._opened.callback(self._line.close)
        self._opened.callback(watched(port, self._take))

    async def run(self) -> None:
        """Open the port again whenever it was lost."""
        while True:
            await self._ended.wait()
            log.warning("%s: the port is gone; tried again", self._address)
            self._taker.gone(self._address.path)
            while self._ended.is_set():
                await asyncio.sleep(AGAIN_S)
                with contextlib.suppress(SourceError):
                    await self.open()
                    self._ended.clear()
            log.warning("%s: the port is back", self._address)

    def close(self) -> None:
        """Take no more."""
        self._opened.close()

    def send(self, peer: str, data: bytes) -> None:
        """Write to the port what it takes at once."""
        del peer
        with contextlib.suppress(OSError, ValueError):  # it is closed
            self._line.write(data)

    def _take(self) -> None:
        try:
            data = self._line.read(READ_OCTETS)
            is_gone = HAS_POSIX and data == b""  # which is read only when something is there
        except OSError:
            is_gone = True
        if is_gone:
            self.close()
            self._ended.set()
        elif data:
            self._taker.octets(self._address.path, data)


class PipedOctets:
    """A file, a named pipe or standard input, read to its end by a thread of its own.

    Nothing else waits for what blocks, such as a pipe to which nobody writes.
    """

    def __init__(self, address: SourceAddress, taker: OctetsTaker) -> None:
        self._address, self._taker = address, taker
        self._peer = address.path or "-"
        self._is_taken = threading.Event()
        self._is_closed = False

    bound_port = 0
    correspondents: tuple[str, ...] = ()

    async def open(self) -> None:
        """See whether there is such a file; raises `SourceError`."""
        if self._address.transport == "file" and not os.access(self._address.path, os.R_OK):
            raise SourceError(f"{self._address}: no file that can be read")

    async def run(self) -> None:
        """Take all there is, and return at the end."""
        loop, done = asyncio.get_running_loop(), asyncio.Event()

        def take(data: bytes) -> None:
            try:
                if data and not self._is_closed:
                    self._taker.octets(self._peer, data)
            finally:
                self._is_taken.set()

        def read() -> None:
            with contextlib.suppress(RuntimeError):  # the loop is closed: nobody wants any more
                try:
                    for data in self._pieces():
                        self._is_taken.clear()
                        loop.call_soon_threadsafe(take, data)
                        self._is_taken.wait()
                except OSError as error:
                    log.warning("%s: %s", self._address, error.strerror or error)
                loop.call_soon_threadsafe(done.set)

        threading.Thread(target=read, name=f"reads {self._peer}", daemon=True).start()
        await done.wait()
        self._taker.gone(self._peer)

    def close(self) -> None:
        """Take no more."""
        self._is_closed = True
        self._is_taken.set()

    def send(self, peer: str, data: bytes) -> None:
        """Nobody is there to be told anything."""

    def _pieces(self) -> Iterator[bytes]:
        is_stdin = self._address.transport == "stdin"
        source = 0 if is_stdin else self._peer
        with open(source, "rb", buffering=0, closefd=not is_stdin) as file:
            while not self._is_closed and (data := file.read(READ_OCTETS)):
                yield data

"""Octets from a serial port, which may be unplugged, and from files, pipes and standard input."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import threading
from collections.abc import Iterator

from plotfeed.feeds.console.posix import serial_line
from plotfeed.feeds.scene.source_keys import SourceAddress
from plotfeed.feeds.transport.octet_sources import OctetsTaker, SourceError

log = logging.getLogger(__name__)

READ_OCTETS = 1 << 16
AGAIN_S = 1.0
"""Between attempts to open a port."""
NO_LINE = -1


class SerialOctets:
    """A serial port, raw, 8 bits, no parity, 1 stop bit; opened again when it comes back."""

    def __init__(self, address: SourceAddress, taker: OctetsTaker) -> None:
        self._address, self._taker = address, taker
        self._file = NO_LINE
        self._ended = asyncio.Event()

    bound_port = 0

    async def open(self) -> None:
        """Open the port; raises `SourceError`."""
        try:
            self._open()
        except OSError as error:
            raise SourceError(f"{self._address}: {error.strerror}") from None

    async def run(self) -> None:
        """Open the port again whenever it was lost."""
        while True:
            await self._ended.wait()
            self._ended.clear()
            log.warning("%s: the port is gone; tried again", self._address)
            self._taker.gone(self._address.path)
            while self._file == NO_LINE:
                await asyncio.sleep(AGAIN_S)
                with contextlib.suppress(OSError):
                    self._open()
            log.warning("%s: the port is back", self._address)

    def close(self) -> None:
        """Take no more."""
        if self._file != NO_LINE:
            asyncio.get_running_loop().remove_reader(self._file)
            os.close(self._file)
            self._file = NO_LINE

    def send(self, peer: str, data: bytes) -> None:
        """Write to the port what it takes at once."""
        del peer
        if self._file != NO_LINE:
            with contextlib.suppress(OSError):
                os.write(self._file, data)

    @property
    def correspondents(self) -> list[str]:
        """Whoever is at the other end."""
        return [self._address.path]

    def _open(self) -> None:
        self._file = serial_line(self._address.path, self._address.baud)
        asyncio.get_running_loop().add_reader(self._file, self._take)

    def _take(self) -> None:
        try:
            data = os.read(self._file, READ_OCTETS)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self._taker.octets(self._address.path, data)
        else:
            self.close()
            self._ended.set()


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

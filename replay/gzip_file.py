"""Files that gzip packed: unpacked as they are read, in constant memory, and within a bound."""

from __future__ import annotations

import io
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from plotfeed.replay.recorded import CHUNK_OCTETS

MAGIC = b"\x1f\x8b"
MOST_UNPACKED, SPARE_OCTETS = 256, 1 << 20
"""Octets of content for each of a file's that was read, and in any case; as for chunks of MCAP."""
_GZIP = 31
"""The window of zlib, with which it expects gzip's head and tail."""
_SIZE_OCTETS = 4


class UnpackedFile(io.RawIOBase):
    """The content of a file that gzip packed, in one or more members, from its start to its end.

    It ends where the packed octets are broken, cut off, or grow too much, and `on_damage` is
    called with the octet of the file and what is wrong.
    """

    def __init__(self, packed: BinaryIO) -> None:
        super().__init__()
        self.on_damage: Callable[[int, str], None] = lambda _at, _what: None
        self._packed = packed
        self._member = zlib.decompressobj(_GZIP)
        self._input = b""
        self._read = 0
        self._may_unpack = SPARE_OCTETS
        self._ended = False

    def readable(self) -> bool:
        """Whether it can be read."""
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        """Fill the beginning of a buffer; 0 at the end."""
        while not self._ended:
            piece = self._unpack(len(buffer))
            if piece:
                self._may_unpack -= len(piece)
                buffer[: len(piece)] = piece
                return len(piece)
            if self._member.eof:
                self._next_member()
            elif not self._input:
                self._fill()
        return 0

    def _unpack(self, octets: int) -> bytes:
        if self._member.eof:
            return b""
        if self._may_unpack <= 0:
            self._end(f"it would grow to more than {MOST_UNPACKED} times its octets")
            return b""
        try:
            piece = self._member.decompress(self._input, min(octets, self._may_unpack))
        except zlib.error as error:
            self._end(f"what gzip packed is broken: {error}")
            return b""
        self._input = self._member.unconsumed_tail
        return piece

    def _next_member(self) -> None:
        """Begin the next member, or end; zeros may follow the last one, to fill a tape's block."""
        left = self._member.unused_data.lstrip(b"\0")
        self._input, self._member = b"", zlib.decompressobj(_GZIP)
        while not left:
            left = self._packed.read(CHUNK_OCTETS)
            if not left:
                self._ended = True
                return
            self._counted(left)
            left = left.lstrip(b"\0")
        self._input = left

    def _fill(self) -> None:
        self._input = self._packed.read(CHUNK_OCTETS)
        self._counted(self._input)
        if not self._input:
            self._end("what gzip packed is cut off")

    def _counted(self, octets: bytes) -> None:
        self._read += len(octets)
        self._may_unpack += MOST_UNPACKED * len(octets)

    def _end(self, what: str) -> None:
        self._ended = True
        self.on_damage(self._read, what)


@contextmanager
def open_unpacked(path: Path) -> Iterator[tuple[BinaryIO, UnpackedFile | None]]:
    """A file for reading, and what unpacks it if gzip packed it; raises `OSError`.

    Of a pipe nothing is read here: whoever writes to it may be slow to begin.
    """
    with path.open("rb") as file:
        if not path.is_file() or file.peek(len(MAGIC))[: len(MAGIC)] != MAGIC:
            yield file, None
            return
        unpacked = UnpackedFile(file)
        with io.BufferedReader(unpacked, CHUNK_OCTETS) as buffered:
            yield buffered, unpacked


def unpacked_octets(path: Path) -> int:
    """The octets that the last member of a packed file says it has; modulo 4 GiB, or its own."""
    with path.open("rb") as file:
        size = file.seek(0, io.SEEK_END)
        file.seek(max(size - _SIZE_OCTETS, 0))
        return max(size, int.from_bytes(file.read(_SIZE_OCTETS), "little"))

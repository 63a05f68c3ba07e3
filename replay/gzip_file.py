"""Files that gzip packed: unpacked as they are read, in constant memory, and within a bound."""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from plotfeed.replay.recorded import CHUNK_OCTETS

MAGIC = b"\x1f\x8b"
# Octets of content for each of a file's that was read, and in any case; as for chunks of MCAP.
MOST_UNPACKED, SPARE_OCTETS = 256, 1 << 20
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
        self._content = gzip.GzipFile(fileobj=packed)
        self._octets = 0
        self._ended = False

    def readable(self) -> bool:
        """Whether it can be read."""
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        """Fill the beginning of a buffer; 0 at the end."""
        if self._ended:
            return 0
        try:
            piece = self._content.read1(len(buffer))
        except EOFError:
            return self._end("what gzip packed is cut off")
        except (gzip.BadGzipFile, zlib.error) as error:
            return self._end(f"what gzip packed is broken: {error}")
        self._octets += len(piece)
        if self._octets > SPARE_OCTETS + MOST_UNPACKED * self._packed.tell():
            return self._end(f"it would grow to more than {MOST_UNPACKED} times its octets")
        buffer[: len(piece)] = piece
        return len(piece)

    def _end(self, what: str) -> int:
        self._ended = True
        self.on_damage(self._packed.tell(), what)
        return 0


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

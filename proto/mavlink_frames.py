"""MAVLink frames, versions 1 and 2: how long they are, who sent them, and where streams hold them.

Layouts: https://mavlink.io/en/guide/serialization.html. What is in a frame is for others to decode.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterator
from typing import Generic, TypeVar

MAGIC_V1, MAGIC_V2 = 0xFE, 0xFD
FRAME_START = re.compile(b"[\xfd\xfe]")
SIGNED = 0x01
SIGNATURE_OCTETS = 13
V1_OVERHEAD, V2_OVERHEAD = 8, 12
LEAST_OCTETS = 3  # Of a frame, by which its length can be told
# Frames with wrong checksums in what comes at once; the rest of it is passed over.
MAX_FAILURES = 64

Message = TypeVar("Message")


def frame_octets(data: bytes | bytearray, start: int) -> int | None:
    """Length of the frame that starts there, by its header; None if none can, or cannot be told."""
    if start + LEAST_OCTETS > len(data):
        return None
    magic, payload_octets, flags = data[start : start + LEAST_OCTETS]
    if magic == MAGIC_V1:
        return payload_octets + V1_OVERHEAD
    # Receivers must drop frames with flags that they do not know.
    if magic != MAGIC_V2 or flags & ~SIGNED:
        return None
    return payload_octets + V2_OVERHEAD + (SIGNATURE_OCTETS if flags & SIGNED else 0)


def message_id(frame: bytes | bytearray) -> int:
    """Number of the message in a whole frame."""
    return frame[5] if frame[0] == MAGIC_V1 else int.from_bytes(frame[7:10], "little")


def sender(frame: bytes | bytearray) -> tuple[int, int]:
    """System and component that sent a whole frame."""
    at = 3 if frame[0] == MAGIC_V1 else 5
    return frame[at], frame[at + 1]


class FrameSplitter(Generic[Message]):
    """Messages from a stream of octets in pieces, however it is cut and whatever is between them.

    Only wanted messages are decoded. What was no frame is searched again one octet on, so that a
    false beginning swallows nothing; others are passed over if another follows or nothing does.
    """

    def __init__(
        self, wanted: Container[int], decode: Callable[[bytearray], Message | None]
    ) -> None:
        """`decode` gives None for a frame whose checksum is wrong."""
        self._wanted, self._decode = wanted, decode
        self._left = bytearray()
        self.damaged = 0  # Octets so far that belonged to no frame
        self.frames = 0  # Found so far, wanted or not

    def split(self, data: bytes) -> Iterator[Message]:
        """The wanted messages that end in these octets, in their order."""
        buffer = self._left = self._left + data
        at, failures = 0, 0
        while (found := FRAME_START.search(buffer, at)) is not None:
            start = found.start()
            self.damaged += start - at
            octets, at = frame_octets(buffer, start), start
            if octets is None and len(buffer) - start >= LEAST_OCTETS:
                self.damaged += 1
                at = start + 1
                continue
            if octets is None or start + octets > len(buffer):
                break
            frame, end = buffer[start : start + octets], start + octets
            if message_id(frame) in self._wanted:
                message = self._decode(frame)
                if message is not None:
                    self.frames += 1
                    at = end
                    yield message
                    continue
                failures += 1
            elif end == len(buffer) or buffer[end] in (MAGIC_V1, MAGIC_V2):
                self.frames += 1
                at = end
                continue
            self.damaged += 1
            at = start + 1
            if failures > MAX_FAILURES:
                self.damaged += len(buffer) - at
                at = len(buffer)
        else:
            self.damaged += len(buffer) - at
            at = len(buffer)
        self._left = buffer[at:]

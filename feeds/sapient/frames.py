"""SAPIENT over TCP: four octets of length, little-endian, then the message."""

from __future__ import annotations

from collections.abc import Iterator

from plotfeed.proto.errors import DecodeError

LENGTH_OCTETS = 4
MAX_MESSAGE_OCTETS = 1 << 20
"""Of what is taken from a peer; the answers to a sensor are some hundred octets."""


def framed(payload: bytes) -> bytes:
    """A message as it goes over TCP."""
    return len(payload).to_bytes(LENGTH_OCTETS, "little") + payload


class Deframer:
    """Puts messages together from octets as they come. It holds at most one that is not whole."""

    def __init__(self) -> None:
        self._octets = bytearray()

    def feed(self, octets: bytes) -> Iterator[bytes]:
        """The messages that are now whole; raises `DecodeError` at a length that is none."""
        self._octets += octets
        start = 0
        while len(self._octets) - start >= LENGTH_OCTETS:
            length = int.from_bytes(self._octets[start : start + LENGTH_OCTETS], "little")
            if length > MAX_MESSAGE_OCTETS:
                self._octets.clear()
                raise DecodeError(f"a length of {length}; at most {MAX_MESSAGE_OCTETS} is taken")
            end = start + LENGTH_OCTETS + length
            if end > len(self._octets):
                break
            yield bytes(self._octets[start + LENGTH_OCTETS : end])
            start = end
        del self._octets[:start]

"""Who wrote a native log, which its first record says."""

from __future__ import annotations

from pathlib import Path

from mcap.opcode import Opcode

from plotfeed.proto.errors import DecodeError
from plotfeed.replay.log_records import HEAD, MAGIC, Fields

MAX_HEADER_OCTETS = 4096


def library_of(path: Path) -> str:
    """The library that the file says it was written by; raises `DecodeError` and `OSError`."""
    with path.open("rb") as file:
        fields = Fields(file.read(len(MAGIC) + HEAD.size + MAX_HEADER_OCTETS))
    if fields.octets(len(MAGIC)) != MAGIC or fields.take(HEAD)[0] != Opcode.HEADER:
        raise DecodeError("expected an MCAP file", at_octet=0)
    _profile, library = fields.text(), fields.text()
    return library

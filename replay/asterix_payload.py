"""What can be said of a payload of ASTERIX without decoding its items."""

from __future__ import annotations

from collections.abc import Iterator

HEADER_OCTETS = 3
MAX_TRAILER_OCTETS = 16
CONTENT_TYPE = "application/x-asterix"
UNKNOWN = "application/octet-stream"
_OF_CATEGORY = tuple(f"{CONTENT_TYPE}; cat={category}" for category in range(256))


def block_octets(payload: bytes) -> int:
    """How many of the first octets are whole data blocks, back to back."""
    if _is_one_block(payload):
        return len(payload)
    return sum(length for _, length in _headers(payload))


def categories(payload: bytes) -> tuple[int, ...]:
    """Of the whole data blocks at the start of a payload: each once, in their order."""
    return tuple(dict.fromkeys(category for category, _ in _headers(payload)))


def trailer_octets(payload: bytes) -> int | None:
    """Octets that a vendor appended to the data blocks, mostly 0; None if it is no ASTERIX.

    Of a payload that nobody has labelled: what could be a block by chance must have a category,
    which 0 is not, and an octet in it.
    """
    octets = block_octets(payload)
    left = len(payload) - octets
    if not octets or left > MAX_TRAILER_OCTETS or not payload[0] or octets == HEADER_OCTETS:
        return None
    return left


def content_type(payload: bytes) -> str:
    """Of a payload that nobody has labelled: ASTERIX, of one category or many, or unknown."""
    if _is_one_block(payload) and len(payload) > HEADER_OCTETS and payload[0]:
        return _OF_CATEGORY[payload[0]]
    if trailer_octets(payload) is None:
        return UNKNOWN
    found = categories(payload)
    return _OF_CATEGORY[found[0]] if len(found) == 1 else CONTENT_TYPE


def is_asterix(content: str, payload: bytes) -> bool:
    """Whether a payload of that content type, empty if unknown, holds a block of ASTERIX."""
    if content and not content.startswith(CONTENT_TYPE):
        return False
    return bool(block_octets(payload)) if content else trailer_octets(payload) is not None


def _is_one_block(payload: bytes) -> bool:
    """Whether it is a single block, as most are."""
    octets = len(payload)
    return octets >= HEADER_OCTETS and payload[1] << 8 | payload[2] == octets


def _headers(payload: bytes) -> Iterator[tuple[int, int]]:
    """Category and length of each block, up to the first that is not whole."""
    at = 0
    while len(payload) - at >= HEADER_OCTETS:
        length = int.from_bytes(payload[at + 1 : at + 3], "big")
        if not HEADER_OCTETS <= length <= len(payload) - at:
            return
        yield payload[at], length
        at += length

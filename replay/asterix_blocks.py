"""What can be said of a payload of ASTERIX without decoding its items: blocks, categories."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from functools import cache

from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import records_in, whole_blocks
from plotfeed.proto.asterix.codec.layout import HEADER_OCTETS, Category
from plotfeed.proto.asterix.codec.retime_asterix import TimeFinder
from plotfeed.proto.asterix.other_categories import OTHER_CATEGORIES
from plotfeed.proto.content_types import ASTERIX, asterix_content_type
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.utc import DAY_NS

MAX_TRAILER_OCTETS = 16
UNKNOWN = "application/octet-stream"
_OF_CATEGORY = tuple(map(asterix_content_type, range(256)))


def block_octets(payload: bytes) -> int:
    """How many of the first octets are whole data blocks, back to back."""
    if _is_one_block(payload):
        return len(payload)
    return sum(HEADER_OCTETS + len(block.body) for block in whole_blocks(payload))


def categories(payload: bytes) -> tuple[int, ...]:
    """Categories of the whole data blocks at the start of a payload: each once, in their order."""
    return tuple(dict.fromkeys(block.category for block in whole_blocks(payload)))


def record_counts(
    payload: bytes, layouts: Mapping[int, Category] = CATEGORIES
) -> dict[int, int | None]:
    """Whole records of each category; None for one of which nothing tells where they end."""
    counts: dict[int, int | None] = {}
    for block in whole_blocks(payload):
        if layouts.get(block.category) is None:
            counts[block.category] = None
            continue
        count = counts.get(block.category) or 0
        with contextlib.suppress(DecodeError):
            for _ in records_in(block, layouts):
                count += 1
        counts[block.category] = count
    return counts


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
    """Type of a payload that nobody has labelled: ASTERIX, of one category or many, or unknown."""
    if _is_one_block(payload) and len(payload) > HEADER_OCTETS and payload[0]:
        return _OF_CATEGORY[payload[0]]
    if trailer_octets(payload) is None:
        return UNKNOWN
    found = categories(payload)
    return _OF_CATEGORY[found[0]] if len(found) == 1 else ASTERIX


def is_asterix(content: str, payload: bytes) -> bool:
    """Whether a payload of that content type, empty if unknown, holds a block of ASTERIX."""
    if content and not content.startswith(ASTERIX):
        return False
    return bool(block_octets(payload)) if content else trailer_octets(payload) is not None


def _is_one_block(payload: bytes) -> bool:
    """Whether it is a single block, as most are."""
    octets = len(payload)
    return octets >= HEADER_OCTETS and payload[1] << 8 | payload[2] == octets


LSB_NS = 7_812_500  # 1/128 s
# Categories of which it is known where their records end.
KNOWN_CATEGORIES = frozenset((*CATEGORIES, *OTHER_CATEGORIES))


@cache
def _finder(category: int) -> TimeFinder | None:
    layout = CATEGORIES.get(category) or OTHER_CATEGORIES.get(category)
    return None if layout is None else TimeFinder(layout)


def time_of_day_ns(block: bytes) -> int | None:
    """Time of a whole data block's first record; None if it has none, or none that is known."""
    finder = _finder(block[0]) if block else None
    at = finder.first_time(block, HEADER_OCTETS) if finder else None
    time_ns = DAY_NS + 1 if at is None else LSB_NS * int.from_bytes(block[at : at + 3], "big")
    # Some senders write 86400.0 for midnight; what is beyond that is no time of day.
    return time_ns % DAY_NS if time_ns <= DAY_NS else None

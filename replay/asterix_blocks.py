"""What can be said of a payload of ASTERIX without decoding its items: blocks, categories."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from functools import cache

from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import Block, records_in
from plotfeed.proto.asterix.codec.layout import (
    FX,
    HEADER_OCTETS,
    Category,
    Extended,
    Fixed,
    Item,
    Repetitive,
    Undecoded,
    is_time_of_day,
)
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
    return sum(length for _, length in _headers(payload))


def categories(payload: bytes) -> tuple[int, ...]:
    """Categories of the whole data blocks at the start of a payload: each once, in their order."""
    return tuple(dict.fromkeys(category for category, _ in _headers(payload)))


def record_counts(
    payload: bytes, layouts: Mapping[int, Category] = CATEGORIES
) -> dict[int, int | None]:
    """Whole records of each category; None for one of which nothing tells where they end."""
    counts: dict[int, int | None] = {}
    at = 0
    for category, length in _headers(payload):
        body = payload[at + HEADER_OCTETS : at + length]
        at += length
        if layouts.get(category) is None:
            counts[category] = None
            continue
        whole = (counts.get(category) or 0) + _whole_records(Block(category, body, 0), layouts)
        counts[category] = whole
    return counts


def _whole_records(block: Block, layouts: Mapping[int, Category]) -> int:
    """How many records a block begins with, up to one that is broken."""
    count = 0
    with contextlib.suppress(DecodeError):
        for _ in records_in(block, layouts):
            count += 1
    return count


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


def _headers(payload: bytes) -> Iterator[tuple[int, int]]:
    """Category and length of each block, up to the first that is not whole."""
    at = 0
    while len(payload) - at >= HEADER_OCTETS:
        length = int.from_bytes(payload[at + 1 : at + 3], "big")
        if not HEADER_OCTETS <= length <= len(payload) - at:
            return
        yield payload[at], length
        at += length


TIME, EXTENDED, UNKNOWN_LENGTH = -1, 0, -2
TIME_OCTETS = 3
LSB_NS = 7_812_500  # 1/128 s


@cache
def item_octets(category: int) -> tuple[int, ...]:
    """Octets of each item of a category's user application profile; none if nothing is known.

    EXTENDED ones end with the first octet whose last bit is clear.
    """
    layout = CATEGORIES.get(category) or OTHER_CATEGORIES.get(category)
    return () if layout is None else tuple(map(_octets_of, layout.uap))


def _octets_of(item: Item | None) -> int:
    item = item.of if isinstance(item, Undecoded) else item
    if isinstance(item, Fixed):
        return TIME if is_time_of_day(item) else item.group.octets
    groups = item.groups if isinstance(item, Extended) else ()
    if isinstance(item, Repetitive) and item.group.fx:
        groups = (item.group,)
    return EXTENDED if groups and all(g.octets == 1 for g in groups) else UNKNOWN_LENGTH


def time_of_day_ns(block: bytes) -> int | None:
    """Time of a whole data block's first record; None if it has none, or none that is known."""
    slots = item_octets(block[0]) if block else ()
    flags = _flags(block)
    at = HEADER_OCTETS + len(flags)
    for place, octets in enumerate(slots):
        if place // 7 >= len(flags) or not flags[place // 7] >> (7 - place % 7) & 1:
            continue
        if octets == TIME:
            return _time(block[at : at + TIME_OCTETS])
        if octets == UNKNOWN_LENGTH:
            return None
        at = at + octets if octets else _after_extended(block, at)
    return None


KNOWN_CATEGORIES = frozenset((*CATEGORIES, *OTHER_CATEGORIES))
"""Categories of which it is known where their records end."""


def _flags(block: bytes) -> bytes:
    """The octets of flags of the first record, all of them."""
    end = HEADER_OCTETS
    while end < len(block) and block[end] & FX:
        end += 1
    return block[HEADER_OCTETS : end + 1]


def _after_extended(block: bytes, at: int) -> int:
    while at < len(block) and block[at] & FX:
        at += 1
    return at + 1


def _time(octets: bytes) -> int | None:
    time_ns = int.from_bytes(octets, "big") * LSB_NS
    # Some senders write 86400.0 for midnight; what is beyond that is no time of day.
    return time_ns % DAY_NS if len(octets) == TIME_OCTETS and time_ns <= DAY_NS else None

"""The time of day that a data block begins with, of many categories, without decoding the rest.

Categories that plotfeed does not decode are among them where the items before the time of day are
of one length in all editions that are in use; 021 is of edition 2.0 or newer.
"""

from __future__ import annotations

from collections.abc import Mapping

from plotfeed.replay.asterix_payload import HEADER_OCTETS
from plotfeed.replay.times import DAY_NS

TIME, EXTENDED, SPARE = -1, 0, -2
TIME_OCTETS = 3
LSB_NS = 7_812_500  # 1/128 s
FX = 1

ITEMS: Mapping[int, tuple[int, ...]] = {
    2: (2, 1, 1, TIME),
    10: (2, 1, EXTENDED, TIME),
    15: (2, 1, 1, EXTENDED, EXTENDED, TIME),
    16: (2, 1, 1, TIME),
    19: (2, 1, TIME),
    20: (2, EXTENDED, TIME),
    21: (2, EXTENDED, 2, 1, TIME, 6, 8, TIME, 2, 2, 3, TIME),
    23: (2, 1, 1, TIME),
    25: (2, 1, 3, 1, 6, TIME),
    34: (2, 1, TIME),
    48: (2, TIME),
    62: (2, SPARE, 1, TIME),
    63: (2, 1, TIME),
    65: (2, 1, 1, TIME),
    129: (2, 2, 3, 3, 12, 2, TIME),
    205: (2, 1, 1, TIME),
}
"""Octets of each item of the user application profile, up to the last that is a time of day.

EXTENDED ones end with the first octet whose last bit is clear.
"""


def time_of_day_ns(block: bytes) -> int | None:
    """Of the first record of a whole data block; None where it has none, or none that is known."""
    slots = ITEMS.get(block[0], ()) if block else ()
    flags = _flags(block)
    at = HEADER_OCTETS + len(flags)
    for place, octets in enumerate(slots):
        if place // 7 >= len(flags) or not flags[place // 7] >> (7 - place % 7) & 1:
            continue
        if octets == TIME:
            return _time(block[at : at + TIME_OCTETS])
        if octets == SPARE:
            return None
        at = at + octets if octets else _after_extended(block, at)
    return None


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

"""ASTERIX at another time: the times of day in data blocks moved, all other octets left alone.

A block is moved as a whole or, where it is not understood to its end, not at all: a category
without a layout, an edition that writes otherwise, or octets that are no data block.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache

from plotfeed.proto.asterix.cat062_plan import FLIGHT_PLAN
from plotfeed.proto.asterix.decode import CATEGORIES, HEADER_OCTETS
from plotfeed.proto.asterix.layout import DAY_LSB, Category, Group, Repetitive
from plotfeed.proto.asterix.time_items import PLANNED, TimeFinder, Times
from plotfeed.proto.errors import DecodeError

NS = 1_000_000_000
LSB_PER_S = 128
DAY_S = 86_400
TIME_OCTETS = 3
DAY_OF_CODE = {0: 0, 1: -1, 2: 1}
"""Today, yesterday and tomorrow in I062/390/TOD; 3 is none of them."""
CODE_OF_DAY = {day: code for code, day in DAY_OF_CODE.items()}


@dataclass(frozen=True, slots=True)
class Retimed:
    """What became of a message; `left` says in a few words each what was left alone in it."""

    octets: bytes
    left: tuple[str, ...] = ()


class Retimer:
    """Moves the times in messages by what each call says; remembers how records are made up."""

    def __init__(self, categories: Mapping[int, Category] = CATEGORIES) -> None:
        self._finders = {number: TimeFinder(each) for number, each in categories.items()}

    def retime(self, data: bytes, shift_ns: int) -> Retimed:
        """Every time of day in data blocks that lie back to back later by that, modulo 24 hours.

        The shift is rounded to 1/128 s, half to even, so that times differ by as much as before.
        """
        shift_lsb = _rounded(shift_ns * LSB_PER_S, NS)
        moved, left = bytearray(data), list[str]()
        at = 0
        while at < len(data):
            end = at + int.from_bytes(data[at + 1 : at + HEADER_OCTETS], "big")
            if not at + HEADER_OCTETS <= end <= len(data):
                left.append("octets that are no data block")
                break
            left += self._retime_block(moved, data[at:end], at, shift_lsb)
            at = end
        return Retimed(bytes(moved), tuple(left))

    def _retime_block(
        self, moved: bytearray, block: bytes, origin: int, shift_lsb: int
    ) -> Iterator[str]:
        number = block[0]
        finder = self._finders.get(number)
        if finder is None:
            yield f"category {number:03d}, of which no layout is known"
            return
        found: list[Times] = []
        at = HEADER_OCTETS
        try:
            while at < len(block):
                found.append(finder.find(block, at))
                at = found[-1].end
        except DecodeError:
            yield f"category {number:03d} in an edition that is not known, or broken"
            return
        for times in found:
            for place in times.of_day:
                _move_time_of_day(moved, origin + place, shift_lsb)
            for place in times.planned:
                if not _move_planned(moved, origin + place, _within_day(block, times, shift_lsb)):
                    yield f"I{number:03d}/390/{PLANNED}, which is not of these days"


def _rounded(dividend: int, divisor: int) -> int:
    """The quotient, half to even."""
    whole, rest = divmod(dividend, divisor)
    return whole + (2 * rest > divisor or (2 * rest == divisor and whole & 1))


def _move_time_of_day(moved: bytearray, at: int, shift_lsb: int) -> None:
    time_lsb = int.from_bytes(moved[at : at + TIME_OCTETS], "big")
    # Some senders write 86400.0 instead of 0; what is beyond that is no time of day.
    if shift_lsb % DAY_LSB and time_lsb <= DAY_LSB:
        time_lsb = (time_lsb + shift_lsb) % DAY_LSB
        moved[at : at + TIME_OCTETS] = time_lsb.to_bytes(TIME_OCTETS, "big")


def _within_day(block: bytes, times: Times, shift_lsb: int) -> int | None:
    """The shift of what counts from the record's own day, 1/128 s: within a day.

    None if the record does not say when it is.
    """
    if len(times.of_day) != 1:
        return None
    at = times.of_day[0]
    time_lsb = int.from_bytes(block[at : at + TIME_OCTETS], "big")
    return (time_lsb + shift_lsb) % DAY_LSB - time_lsb


@cache
def _planned() -> tuple[Group, dict[str, tuple[int, int]]]:
    """An element of I062/390/TOD: the places of its parts from the right, and their masks."""
    (item,) = (s for s in FLIGHT_PLAN.subfields if s is not None and s.name == PLANNED)
    assert isinstance(item, Repetitive)  # noqa: S101 - the layout says it
    group = item.group
    return group, {part.name: (right, (1 << part.bits) - 1) for part, right in group.fields}


def _move_planned(moved: bytearray, at: int, shift_lsb: int | None) -> bool:
    """Whether a time of departure or arrival could be moved, to its own LSB: second or minute."""
    if shift_lsb is None:
        return False
    group, parts = _planned()
    octets = int.from_bytes(moved[at : at + group.octets], "big")
    value = {name: octets >> right & mask for name, (right, mask) in parts.items()}
    day = DAY_OF_CODE.get(value["DAY"])
    if day is None or value["HOR"] > 23 or value["MIN"] > 59 or value["SEC"] > 59:
        return False
    step_s = 60 if value["AVS"] else 1  # AVS says that there are no seconds
    t_s = day * DAY_S + value["HOR"] * 3600 + value["MIN"] * 60 + value["SEC"]
    t_s += step_s * _rounded(shift_lsb, step_s * LSB_PER_S)
    code = CODE_OF_DAY.get(t_s // DAY_S)
    if code is None:
        return False
    hour, of_hour_s = divmod(t_s % DAY_S, 3600)
    new = {"DAY": code, "HOR": hour, "MIN": of_hour_s // 60, "SEC": of_hour_s % 60}
    for name, number in new.items():
        right, mask = parts[name]
        octets = octets & ~(mask << right) | number << right
    moved[at : at + group.octets] = octets.to_bytes(group.octets, "big")
    return True

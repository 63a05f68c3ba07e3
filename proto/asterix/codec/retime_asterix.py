"""ASTERIX at another time: the times of day in data blocks found and moved."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from plotfeed.proto.asterix.cat062 import CAT062
from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import BROKEN, Block, ItemPlaces, Plans, whole_blocks
from plotfeed.proto.asterix.codec.layout import (
    DAY_LSB,
    Category,
    Compound,
    Repetitive,
    is_time_of_day,
)
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.utc import NS

# The subfield of I062/390 that holds times of departure and arrival.
FLIGHT_PLAN, PLANNED = "I062/390", "TOD"


@dataclass(frozen=True, slots=True)
class TimeItems:
    """The first octets of a record's times, and the octet after the record."""

    of_day: Sequence[int]
    planned: Sequence[int]
    end: int


class TimeFinder:
    """Finds the times in records of one category."""

    def __init__(self, category: Category) -> None:
        self._category = category
        self._times = [item.name for item in category.uap if item and is_time_of_day(item)]
        self._offsets = Plans(category.uap, offsets=True).read

    def find(self, body: bytes, at: int) -> TimeItems:
        """The times of the record that begins there; raises `DecodeError`."""
        planned: list[int] = []
        try:
            found, end = self._offsets(body, at)
            if FLIGHT_PLAN in found:
                first = _PLAN_OFFSETS(body, found[FLIGHT_PLAN])[0].get(PLANNED)
                if first is not None:
                    planned = [first + 1 + i * _ELEMENT.octets for i in range(body[first])]
        except BROKEN:
            found, end = {}, at
        if not found or end > len(body):
            name = f"a record of category {self._category.number:03d}"
            raise DecodeError(f"{name} has no items, or is broken", at_octet=at)
        return TimeItems([found[name] for name in self._times if name in found], planned, end)

    def first_time(self, body: bytes, at: int) -> int | None:
        """Where the record's first time of day begins; None if it has none, or is broken before."""
        with contextlib.suppress(DecodeError):
            return next(iter(self.find(body, at).of_day), None)
        with contextlib.suppress(DecodeError):
            for item, start, _ in ItemPlaces(body).of_record(self._category, at):
                if item.name in self._times:
                    return start
        return None


LSB_PER_S = 128
DAY_S = 86_400
TIME_OCTETS = 3
# Today, yesterday and tomorrow in I062/390/TOD; 3 is none of them.
DAY_OF_CODE = {0: 0, 1: -1, 2: 1}
CODE_OF_DAY = {day: code for code, day in DAY_OF_CODE.items()}


@dataclass(frozen=True, slots=True)
class Retimed:
    """What became of a message; `left` says in a few words each what was left alone in it."""

    octets: bytes
    left: tuple[str, ...] = ()


class Retimer:
    """Moves the times in messages by what each call says; remembers how records are made up."""

    def __init__(self) -> None:
        self._finders = {number: TimeFinder(each) for number, each in CATEGORIES.items()}

    def retime(self, data: bytes, shift_ns: int) -> Retimed:
        """Every time of day in data blocks that lie back to back later by that, modulo 24 hours.

        The shift is rounded to 1/128 s, half to even, so that times differ by as much as before.
        """
        shift_lsb = _rounded(shift_ns * LSB_PER_S, NS)
        moved, left = bytearray(data), list[str]()
        end = 0
        for block in whole_blocks(data):
            left += self._retime_block(moved, block, shift_lsb)
            end = block.at_octet + len(block.body)
        if end < len(data):
            left.append("octets that are no data block")
        return Retimed(bytes(moved), tuple(left))

    def _retime_block(self, moved: bytearray, block: Block, shift_lsb: int) -> Iterator[str]:
        number, body, origin = block
        finder = self._finders.get(number)
        if finder is None:
            yield f"category {number:03d}, of which no layout is known"
            return
        found: list[TimeItems] = []
        at = 0
        try:
            while at < len(body):
                found.append(finder.find(body, at))
                at = found[-1].end
        except DecodeError:
            yield f"category {number:03d} in an edition that is not known, or broken"
            return
        for times in found:
            for at in (origin + place for place in times.of_day):
                time_lsb = int.from_bytes(moved[at : at + TIME_OCTETS], "big")
                # Some senders write 86400.0 instead of 0; what is beyond that is no time of day.
                if shift_lsb % DAY_LSB and time_lsb <= DAY_LSB:
                    time_lsb = (time_lsb + shift_lsb) % DAY_LSB
                    moved[at : at + TIME_OCTETS] = time_lsb.to_bytes(TIME_OCTETS, "big")
            for place in times.planned:
                if not _move_planned(moved, origin + place, _within_day(body, times, shift_lsb)):
                    yield f"I{number:03d}/390/{PLANNED}, which is not of these days"


def _rounded(dividend: int, divisor: int) -> int:
    """The quotient, half to even."""
    whole, rest = divmod(dividend, divisor)
    return whole + (2 * rest > divisor or (2 * rest == divisor and whole & 1))


def _within_day(block: bytes, times: TimeItems, shift_lsb: int) -> int | None:
    """The shift of what counts from the record's own day, 1/128 s: within a day.

    None if the record does not say when it is.
    """
    if len(times.of_day) != 1:
        return None
    at = times.of_day[0]
    time_lsb = int.from_bytes(block[at : at + TIME_OCTETS], "big")
    return (time_lsb + shift_lsb) % DAY_LSB - time_lsb


(_PLAN,) = (item for item in CAT062.uap if isinstance(item, Compound) and item.name == FLIGHT_PLAN)
_PLAN_OFFSETS = Plans(_PLAN.subfields, offsets=True).read
(_ELEMENT,) = (
    subfield.group
    for subfield in _PLAN.subfields
    if isinstance(subfield, Repetitive) and subfield.name == PLANNED
)
# Places of the parts of a planned time from the right, and their masks.
_PARTS = {part.name: (right, (1 << part.bits) - 1) for part, right in _ELEMENT.fields}


def _move_planned(moved: bytearray, at: int, shift_lsb: int | None) -> bool:
    """Whether a time of departure or arrival could be moved, to its own LSB: second or minute."""
    if shift_lsb is None:
        return False
    octets = int.from_bytes(moved[at : at + _ELEMENT.octets], "big")
    value = {name: octets >> right & mask for name, (right, mask) in _PARTS.items()}
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
        right, mask = _PARTS[name]
        octets = octets & ~(mask << right) | number << right
    moved[at : at + _ELEMENT.octets] = octets.to_bytes(_ELEMENT.octets, "big")
    return True

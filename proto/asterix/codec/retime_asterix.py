"""ASTERIX at another time: the times of day in data blocks found and moved."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import TypeAlias

from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.layout import (
    DAY_LSB,
    FX,
    HEADER_OCTETS,
    Category,
    Compound,
    Fixed,
    Group,
    Item,
    Repetitive,
    is_time_of_day,
)
from plotfeed.proto.asterix.codec.readers import BROKEN, reader_of
from plotfeed.proto.asterix.layout_062 import CAT062
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.utc import NS

FLIGHT_PLAN, PLANNED = "I062/390", "TOD"
"""The subfield of I062/390 that holds times of departure and arrival."""
MAX_PLANS = 4096
"""Different field specifications remembered of a category; a real feed has a few."""

Step: TypeAlias = Callable[[bytes, int, list[int]], int]
"""What gives the octet after items, and notes planned times on the way; raises one of `BROKEN`."""


@dataclass(frozen=True, slots=True)
class TimeItems:
    """The first octets of a record's times, and the octet after the record."""

    of_day: tuple[int, ...]
    planned: tuple[int, ...]
    end: int


@dataclass(frozen=True, slots=True)
class _Plan:
    """How to walk over the records that have the same items."""

    octets: int
    """Length of the record, where every item is of fixed length; else 0."""
    steps: tuple[Step, ...]
    times: tuple[tuple[int, int], ...]
    """Times of day: after so many steps, so many octets on."""
    wrong: str
    """Why the record cannot be walked over beyond its steps; empty where it can."""


class TimeFinder:
    """Finds the times in records of one category."""

    def __init__(self, category: Category) -> None:
        self._name = f"a record of category {category.number:03d}"
        self._uap = category.uap
        self._plans: dict[bytes, _Plan] = {}

    def find(self, body: bytes, at: int) -> TimeItems:
        """The times of the record that begins there; raises `DecodeError`."""
        try:
            times = self._find(body, at)
        except BROKEN:
            raise DecodeError(f"{self._name} is cut off", at_octet=at) from None
        if times.end > len(body):
            raise DecodeError(f"{self._name} is cut off", at_octet=at)
        return times

    def first_time(self, body: bytes, at: int) -> int | None:
        """Where the record's first time of day begins; None if it has none, or is broken before."""
        with contextlib.suppress(*BROKEN):
            flags = at
            at = _after_flags(body, at)
            plan = self._plan(body[flags:at])
            for steps, octets in plan.times[:1]:
                for step in plan.steps[:steps]:
                    at = step(body, at, [])
                return at + octets
        return None

    def _find(self, body: bytes, at: int) -> TimeItems:
        start = at
        at = _after_flags(body, at)
        plan = self._plan(body[start:at])
        if plan.wrong:
            raise DecodeError(plan.wrong)
        if plan.octets:
            return TimeItems(tuple(at + octets for _, octets in plan.times), (), at + plan.octets)
        starts, planned = [at], list[int]()
        for step in plan.steps:
            at = step(body, at, planned)
            starts.append(at)
        of_day = tuple(starts[steps] + octets for steps, octets in plan.times)
        return TimeItems(of_day, tuple(planned), at)

    def _plan(self, flags: bytes) -> _Plan:
        plan = self._plans.get(flags)
        if plan is None:
            if len(self._plans) >= MAX_PLANS:
                self._plans.clear()
            plan = self._plans[flags] = _time_plan(_present(self._uap, flags, self._name))
        return plan


def _time_plan(items: Iterator[Item]) -> _Plan:
    """Items of fixed length that follow each other are one step."""
    steps: list[Step] = []
    times: list[tuple[int, int]] = []
    passed, wrong = 0, ""
    try:
        for item in items:
            if isinstance(item, Fixed):
                if is_time_of_day(item):
                    times.append((len(steps), passed))
                passed += item.group.octets
                continue
            if passed:
                steps.append(_over(passed))
                passed = 0
            steps.append(_step(item))
    except DecodeError as error:
        wrong = str(error)
    octets = 0 if steps else passed
    if passed:
        steps.append(_over(passed))
    return _Plan(
        octets, tuple(steps), tuple(times), wrong if steps or wrong else "a record has no items"
    )


def _over(octets: int) -> Step:
    return lambda _body, at, _planned: at + octets


def _step(item: Item) -> Step:
    if isinstance(item, Compound) and item.name == FLIGHT_PLAN:
        return partial(_after_flight_plan, item)
    read = reader_of(item)
    return lambda body, at, _planned: read(body, at)[1]


def _after_flight_plan(item: Compound, body: bytes, at: int, planned: list[int]) -> int:
    flags = at
    at = _after_flags(body, at)
    for subfield in _present(item.subfields, body[flags:at], item.name):
        if subfield.name == PLANNED:
            planned.extend(_elements(subfield, body, at))
        at = reader_of(subfield)(body, at)[1]
    return at


def _after_flags(body: bytes, at: int) -> int:
    while body[at] & FX:
        at += 1
    return at + 1


def _present(slots: Sequence[Item | None], flags: bytes, name: str) -> Iterator[Item]:
    """What the flags say is there; raises `DecodeError` for what is not assigned."""
    for number, octet in enumerate(flags):
        for place in range(7):
            if not octet >> (7 - place) & 1:
                continue
            flag = number * 7 + place
            item = slots[flag] if flag < len(slots) else None
            if item is None:
                raise DecodeError(f"{name} has flag {flag + 1}, which is not assigned")
            yield item


def _elements(item: Item, body: bytes, at: int) -> list[int]:
    assert isinstance(item, Repetitive)  # noqa: S101 - the layout says it  # nosec B101
    return [at + 1 + i * item.group.octets for i in range(body[at])]


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
        found: list[TimeItems] = []
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


def _within_day(block: bytes, times: TimeItems, shift_lsb: int) -> int | None:
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
    (group,) = (
        subfield.group
        for item in CAT062.uap
        if isinstance(item, Compound) and item.name == FLIGHT_PLAN
        for subfield in item.subfields
        if isinstance(subfield, Repetitive) and subfield.name == PLANNED
    )
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

"""Where the times of a record are: found by the decoder's layouts, without decoding the rest.

Two kinds of items tell a time that moves when a recording is set to another day or hour: times of
day of 3 octets, and the planned times of I062/390/TOD, which count from a day that the message's
own time of day is in. Ages, periods and offsets to the time of day stay as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

from plotfeed.proto.asterix.cat062_plan import FLIGHT_PLAN
from plotfeed.proto.asterix.layout import (
    DAY_LSB,
    Category,
    Compound,
    Explicit,
    Extended,
    Fixed,
    Item,
    Quantity,
    Repetitive,
)
from plotfeed.proto.errors import DecodeError

FX = 1
PLANNED = "TOD"
"""The subfield of I062/390 that holds times of departure and arrival."""
MAX_PLANS = 4096
"""Different field specifications remembered of a category; a real feed has a few."""

Step: TypeAlias = "int | Item"
"""So many octets to pass over, or an item whose length only its octets tell."""


@dataclass(frozen=True, slots=True)
class Times:
    """The first octets of a record's times, and the octet after the record."""

    of_day: tuple[int, ...]
    planned: tuple[int, ...]
    end: int


@dataclass(frozen=True, slots=True)
class _Plan:
    """How to walk over the records that have the same items."""

    octets: int
    """Of all of it, where every item is of fixed length; else 0."""
    steps: tuple[Step, ...]
    times: tuple[tuple[int, int], ...]
    """Times of day: after so many steps, so many octets on."""


class TimeFinder:
    """Finds the times in records of one category."""

    def __init__(self, category: Category) -> None:
        self._name = f"a record of category {category.number:03d}"
        self._uap = category.uap
        self._plans: dict[bytes, _Plan] = {}

    def find(self, body: bytes, at: int) -> Times:
        """The times of the record that begins there; raises `DecodeError`."""
        try:
            times = self._find(body, at)
        except IndexError:
            raise DecodeError(f"{self._name} is cut off", at_octet=at) from None
        if times.end > len(body):
            raise DecodeError(f"{self._name} is cut off", at_octet=at)
        return times

    def _find(self, body: bytes, at: int) -> Times:
        start = at
        at = _after_flags(body, at)
        plan = self._plan(body[start:at])
        if plan.octets:
            return Times(tuple(at + octets for _, octets in plan.times), (), at + plan.octets)
        starts, planned = [at], list[int]()
        for step in plan.steps:
            at = at + step if isinstance(step, int) else _after(step, body, at, planned)
            starts.append(at)
        of_day = tuple(starts[steps] + octets for steps, octets in plan.times)
        return Times(of_day, tuple(planned), at)

    def _plan(self, flags: bytes) -> _Plan:
        plan = self._plans.get(flags)
        if plan is None:
            if len(self._plans) >= MAX_PLANS:
                self._plans.clear()
            plan = self._plans[flags] = _planned(_present(self._uap, flags, self._name))
        return plan


def is_time_of_day(item: Item) -> bool:
    """Whether it counts 1/128 s since midnight, and nothing else."""
    if not isinstance(item, Fixed) or len(item.group.fields) != 1:
        return False
    part, _ = item.group.fields[0]
    return isinstance(part, Quantity) and part.modulus == DAY_LSB


def _planned(items: Sequence[Item]) -> _Plan:
    """Items of fixed length that follow each other are one step."""
    if not items:
        raise DecodeError("a record has no items")
    steps: list[Step] = []
    times: list[tuple[int, int]] = []
    passed = 0
    for item in items:
        if isinstance(item, Fixed):
            if is_time_of_day(item):
                times.append((len(steps), passed))
            passed += item.group.octets
            continue
        if passed:
            steps.append(passed)
            passed = 0
        steps.append(item)
    if passed:
        steps.append(passed)
    octets = passed if steps == [passed] else 0
    return _Plan(octets, tuple(steps), tuple(times))


def _after_flags(body: bytes, at: int) -> int:
    while body[at] & FX:
        at += 1
    return at + 1


def _present(slots: Sequence[Item | None], flags: bytes, name: str) -> list[Item]:
    """What the flags say is there; raises `DecodeError` for what is not assigned."""
    found: list[Item] = []
    for number, octet in enumerate(flags):
        for place in range(7):
            if not octet >> (7 - place) & 1:
                continue
            flag = number * 7 + place
            item = slots[flag] if flag < len(slots) else None
            if item is None:
                raise DecodeError(f"{name} has flag {flag + 1}, which is not assigned")
            found.append(item)
    return found


def _after(item: Item, body: bytes, at: int, planned: list[int]) -> int:
    """The octet after an item; planned times are noted on the way."""
    match item:
        case Fixed(_, group):
            return at + group.octets
        case Extended():
            return _after_extended(item, body, at)
        case Repetitive():
            return _after_repetitive(item, body, at)
        case Explicit(name):
            if not body[at]:
                raise DecodeError(f"{name} says that it is 0 octets long", at_octet=at)
            return at + body[at]
        case Compound(name, subfields):
            flags = at
            at = _after_flags(body, at)
            for subfield in _present(subfields, body[flags:at], name):
                if item is FLIGHT_PLAN and subfield.name == PLANNED:
                    planned.extend(_elements(subfield, body, at))
                at = _after(subfield, body, at, planned)
            return at


def _after_extended(item: Extended, body: bytes, at: int) -> int:
    for group in item.groups:
        at += group.octets
        if not body[at - 1] & FX:
            return at
    return _after_flags(body, at)  # of a newer edition, an octet a group


def _after_repetitive(item: Repetitive, body: bytes, at: int) -> int:
    if not item.group.fx:
        return at + 1 + body[at] * item.group.octets
    at += item.group.octets
    while body[at - 1] & FX:
        at += item.group.octets
    return at


def _elements(item: Item, body: bytes, at: int) -> list[int]:
    assert isinstance(item, Repetitive)  # noqa: S101 - the layout says it
    return [at + 1 + i * item.group.octets for i in range(body[at])]

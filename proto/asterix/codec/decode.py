"""Octets to records, for every category that has a layout; the others keep their octets.

Input is never trusted: whatever arrives gives records or a DecodeError that says at which octet,
in one pass over the input, and no length or count allocates more than the input holds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, repeat
from typing import Any, NamedTuple, TypeAlias

from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.layout import (
    FX,
    HEADER_OCTETS,
    Category,
    Compound,
    Explicit,
    Extended,
    Fixed,
    Item,
    Repetitive,
    Undecoded,
)
from plotfeed.proto.asterix.codec.readers import BROKEN, Plans, Reader
from plotfeed.proto.errors import DecodeError

Value: TypeAlias = "int | float | str | bytes | dict[str, Value] | list[Value]"


class Block(NamedTuple):
    """A data block; `at_octet` is where its body starts in the input."""

    category: int
    body: bytes
    at_octet: int


class Record(NamedTuple):
    """A record: its items by name, and its own octets, which start at `at_octet` of the input.

    Quantities are floats in the layout's unit, other numbers integers. A repetitive item is a
    list, an item of one part is that part's value, any other a dict by part or subfield.
    Without a layout for its category, a block is one record that has no items.
    """

    category: int
    items: Mapping[str, Value]
    octets: bytes
    at_octet: int

    def get(self, path: str) -> Value | None:
        """The value at a path such as "I048/040/RHO" or "I048/161"; None if it is not there.

        Members of a list go by their number from 0: "I048/250/0/BDS1".
        """
        category, item, *parts = path.split("/")
        value = self.items.get(f"{category}/{item}")
        for part in parts:
            match value:
                case dict():
                    value = value.get(part)
                case list() if part.isdecimal() and int(part) < len(value):
                    value = value[int(part)]
                case _:
                    return None
        return value


class ItemPlace(NamedTuple):
    """Where an item lies: its first octet, and the one after its last."""

    item: Item
    at: int
    end: int


def whole_blocks(data: bytes) -> Iterator[Block]:
    """The data blocks that lie back to back in `data`, up to the first that is not whole."""
    at = 0
    while len(data) - at >= HEADER_OCTETS:
        length = int.from_bytes(data[at + 1 : at + 3], "big")
        if not HEADER_OCTETS <= length <= len(data) - at:
            return
        body = at + HEADER_OCTETS
        at += length
        yield Block(data[body - HEADER_OCTETS], bytes(data[body:at]), body)


def blocks(data: bytes) -> Iterator[Block]:
    """The data blocks that lie back to back in `data`; a DecodeError behind them if one is cut."""
    at = 0
    for block in whole_blocks(data):
        yield block
        at = block.at_octet + len(block.body)
    left = len(data) - at
    if 0 < left < HEADER_OCTETS:
        raise DecodeError("the header of a data block is cut off", at_octet=at)
    if left:
        length = int.from_bytes(data[at + 1 : at + 3], "big")
        what = f", of which {left} are there" if length > left else " has no header"
        raise DecodeError(f"a data block of {length} octets{what}", at_octet=at + 1)


def records_in(block: Block, categories: Mapping[int, Category] = CATEGORIES) -> Iterator[Record]:
    """The records of a block, one after the other until the end or the first that is broken."""
    category = categories.get(block.category)
    if category is None:
        yield Record(block.category, {}, block.body, block.at_octet)
        return
    read = _plans_of(category)
    number, body, origin = block
    at, octets = 0, len(body)
    while at < octets:
        start = at
        try:
            items, at = read(body, start)
        except BROKEN:
            items = {}
        if not items or at > octets:
            list(ItemPlaces(body, origin).of_record(category, start))  # raises what is wrong
            raise DecodeError(f"a record of category {number} is broken", at_octet=origin + start)
        yield Record(number, items, body[start:at], origin + start)


# By the identity of a category, as its hash is that of all that it holds.
_PLANS: dict[int, tuple[Category, Reader]] = {}


def _plans_of(category: Category) -> Reader:
    found = _PLANS.get(id(category))
    if found is None:
        plots = Plans(category.uap).read
        tracks = Plans(category.track_uap).read

        def read(body: bytes, at: int) -> tuple[Any, int]:
            return (tracks if _is_track(body, at) else plots)(body, at)

        found = _PLANS[id(category)] = category, read if category.track_uap else plots
    return found[1]


def _is_track(body: bytes, at: int) -> bool:
    """Whether a record of 001 has I001/020, behind I001/010, that says so."""
    end = at
    while end < len(body) and body[end] & FX:
        end += 1
    flags = body[at] if at < len(body) else 0
    says = end + 1 + (2 if flags & 0x80 else 0)
    return bool(flags & 0x40 and says < len(body) and body[says] & 0x80)


def decode(data: bytes, categories: Mapping[int, Category] = CATEGORIES) -> list[Record]:
    """Every record of every block; a DecodeError if any of them is broken."""
    return [record for block in blocks(data) for record in records_in(block, categories)]


def decode_lenient(
    data: bytes, categories: Mapping[int, Category] = CATEGORIES
) -> tuple[list[Record], list[DecodeError]]:
    """Records that are whole, and what was not.

    A broken record costs the rest of its block, a broken block the rest of the input.
    """
    records: list[Record] = []
    errors: list[DecodeError] = []
    try:
        for block in blocks(data):
            try:
                records.extend(records_in(block, categories))
            except DecodeError as error:
                errors.append(error)
    except DecodeError as error:
        errors.append(error)
    return records, errors


class ItemPlaces:
    """Finds where items lie in octets, without their values; a DecodeError says what is broken.

    `origin` is where the octets start in the input: errors count from its beginning.
    """

    __slots__ = ("_octets", "_origin")

    def __init__(self, octets: bytes, origin: int = 0) -> None:
        self._octets, self._origin = octets, origin

    def of_record(self, category: Category, at: int) -> Iterator[ItemPlace]:
        """The items of the record that begins there, one by one up to the first that is broken."""
        name = f"a record of category {category.number}"
        is_track = category.track_uap and _is_track(self._octets, at)
        items, behind = self._present(category.track_uap if is_track else category.uap, name, at)
        if not items:
            raise self._error(f"{name} has no items", behind)
        yield from self._each(items, behind)

    def of_compound(self, item: Compound, at: int) -> Iterator[ItemPlace]:
        """The subfields of the item that begins there, in the same way."""
        yield from self._each(*self._present(item.subfields, item.name, at))

    def _each(self, items: Sequence[Item], at: int) -> Iterator[ItemPlace]:
        for item in items:
            end = self._end(item, at)
            yield ItemPlace(item, at, end)
            at = end

    def _present(
        self, slots: Sequence[Item | None], name: str, at: int
    ) -> tuple[Sequence[Item], int]:
        """The items that flags name, and the octet behind the flags, whose last has no FX."""
        octets, end = self._octets, at
        while end < len(octets) and octets[end] & FX:
            end += 1
        end = self._behind(end, 1, name)
        items: list[Item] = []
        for number, flag in enumerate(f"{octet >> 1:07b}" for octet in octets[at:end]):
            for place in (7 * number + bit for bit, is_set in enumerate(flag) if is_set == "1"):
                item = slots[place] if place < len(slots) else None
                if item is None:
                    what = f"{name} has flag {place + 1}, which is not assigned"
                    raise self._error(what, at + number)
                items.append(item)
        return items, end

    def _end(self, item: Item, at: int) -> int:
        """The octet after the item that begins there."""
        name = item.name
        match item:
            case Fixed(_, group):
                return self._behind(at, group.octets, name)
            case Explicit():
                behind = self._behind(at, 1, name)
                length = self._octets[at]
                if not length:
                    what = f"{name} says that it is 0 octets long, which counts at least itself"
                    raise self._error(what, at)
                return self._behind(behind, length - 1, name)
            case Compound(_, subfields):
                items, at = self._present(subfields, name, at)
                for each in items:
                    at = self._end(each, at)
                return at
            case Undecoded(_, of):
                return self._end(of, at)
            case Repetitive(_, group) if not group.fx:
                behind = self._behind(at, 1, name)
                for _ in range(self._octets[at]):
                    behind = self._behind(behind, group.octets, name)
                return behind
            case Repetitive(_, group):
                sizes: Iterator[int] = repeat(group.octets)
            case Extended(_, groups):
                # A newer edition than the layout's has further groups of one octet, as all have.
                sizes = chain((group.octets for group in groups), repeat(1))
        for octets in sizes:
            at = self._behind(at, octets, name)
            if not self._octets[at - 1] & FX:
                break
        return at

    def _behind(self, at: int, octets: int, name: str) -> int:
        left = len(self._octets) - at
        if left < octets:
            raise self._error(f"{name} needs {octets} octets, {left} are left of its block", at)
        return at + octets

    def _error(self, message: str, at: int) -> DecodeError:
        return DecodeError(message, at_octet=self._origin + at)

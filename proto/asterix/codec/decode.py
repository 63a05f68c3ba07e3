"""Octets to records, for every category that has a layout; the others keep their octets.

Input is never trusted: whatever arrives gives records or a DecodeError that says at which octet,
in one pass over the input, and no length or count allocates more than the input holds.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.layout import (
    FX,
    HEADER_OCTETS,
    Category,
    Characters,
    Compound,
    Explicit,
    Extended,
    Fixed,
    Group,
    Item,
    Named,
    Quantity,
    Repetitive,
    Undecoded,
)
from plotfeed.proto.asterix.codec.readers import BROKEN, FURTHER, Plans, Reader
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


def blocks(data: bytes) -> Iterator[Block]:
    """The data blocks that lie back to back in `data`."""
    at = 0
    while at < len(data):
        if len(data) - at < HEADER_OCTETS:
            raise DecodeError("the header of a data block is cut off", at_octet=at)
        length = int.from_bytes(data[at + 1 : at + 3], "big")
        if length < HEADER_OCTETS:
            raise DecodeError(f"a data block of {length} octets has no header", at_octet=at + 1)
        if length > len(data) - at:
            raise DecodeError(
                f"a data block of {length} octets, of which {len(data) - at} are there",
                at_octet=at + 1,
            )
        body = at + HEADER_OCTETS
        at += length
        yield Block(data[body - HEADER_OCTETS], bytes(data[body:at]), body)


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
        if not items or at > octets:  # says what is wrong
            cursor = _Cursor(body, start, origin)
            items, at = cursor.record(category), cursor.at
        yield Record(number, items, body[start:at], origin + start)


_PLANS: dict[int, tuple[Category, Reader]] = {}
"""By the identity of a category, as its hash is that of all that it holds."""


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
    flags = at
    while body[at] & FX:
        at += 1
    source = 2 if body[flags] & 0x80 else 0
    return bool(body[flags] & 0x40 and body[at + 1 + source] & 0x80)


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


class _Cursor:
    """Reads one record; `at` is the next octet of `body`, `origin` where body is in the input."""

    __slots__ = ("at", "body", "origin")

    def __init__(self, body: bytes, at: int, origin: int) -> None:
        self.body, self.at, self.origin = body, at, origin

    def error(self, message: str) -> DecodeError:
        return DecodeError(message, at_octet=self.origin + self.at)

    def take(self, octets: int, name: str) -> bytes:
        piece = self.body[self.at : self.at + octets]
        if len(piece) < octets:
            raise self.error(f"{name} needs {octets} octets, {len(piece)} are left of its block")
        self.at += octets
        return piece

    def record(self, category: Category) -> dict[str, Value]:
        name = f"a record of category {category.number}"
        items: dict[str, Value] = {}
        slots = category.uap
        with contextlib.suppress(IndexError):
            if category.track_uap and _is_track(self.body, self.at):
                slots = category.track_uap
        for item in self.present(slots, name):
            items[item.name] = self.item(item)
        if not items:
            raise self.error(f"{name} has no items")
        return items

    def present(self, slots: Sequence[Item | None], name: str) -> list[Item]:
        """What the flags say is there; they end with the first octet whose FX is clear."""
        found: list[Item] = []
        first = 0
        more = True
        while more:
            octet = self.take(1, name)[0]
            for place in range(7):
                if not octet >> (7 - place) & 1:
                    continue
                item = slots[first + place] if first + place < len(slots) else None
                if item is None:
                    self.at -= 1
                    raise self.error(f"{name} has flag {first + place + 1}, which is not assigned")
                found.append(item)
            first += 7
            more = bool(octet & FX)
        return found

    def item(self, item: Item) -> Value:
        match item:
            case Fixed(name, group):
                return _values(group, self.take(group.octets, name))
            case Extended():
                return self.extended(item)
            case Repetitive():
                return self.repetitive(item)
            case Explicit(name):
                return self.explicit(name)
            case Compound(name, subfields):
                return {sub.name: self.item(sub) for sub in self.present(subfields, name)}
            case Undecoded(_, of):
                start = self.at
                self.item(of)
                return self.body[start : self.at]

    def extended(self, item: Extended) -> Value:
        values: dict[str, Value] = {}
        for group in item.groups:
            octets = self.take(group.octets, item.name)
            for part, right in group.fields:
                values[part.name] = _value(part, int.from_bytes(octets, "big") >> right)
            if not octets[-1] & FX:
                return values
        # A newer edition than the layout's: its groups are of one octet each, as all have been.
        start = self.at
        while self.take(1, item.name)[0] & FX:
            pass
        values[FURTHER] = self.body[start : self.at]
        return values

    def repetitive(self, item: Repetitive) -> Value:
        group = item.group
        if not group.fx:
            count = self.take(1, item.name)[0]
            return [_values(group, self.take(group.octets, item.name)) for _ in range(count)]
        values: list[Value] = []
        more = True
        while more:
            octets = self.take(group.octets, item.name)
            values.append(_values(group, octets))
            more = bool(octets[-1] & FX)
        return values

    def explicit(self, name: str) -> Value:
        length = self.take(1, name)[0]
        if not length:
            self.at -= 1
            raise self.error(f"{name} says that it is 0 octets long, which counts at least itself")
        return self.take(length - 1, name)


def _values(group: Group, octets: bytes) -> Value:
    raw = int.from_bytes(octets, "big")
    if len(group.fields) == 1:
        part, right = group.fields[0]
        return _value(part, raw >> right)
    return {part.name: _value(part, raw >> right) for part, right in group.fields}


def _value(part: Named, raw: int) -> Value:
    """The value of a part whose last bit is the last of `raw`."""
    raw &= (1 << part.bits) - 1
    match part:
        case Quantity():
            if part.signed and raw >> part.bits - 1:
                raw -= 1 << part.bits
            return part.value(raw)
        case Characters():
            each = part.bits_each
            mask = (1 << each) - 1
            places = range(part.bits - each, -1, -each)
            return "".join(part.alphabet[raw >> place & mask] for place in places)
        case _:
            return raw

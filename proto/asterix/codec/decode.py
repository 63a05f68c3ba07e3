"""Octets to records, for every category that has a layout; the others keep their octets.

Input is never trusted: whatever arrives gives records or a DecodeError that says at which octet,
in one pass over the input, and no length or count allocates more than the input holds.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from itertools import chain, count, repeat
from typing import Any, NamedTuple, TypeAlias, cast

from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.layout import (
    ASCII,
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
    Spare,
    Undecoded,
)
from plotfeed.proto.errors import DecodeError

# Items and records read fast, by Python that is put together from a layout and compiled.
#
# A reader takes the octets of a block's body and where its item begins, and gives the value and
# where the item ends; words of fixed length that follow each other are unpacked at once. What is
# cut off or broken raises `BROKEN` without a word; `codec.decode.ItemPlaces` says what is wrong.
Reader: TypeAlias = Callable[[bytes, int], tuple[Any, int]]

BROKEN = (IndexError, struct.error)  # What readers raise
MAX_PLANS = 4096  # Of one record or item; what has sent more sets of flags than that begins anew
# Times that a set of flags comes before its items are compiled into one reader.
#
# Compiling that takes as long as reading some hundred records item by item.
OFTEN = 100


# The name under which an extended item keeps the octets that follow the groups of its layout.
FURTHER = "FURTHER"
TABLE_BITS = 12  # Of characters that are looked up at once
WORD_OCTETS = (1, 2, 4, 8)
# Of `struct`; small letters for words with a sign.
_CODES = dict(zip(WORD_OCTETS, "BHIQ", strict=True))


class Plans:
    """How a user application profile, or a compound item, is read, by its octets of flags.

    With `offsets`, where items begin stands in place of their values.
    """

    __slots__ = ("_offsets", "_readers", "_slots")

    def __init__(self, slots: Sequence[Item | None], *, offsets: bool = False) -> None:
        self._slots = slots
        self._offsets = offsets
        self._readers: dict[bytes, Reader] = {}

    def read(self, body: bytes, at: int) -> tuple[dict[str, Any], int]:
        """Flags, and the items that they name; raises one of `BROKEN`."""
        end = at
        while body[end] & FX:
            end += 1
        end += 1
        flags = body[at:end]
        return (self._readers.get(flags) or self._planned(flags))(body, end)

    def _planned(self, flags: bytes) -> Reader:
        chosen: list[Item] = []
        for place, octet in enumerate(flags):
            for bit in range(7):
                if octet >> 7 - bit & 1:
                    item = self._slots[7 * place + bit]
                    if item is None:
                        raise IndexError(bit)
                    chosen.append(item)
        if len(self._readers) >= MAX_PLANS:
            self._readers.clear()
        made = _offsets(chosen) if self._offsets else self._one_by_one(flags, chosen)
        reader = self._readers[flags] = made
        return reader

    def _one_by_one(self, flags: bytes, items: Sequence[Item]) -> Reader:
        """Reads item by item, until those flags have come often."""
        readers = [(item.name, reader_of(item)) for item in items]
        left = OFTEN

        def read(body: bytes, at: int) -> tuple[dict[str, Any], int]:
            nonlocal left
            left -= 1
            if not left:
                source = _Source()
                values = [(item.name, _value(item, source)) for item in items]
                self._readers[flags] = source.reader(_literal(values))
            found: dict[str, Any] = {}
            for name, reader in readers:
                found[name], at = reader(body, at)
            return found, at

        return read


def _offsets(items: Sequence[Item]) -> Reader:
    """The reader of where items that follow each other begin."""
    steps = [
        (item.name, item.group.octets if isinstance(item, Fixed) else 0, reader_of(item))
        for item in items
    ]

    def read(body: bytes, at: int) -> tuple[dict[str, Any], int]:
        found = {}
        for name, octets, reader in steps:
            found[name] = at
            at = at + octets if octets else reader(body, at)[1]
        return found, at

    return read


def _value(item: Item, source: _Source) -> str:
    match item:
        case Fixed(_, group):
            return source.fixed(group)
        case Extended(_, groups):
            return source.extended(groups)
        case _:
            return source.read_by(reader_of(item))


@cache
def reader_of(item: Item) -> Reader:
    """The reader of an item or subfield."""
    match item:
        case Fixed() | Extended():
            source = _Source()
            return source.reader(_value(item, source))
        case Repetitive(name, group):
            one = reader_of(Fixed(name, group))
            return _until_fx(one) if group.fx else _counted(one, group.octets)
        case Explicit():
            return _explicit
        case Compound(_, subfields):
            return Plans(subfields).read
        case Undecoded(_, of):
            return _octets(reader_of(of))


def _explicit(body: bytes, at: int) -> tuple[bytes, int]:
    octets = body[at]
    end = at + octets
    if not octets or end > len(body):
        raise IndexError(end)
    return body[at + 1 : end], end


def _octets(one: Reader) -> Reader:
    def read(body: bytes, at: int) -> tuple[bytes, int]:
        _, end = one(body, at)
        if end > len(body):
            raise IndexError(end)
        return body[at:end], end

    return read


def _counted(one: Reader, octets: int) -> Reader:
    def read(body: bytes, at: int) -> tuple[list[Any], int]:
        first = at + 1
        end = first + octets * body[at]
        return [one(body, start)[0] for start in range(first, end, octets)], end

    return read


def _until_fx(one: Reader) -> Reader:
    def read(body: bytes, at: int) -> tuple[list[Any], int]:
        values = []
        more = FX
        while more:
            value, at = one(body, at)
            values.append(value)
            more = body[at - 1] & FX
        return values, at

    return read


class _Source:
    """The lines of a function that reads, as they are put together, and what they call.

    What it is given follows what it was given before. A value is an expression that holds in the
    last line. Words wait until something needs to know where they end.
    """

    def __init__(self, parameters: str = "body, at") -> None:
        self._lines = [f"def read({parameters}):"]
        self._called: dict[str, Any] = {"from_bytes": int.from_bytes, "further": _further}
        self._numbers = count()
        self._codes = ""  # of words that wait, as struct has them
        self._words: list[str] = []  # their names
        self._joined: list[str] = []  # lines that make integers of several of them

    def reader(self, value: str) -> Reader:
        """The function, which gives that value."""
        self._load()
        return cast(Reader, self._compiled(f"return {value}, at"))

    def fixed(self, group: Group) -> str:
        """The value of a group: a dict, or that of its only part."""
        values = self._group(group)
        return values[0][1] if len(values) == 1 else _literal(values)

    def extended(self, groups: Sequence[Group]) -> str:
        """The value of groups, each of which says whether there is another."""
        raw = self._integer(groups[0].octets)
        self._load()
        found, more = self._name("found"), self._name("more")
        self._called[more] = _Source("body, at, found")._further_groups(groups[1:])
        self._line(f"{found} = {_literal(self._parts(groups[0], raw))}")
        self._line(f"if {raw} & {FX}: at = {more}(body, at, {found})")
        return found

    def read_by(self, reader: Reader) -> str:
        """The value that another reader gives."""
        self._load()
        value, read = self._name("value"), self._name("read")
        self._called[read] = reader
        self._line(f"{value}, at = {read}(body, at)")
        return value

    def _further_groups(self, groups: Sequence[Group]) -> Callable[[bytes, int, Any], int]:
        """The function that puts them into what was found, and gives where they end."""
        for group in groups:
            raw = self._integer(group.octets)
            self._load()
            for name, value in self._parts(group, raw):
                self._line(f"found[{name!r}] = {value}")
            self._line(f"if not {raw} & {FX}: return at")
        self._line(f"found[{FURTHER!r}], at = further(body, at)")
        return cast(Callable[[bytes, int, Any], int], self._compiled("return at"))

    def _group(self, group: Group) -> list[tuple[str, str]]:
        """Parts and their values. Where all are whole octets, each is read by itself."""
        if group.fx or any(part.bits % 8 for part in group.parts):
            return self._parts(group, self._integer(group.octets))
        values = []
        for part in group.parts:
            if isinstance(part, Spare):
                self._codes += f"{part.bits // 8}x"
            else:
                values.append((part.name, self._whole(part)))
        return values

    def _whole(self, part: Named) -> str:
        """The value of a part of whole octets."""
        octets = part.bits // 8
        if isinstance(part, Characters):
            if part.alphabet == ASCII:
                return f"{self._word(f'{octets}s')}.decode('latin-1')"
            return self._text(part, self._integer(octets), 0)
        signed = isinstance(part, Quantity) and part.signed
        return _scaled(part, self._integer(octets, signed=signed))

    def _parts(self, group: Group, raw: str) -> list[tuple[str, str]]:
        """The parts of a group that is one integer, and their values."""
        return [(part.name, self._bits(group, part, raw, right)) for part, right in group.fields]

    def _bits(self, group: Group, part: Named, raw: str, right: int) -> str:
        if isinstance(part, Characters):
            return self._text(part, raw, right)
        value = f"{raw} >> {right}" if right else raw
        if right + part.bits < 8 * group.octets:
            value = f"{value} & {(1 << part.bits) - 1}"
        if isinstance(part, Quantity) and part.signed:
            sign = 1 << part.bits - 1
            value = f"({value} ^ {sign}) - {sign}"
        return _scaled(part, f"({value})")

    def _text(self, part: Characters, raw: str, right: int) -> str:
        """Text looked up some characters at once."""
        terms = []
        left = part.count
        while left:
            some = min(left, TABLE_BITS // part.bits_each)
            left -= some
            table, bits = f"text{part.bits_each}_{some}", some * part.bits_each
            self._called[table] = _texts(part.alphabet, part.bits_each, some)
            place = right + left * part.bits_each
            terms.append(f"{table}[{raw} >> {place} & {(1 << bits) - 1}]")
        return " + ".join(terms)

    def _integer(self, octets: int, *, signed: bool = False) -> str:
        """The name of the next octets, so many, as one integer."""
        if octets >= 2 * WORD_OCTETS[-1]:
            return self._join(f"from_bytes({self._word(f'{octets}s')}, 'big')")
        terms = []
        right = octets
        for size in (size for size in WORD_OCTETS if octets & size):
            code = _CODES[size]
            word = self._word(code.lower() if signed and right == octets else code)
            right -= size
            terms.append(f"{word} << {8 * right}" if right else word)
        return self._join(" | ".join(terms)) if len(terms) > 1 else terms[0]

    def _word(self, code: str) -> str:
        self._codes += code
        self._words.append(self._name("word"))
        return self._words[-1]

    def _join(self, words: str) -> str:
        joined = self._name("joined")
        self._joined.append(f"{joined} = {words}")
        return joined

    def _load(self) -> None:
        """Read the words that wait, and go behind them."""
        if not self._codes:
            return
        words, unpack = struct.Struct(f">{self._codes}"), self._name("unpack")
        self._called[unpack] = words.unpack_from
        self._line(f"{', '.join(self._words)}, = {unpack}(body, at)")
        self._line(f"at += {words.size}")
        for joined in self._joined:
            self._line(joined)
        self._codes, self._words, self._joined = "", [], []

    def _name(self, kind: str) -> str:
        """A name that nothing else has."""
        return f"{kind}{next(self._numbers)}"

    def _line(self, text: str) -> None:
        self._lines.append(f"    {text}")

    def _compiled(self, last: str) -> Any:
        self._line(last)
        # The text holds numbers and names of our own layouts only: nothing of a sender's gets in.
        exec("\n".join([*self._lines, ""]), self._called)  # noqa: S102  # nosec B102
        return self._called["read"]


def _literal(values: Sequence[tuple[str, str]]) -> str:
    """A dict of those names and expressions."""
    return "{" + ", ".join(f"{name!r}: {value}" for name, value in values) + "}"


def _further(body: bytes, at: int) -> tuple[bytes, int]:
    """The octets of groups that a layout does not have."""
    end = at
    while body[end] & FX:
        end += 1
    return body[at : end + 1], end + 1


def _scaled(part: Named, raw: str) -> str:
    if not isinstance(part, Quantity):
        return raw
    return f"{raw} / {part.divisor}" if part.divisor else f"{raw} * {float(part.lsb)!r}"


@cache
def _texts(alphabet: str, bits_each: int, count: int) -> Sequence[str]:
    """What each integer of so many characters says."""
    if count == 1:
        return alphabet
    return [
        alphabet[raw >> (count - 1) * bits_each] + rest
        for raw in range(1 << bits_each * count)
        for rest in [
            _texts(alphabet, bits_each, count - 1)[raw & (1 << (count - 1) * bits_each) - 1]
        ]
    ]


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


# Where an item lies: its first octet, and the one after its last.
ItemPlace: TypeAlias = tuple[Item, int, int]


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


@cache
def _plans_of(category: Category) -> Reader:
    plots, tracks = Plans(category.uap).read, Plans(category.track_uap).read

    def read(body: bytes, at: int) -> tuple[Any, int]:
        return (tracks if _is_track(body, at) else plots)(body, at)

    return read if category.track_uap else plots


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

    def _each(self, items: Sequence[Item], at: int) -> Iterator[ItemPlace]:
        for item in items:
            end = self._end(item, at)
            yield item, at, end
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

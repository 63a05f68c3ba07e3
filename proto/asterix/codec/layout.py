"""What an ASTERIX record is made of, as data, and the notation in which categories are written.

A category is a table with a row an item: its field reference number, its name, its octets, and its
parts. Parts stand between commas: NAME 7 is an integer of seven bits, NAME alone a flag, _3 three
spare bits, NAME 8x6 text of eight characters of six bits. NAME ±16: 1/4 m is a quantity with its
LSB and unit, signed if it has the sign. Outside its range a quantity saturates, unless it says that
it is refused, that it wraps, or that it counts modulo so many units. A group of parts that is a bit
short of whole octets has the extension bit there, and | stands between such groups.

A row that begins with "repeated:" holds its group again and again, as often as a first octet says
or while the extension bit is set. Semicolons stand between the subfields of a compound item: each
a part whose name it has, NAME (parts), or - where a flag is not assigned. "octets behind their
count" are what no layout tells, the SP and RE fields.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import Enum

HEADER_OCTETS = 3  # Octets before the records of a data block: its category, and its length in two

FX = 1  # The extension bit: the last of an octet that others follow

# A day in 1/128 s: the modulus of every time of day. It fits in 24 bits, so no mask drops it.
DAY_LSB = 86_400 * 128

# The 6-bit characters of an aircraft identification; ICAO Annex 10 volume IV, 3.1.2.9.1.2.
CALLSIGN = "?ABCDEFGHIJKLMNOPQRSTUVWXYZ????? ???????????????0123456789??????"

OCTAL = "01234567"

# Characters of an octet each; the upper half, which no standard assigns, reads as Latin-1.
ASCII = bytes(range(256)).decode("latin-1")


class Overflow(Enum):
    """What an encoder does with a value that is outside the range, once rounded to an LSB."""

    REFUSE = "refuse"
    SATURATE = "saturate"
    WRAP = "wrap"


@dataclass(frozen=True, slots=True)
class Spare:
    """Bits that are sent as zero and not read."""

    bits: int


@dataclass(frozen=True, slots=True)
class Raw:
    """An unsigned integer that stands for itself: an enumeration, a flag, a code."""

    name: str
    bits: int

    @property
    def limits(self) -> tuple[int, int]:
        """Least and greatest integer."""
        return 0, (1 << self.bits) - 1


@dataclass(frozen=True, slots=True)
class Quantity:
    """A physical value: an integer times `lsb`, in `unit`; two's complement if signed.

    With WRAP the integer is taken modulo `modulus`, or 2**bits where that is 0.
    """

    name: str
    bits: int
    lsb: float = 1.0
    unit: str = ""
    signed: bool = False
    overflow: Overflow = Overflow.REFUSE
    modulus: int = 0

    @property
    def limits(self) -> tuple[int, int]:
        """Least and greatest integer."""
        if self.signed:
            return -(1 << self.bits - 1), (1 << self.bits - 1) - 1
        return 0, (1 << self.bits) - 1

    @property
    def divisor(self) -> int:
        """How many LSBs are 1, where they are a whole number that is no power of two; else 0.

        An integer divided by it is the float nearest to what was sent, as 35 times 0.01 is not.
        Any other LSB is a float that is exact, and so are its multiples.
        """
        each = round(1 / self.lsb)
        return each if each & each - 1 and 1 / each == self.lsb else 0


@dataclass(frozen=True, slots=True)
class Characters:
    """Text, each character an index into `alphabet`, whose length is a power of two."""

    name: str
    count: int
    alphabet: str

    @property
    def bits_each(self) -> int:
        """Bits in a character."""
        return len(self.alphabet).bit_length() - 1

    @property
    def bits(self) -> int:
        """Bits in all."""
        return self.count * self.bits_each


Named = Raw | Quantity | Characters
Part = Spare | Named


@dataclass(frozen=True, slots=True)
class Group:
    """Parts in a whole number of octets; `fx` says that an extension bit follows the last part."""

    parts: tuple[Part, ...]
    fx: bool = False
    octets: int = field(init=False)
    # The named parts, each with the bits to its right in the group.
    fields: tuple[tuple[Named, int], ...] = field(init=False)

    def __post_init__(self) -> None:
        bits = sum(part.bits for part in self.parts) + self.fx
        if bits % 8 or not bits:
            raise ValueError(f"{bits} bits are not a whole number of octets: {self.parts}")
        object.__setattr__(self, "octets", bits // 8)
        object.__setattr__(self, "fields", tuple(self._fields(bits)))

    def _fields(self, right: int) -> Iterator[tuple[Named, int]]:
        for part in self.parts:
            right -= part.bits
            if not isinstance(part, Spare):
                yield part, right


@dataclass(frozen=True, slots=True)
class Fixed:
    """A single group. An item of one named part is that part's value, without a name of its own."""

    name: str
    group: Group


@dataclass(frozen=True, slots=True)
class Extended:
    """Groups that follow each other as long as the extension bit of the one before is set."""

    name: str
    groups: tuple[Group, ...]


@dataclass(frozen=True, slots=True)
class Repetitive:
    """A group again and again: as often as a first octet says, or while FX is set."""

    name: str
    group: Group


@dataclass(frozen=True, slots=True)
class Explicit:
    """Bytes behind a length octet, which counts itself: the SP and RE fields."""

    name: str


@dataclass(frozen=True, slots=True)
class Compound:
    """A primary subfield of flags with extension bits, then those subfields whose flag is set."""

    name: str
    subfields: tuple[Fixed | Extended | Repetitive | None, ...]


@dataclass(frozen=True, slots=True)
class Undecoded:
    """An item of which no more is known than where it ends: its value is its octets."""

    name: str
    of: Fixed | Extended | Repetitive | Compound


Item = Fixed | Extended | Repetitive | Explicit | Compound | Undecoded


@dataclass(frozen=True, slots=True, eq=False)
class Category:
    """A category: its number and its items in the order of their field reference numbers.

    Each edition is who it is, so that what is made from one is found quickly.
    """

    number: int
    uap: tuple[Item | None, ...]
    # Of 001, that of records that are tracks, as the first bit of their second item says.
    track_uap: tuple[Item | None, ...] = ()

    @property
    def time(self) -> str:
        """The name of its first item that tells the time of day; empty for none."""
        return next((item.name for item in self.uap if item and is_time_of_day(item)), "")


_ALPHABETS = {3: OCTAL, 6: CALLSIGN, 8: ASCII}
_OVERFLOW = {None: Overflow.SATURATE, "refused": Overflow.REFUSE}
_ROW = re.compile(r"^(\d+) +(\w+/\w+) +(\S+) +(.*(?:\n +.*)*)", re.MULTILINE)
_HEAD = re.compile(r"^FRN .*", re.MULTILINE)
EXPLICIT = "octets behind their count"
_REPEATED = "repeated: "
_SUBFIELD = re.compile(r"(\w+) \((.*)\)")
_SPARE = re.compile(r"_(\d+)")
_QUANTITY = re.compile(
    r"(\w+) (±?)(\d+): (\S+)(?: (?!wraps|refused|modulo)(\S+))?(?: (wraps|refused|modulo (\d+)))?"
)
_TEXT = re.compile(r"(\w+) (\d+)x(\d)")
_RAW = re.compile(r"(\w+)(?: (\d+))?")


def category(number: int, table: str, base: Category | None = None) -> Category:
    """The category of a table; rows that it lacks are those of `base`.

    Raises `ValueError` for what is not in the notation.
    """
    if rest := _HEAD.sub("", _ROW.sub("", table)).strip():
        raise ValueError(f"{rest!r} is no row of an item")
    items: dict[int, Item | None] = dict(enumerate(base.uap, 1)) if base else {}
    for frn, name, _, parts in _ROW.findall(table):
        items[int(frn)] = item_of(name, " ".join(parts.split()))
    return Category(number, tuple(items.get(frn) for frn in range(1, max(items) + 1)))


def item_of(name: str, text: str) -> Item:
    """The item of those parts; raises `ValueError` for what is not in the notation."""
    if text == EXPLICIT:
        return Explicit(name)
    if "; " in text:
        return Compound(name, tuple(map(_subfield, text.split("; "))))
    return _simple(name, text)


def _subfield(text: str) -> Fixed | Extended | Repetitive | None:
    if text == "-":
        return None
    if named := _SUBFIELD.fullmatch(text):
        return _simple(named[1], named[2])
    group = _group(text)
    ((part, _),) = group.fields
    return Fixed(part.name, group)


def _simple(name: str, text: str) -> Fixed | Extended | Repetitive:
    if text.startswith(_REPEATED):
        return Repetitive(name, _group(text.removeprefix(_REPEATED)))
    groups = tuple(map(_group, text.split(" | ")))
    return Extended(name, groups) if groups[0].fx else Fixed(name, groups[0])


def _group(text: str) -> Group:
    parts = tuple(map(_part, text.split(", ")))
    return Group(parts, fx=sum(part.bits for part in parts) % 8 == 7)


def _part(text: str) -> Part:
    if spare := _SPARE.fullmatch(text):
        return Spare(int(spare[1]))
    if found := _QUANTITY.fullmatch(text):
        name, sign, bits, lsb, unit, overflow, modulus = found.groups()
        return Quantity(
            name,
            int(bits),
            _number(lsb),
            unit or "",
            signed=bool(sign),
            overflow=_OVERFLOW.get(overflow, Overflow.WRAP),
            modulus=round(int(modulus) / _number(lsb)) if modulus else 0,
        )
    if found := _TEXT.fullmatch(text):
        return Characters(found[1], int(found[2]), _ALPHABETS[int(found[3])])
    if found := _RAW.fullmatch(text):
        return Raw(found[1], int(found[2] or 1))
    raise ValueError(f"{text!r} is no part of an item")


def _number(text: str) -> float:
    """A number such as 0.01, 1/4, 2^-14 or 180/2^31."""
    dividend, _, divisor = text.partition("/")
    return _power(dividend) / _power(divisor or "1")


def _power(text: str) -> float:
    base, _, exponent = text.partition("^")
    return float(base) ** int(exponent or "1")


def is_time_of_day(item: Item) -> bool:
    """Whether it counts 1/128 s since midnight, and nothing else."""
    if not isinstance(item, Fixed) or len(item.group.fields) != 1:
        return False
    part, _ = item.group.fields[0]
    return isinstance(part, Quantity) and part.modulus == DAY_LSB

"""What an ASTERIX record is made of, as data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import Enum

DAY_LSB = 86_400 * 128
"""A day in 1/128 s: the modulus of every time of day. It fits in 24 bits, so no mask drops it."""

CALLSIGN = "?ABCDEFGHIJKLMNOPQRSTUVWXYZ????? ???????????????0123456789??????"
"""The 6-bit characters of an aircraft identification; ICAO Annex 10 volume IV, 3.1.2.9.1.2."""

OCTAL = "01234567"

ASCII = bytes(range(256)).decode("latin-1")
"""Characters of an octet each; the upper half, which no standard assigns, reads as Latin-1."""


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
    fields: tuple[tuple[Named, int], ...] = field(init=False)
    """The named parts, each with the bits to its right in the group."""

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
    """One group. An item of a single named part is that part's value, without a name of its own."""

    name: str
    group: Group


@dataclass(frozen=True, slots=True)
class Extended:
    """Groups that follow each other as long as the extension bit of the one before is set."""

    name: str
    groups: tuple[Group, ...]


@dataclass(frozen=True, slots=True)
class Repetitive:
    """The same group again and again: as often as a first octet says, or while FX is set."""

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


Item = Fixed | Extended | Repetitive | Explicit | Compound


@dataclass(frozen=True, slots=True)
class Category:
    """A category: its number and its items in the order of their field reference numbers."""

    number: int
    uap: tuple[Item | None, ...]


def fixed(name: str, *parts: Part) -> Fixed:
    """A fixed item of those parts."""
    return Fixed(name, Group(parts))


def extended(name: str, *groups: tuple[Part, ...]) -> Extended:
    """An extended item; each group lacks its extension bit."""
    return Extended(name, tuple(Group(parts, fx=True) for parts in groups))


def repeated(name: str, *parts: Part) -> Repetitive:
    """A repetitive item behind an octet that counts."""
    return Repetitive(name, Group(parts))


def repeated_fx(name: str, *parts: Part) -> Repetitive:
    """A repetitive item that goes on while the extension bit is set."""
    return Repetitive(name, Group(parts, fx=True))


def flags(names: str) -> tuple[Raw, ...]:
    """Parts of one bit each; their names stand between spaces."""
    return tuple(Raw(name, 1) for name in names.split())


def source(item: str) -> Fixed:
    """Who sends: system area code and system identification code."""
    return fixed(item, Raw("SAC", 8), Raw("SIC", 8))


def time_of_day(item: str, name: str = "TOD") -> Fixed:
    """Seconds since midnight UTC."""
    time = Quantity(name, 24, 1 / 128, "s", overflow=Overflow.WRAP, modulus=DAY_LSB)
    return fixed(item, time)


def unsigned(name: str, bits: int, lsb: float, unit: str = "") -> Quantity:
    """A quantity from 0 on, which saturates."""
    return Quantity(name, bits, lsb, unit, overflow=Overflow.SATURATE)


def signed(name: str, bits: int, lsb: float, unit: str = "") -> Quantity:
    """A quantity of either sign, which saturates."""
    return Quantity(name, bits, lsb, unit, signed=True, overflow=Overflow.SATURATE)


def correlation(name: str) -> Quantity:
    """A coefficient of correlation: -1 to 127/128."""
    return signed(name, 8, 1 / 128)


def full_circle(name: str, bits: int = 16) -> Quantity:
    """An angle in as many steps as there are integers."""
    return Quantity(name, bits, 360 / (1 << bits), "deg", overflow=Overflow.WRAP)


def position(bits: int, latitude_lsb: float, longitude_lsb: float) -> tuple[Quantity, Quantity]:
    """Latitude and longitude, degrees. A longitude as wide as the circle wraps."""
    wraps = longitude_lsb * (1 << bits) == 360
    overflow = Overflow.WRAP if wraps else Overflow.REFUSE
    return (
        Quantity("LAT", bits, latitude_lsb, "deg", signed=True),
        Quantity("LON", bits, longitude_lsb, "deg", signed=True, overflow=overflow),
    )


def position_180(bits: int, exponent: int) -> tuple[Quantity, Quantity]:
    """Latitude and longitude, both in 180/2**exponent degrees."""
    return position(bits, 180 / (1 << exponent), 180 / (1 << exponent))


def single(part: Named) -> Fixed:
    """A subfield of one part, whose name it has."""
    return fixed(part.name, part)

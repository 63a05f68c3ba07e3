"""Items and records read fast, by Python compiled from a layout, that tells no errors.

A reader takes the octets of a block's body and where its item begins, and gives the value and where
the item ends. What is cut off or broken raises `BROKEN`; `codec.decode`, whose slower road is the
rule that readers follow, then says what is wrong.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import cache
from typing import Any

from plotfeed.proto.asterix.codec.layout import (
    FX,
    Compound,
    Explicit,
    Extended,
    Fixed,
    Item,
    Repetitive,
    Undecoded,
)
from plotfeed.proto.asterix.codec.reader_source import FURTHER, Reader, ReaderSource, literal

__all__ = ["BROKEN", "FURTHER", "Plans", "Reader", "reader_of"]

BROKEN = (IndexError, struct.error)
"""What readers raise."""
MAX_PLANS = 4096
"""Of one record or item; what has sent more sets of flags than that begins anew."""
OFTEN = 100
"""Times that a set of flags comes before its items are compiled into one reader.

Compiling that takes as long as reading some hundred records item by item.
"""


class Plans:
    """How a user application profile, or a compound item, is read, by its octets of flags."""

    __slots__ = ("_readers", "_slots")

    def __init__(self, slots: Sequence[Item | None]) -> None:
        self._slots = slots
        self._readers: dict[bytes, Reader] = {}

    def __len__(self) -> int:
        return len(self._readers)

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
        reader = self._readers[flags] = self._one_by_one(flags, chosen)
        return reader

    def _one_by_one(self, flags: bytes, items: Sequence[Item]) -> Reader:
        """Reads item by item, until those flags have come often."""
        readers = [(item.name, reader_of(item)) for item in items]
        left = OFTEN

        def read(body: bytes, at: int) -> tuple[dict[str, Any], int]:
            nonlocal left
            left -= 1
            if not left:
                self._readers[flags] = _all_of(items)
            found: dict[str, Any] = {}
            for name, reader in readers:
                found[name], at = reader(body, at)
            return found, at

        return read


def _all_of(items: Sequence[Item]) -> Reader:
    """The one reader of items that follow each other."""
    source = ReaderSource()
    return source.reader(literal([(item.name, _value(item, source)) for item in items]))


def _value(item: Item, source: ReaderSource) -> str:
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
            source = ReaderSource()
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

"""Many submessages of protobuf at once, of whatever lengths: each field of all of them a column.

All rows are filled in at their widest, with a mask of what each of them has; what the mask holds
are the octets that protobuf itself makes: fields in the order of their numbers, no defaults.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.state import Bools, Floats, Ints
from plotfeed.proto.varint import varint, varint_octets

VARINT, DOUBLE, LENGTH = 0, 1, 2  # Wire types
Octets = NDArray[np.uint8]

_SHIFTS = np.arange(0, 70, 7, dtype=np.uint64)
# From each of them on, a number takes an octet more.
_THRESHOLDS = (1 << _SHIFTS[1:]).astype(np.uint64)
_PLACES = np.arange(10)


class Field(Protocol):
    """A field of all rows."""

    @property
    def width(self) -> int:
        """Octets that it takes at most."""

    @property
    def lengths(self) -> Ints | int:
        """Octets that it takes in each row, (n,), or in all of them."""

    def fill(self, octets: Octets, mask: Bools) -> None:
        """Write its octets, (n, width), and which of them a row has, where these are not all."""


def tag(field: int, wire_type: int) -> bytes:
    """What stands before a field, which is told by its number as everywhere here."""
    return varint(field << 3 | wire_type)


def text_field(field: int, text: str) -> bytes:
    """A field of text; nothing if it is empty, which is the default."""
    octets = text.encode()
    return tag(field, LENGTH) + varint(len(octets)) + octets if octets else b""


class Doubles:
    """A field of 64-bit floats; where `held` is not given, zero is a default and is left out."""

    def __init__(self, field: int, values: Floats, held: Bools | None = None) -> None:
        self._tag = np.frombuffer(tag(field, DOUBLE), np.uint8)
        self._bits = np.ascontiguousarray(values, "<f8").view(np.int64)
        self.width = len(self._tag) + 8
        found: Bools = self._bits != 0 if held is None else held
        self._held = None if found.all() else found
        self.lengths = self.width if self._held is None else self.width * self._held

    def fill(self, octets: Octets, mask: Bools) -> None:
        """Write them, and which rows have one."""
        octets[:, : len(self._tag)] = self._tag
        octets[:, len(self._tag) :] = self._bits.view(np.uint8).reshape(-1, 8)
        if self._held is not None:
            mask &= self._held[:, None]


class Integers:
    """A field of integers or booleans; zero is a default and is left out, but not of lengths."""

    def __init__(self, field: int, values: NDArray[Any], wire_type: int = VARINT) -> None:
        self._tag = np.frombuffer(tag(field, wire_type), np.uint8)
        self._numbers = values.astype(np.uint64)  # a negative one in two's complement
        least, most = int(self._numbers.min()), int(self._numbers.max())
        shortest, longest = varint_octets(least), varint_octets(most)
        self._held = None if least or wire_type == LENGTH else self._numbers != 0
        self.width = len(self._tag) + longest if most or self._held is None else 0
        self._own: Ints | int = longest
        if shortest < longest:
            self._own = 1 + np.searchsorted(_THRESHOLDS, self._numbers, side="right")
        lengths = len(self._tag) + self._own
        self.lengths = lengths if self._held is None else lengths * self._held

    def fill(self, octets: Octets, mask: Bools) -> None:
        """Write seven bits an octet, the lowest first; the highest bit says that more follow."""
        if not self.width:
            return
        head = len(self._tag)
        octets[:, :head] = self._tag
        own, places = self._own, _PLACES[: self.width - head]
        if len(places) > 1:
            octets[:, head:] = self._numbers[:, None] >> _SHIFTS[: len(places)] & np.uint64(0x7F)
        else:
            octets[:, head] = self._numbers
        if isinstance(own, int):
            octets[:, head:-1] |= 0x80
        else:
            octets[:, head:] |= (places < own[:, None] - 1) * np.uint8(0x80)
            mask[:, head:] = places < own[:, None]
        if self._held is not None:
            mask &= self._held[:, None]


class Constant:
    """A field that is the same in every row, its octets given as they are."""

    def __init__(self, octets: bytes) -> None:
        self._octets = np.frombuffer(octets, np.uint8)
        self.width = self.lengths = len(octets)

    def fill(self, octets: Octets, _mask: Bools) -> None:
        """Write them."""
        octets[:] = self._octets


class TextTable:
    """Fields of octets by number, such as names of drones, which may become more."""

    def __init__(self, entries: Sequence[bytes] = ()) -> None:
        self._lengths = np.zeros(0, np.int64)
        self._octets = np.zeros((0, 0), np.uint8)
        self.extend(entries)

    def __len__(self) -> int:
        return len(self._lengths)

    def extend(self, entries: Sequence[bytes]) -> None:
        """Add others, by the next numbers."""
        if not entries:
            return
        self._lengths = np.concatenate([self._lengths, [len(each) for each in entries]])
        width = max(int(self._lengths.max()), self._octets.shape[1])
        rows = np.frombuffer(b"".join(each.ljust(width, b"\0") for each in entries), np.uint8)
        before = np.pad(self._octets, ((0, 0), (0, width - self._octets.shape[1])))
        self._octets = np.concatenate([before, rows.reshape(len(entries), width)])

    def put(self, numbers: Sequence[int], entries: Sequence[bytes]) -> None:
        """Have others in the place of those numbers."""
        width = max(map(len, entries), default=0)
        more = max(0, width - self._octets.shape[1])
        self._octets = np.pad(self._octets, ((0, 0), (0, more)))
        for number, entry in zip(numbers, entries, strict=True):
            self._octets[number, : len(entry)] = np.frombuffer(entry, np.uint8)
            self._lengths[number] = len(entry)

    def cut(self, length: int) -> None:
        """Have no more than so many."""
        self._lengths, self._octets = self._lengths[:length].copy(), self._octets[:length].copy()

    def of(self, numbers: Ints) -> Field:
        """The fields of those numbers, in that order."""
        return _FromTable(self._octets[numbers], self._lengths[numbers])


class _FromTable:
    def __init__(self, octets: Octets, lengths: Ints) -> None:
        self._octets, self.lengths = octets, lengths
        self.width = int(lengths.max(initial=0))

    def fill(self, octets: Octets, mask: Bools) -> None:
        octets[:] = self._octets[:, : self.width]
        mask[:] = np.arange(self.width) < self.lengths[:, None]


def submessages(field: int, rows: int, fields: Sequence[Field]) -> tuple[bytes, Ints]:
    """Rows of those fields, at least one, as that repeated field.

    With where each row begins and ends, (n+1,).
    """
    lengths = np.zeros(rows, np.int64)
    for each in fields:
        lengths += each.lengths
    before = Integers(field, lengths, LENGTH)
    widths = [before.width, *(each.width for each in fields)]
    octets = np.empty((rows, sum(widths)), np.uint8)
    mask = np.ones(octets.shape, np.bool_)
    place = 0
    for each, width in zip((before, *fields), widths, strict=True):
        each.fill(octets[:, place : place + width], mask[:, place : place + width])
        place += width
    ends = np.zeros(rows + 1, np.int64)
    np.cumsum(lengths + before.lengths, out=ends[1:])
    return octets[mask].tobytes(), ends

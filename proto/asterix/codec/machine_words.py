"""Records cut into big-endian words of 1, 2, 4 and 8 octets, the integers that machines store.

A part of 3 octets, such as the time of day, shares a word with its neighbours or is cut in two.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

SIZES = (8, 4, 2, 1)


class WordSpan(Protocol):
    """Bits of a record, `right` of which follow them."""

    @property
    def right(self) -> int: ...  # noqa: D102 - the class says it

    @property
    def bits(self) -> int: ...  # noqa: D102 - the class says it


@dataclass(frozen=True, slots=True)
class Piece:
    """What column number `column` adds to a word: shifted left (right if negative), then masked."""

    column: int
    shift: int
    mask: int
    """0 where nothing would be masked off."""


@dataclass(frozen=True, slots=True)
class Word:
    """`size` octets at `offset`, and the pieces that are ORed into what a template has there."""

    offset: int
    size: int
    right: int
    """Bits of the record that follow it."""
    pieces: tuple[Piece, ...]

    def of(self, template: int) -> int:
        """What a template, a record as an integer, has there."""
        return template >> self.right & (1 << self.size * 8) - 1


def whole(octets: int, spans: Sequence[WordSpan]) -> list[Word]:
    """Words that make up the whole record, as few as go without cutting a span."""
    return list(_words(0, octets, octets, spans))


def cells(octets: int, spans: Sequence[WordSpan]) -> list[Word]:
    """Words for no more than the octets that spans lie in; adjoining spans share none."""
    words: list[Word] = []
    for start, stop in _islands(octets, spans):
        words.extend(_words(start, stop, octets, spans))
    return words


def _octets_of(octets: int, span: WordSpan) -> tuple[int, int]:
    """First octet of a span, and the one after its last."""
    end = octets * 8 - span.right
    return (end - span.bits) // 8, -(-end // 8)


def _islands(octets: int, spans: Iterable[WordSpan]) -> list[tuple[int, int]]:
    """Runs of octets which hold spans that have an octet in common."""
    runs: list[tuple[int, int]] = []
    for start, stop in sorted(_octets_of(octets, span) for span in spans):
        if runs and start < runs[-1][1]:
            runs[-1] = (runs[-1][0], max(stop, runs[-1][1]))
        else:
            runs.append((start, stop))
    return runs


def _words(start: int, stop: int, octets: int, spans: Sequence[WordSpan]) -> Iterator[Word]:
    inside = {
        octet for first, after in _islands(octets, spans) for octet in range(first + 1, after)
    }
    while start < stop:
        fitting = [size for size in SIZES if start + size <= stop]
        size = next((size for size in fitting if start + size not in inside), fitting[0])
        yield _word(start, size, octets, spans)
        start += size


def _word(offset: int, size: int, octets: int, spans: Sequence[WordSpan]) -> Word:
    right = (octets - offset - size) * 8
    full = (1 << size * 8) - 1
    pieces = []
    for column, span in enumerate(spans):
        shift = span.right - right
        if shift < size * 8 and shift + span.bits > 0:
            mask = full if shift + span.bits > size * 8 else 0
            pieces.append(Piece(column, shift, mask))
    return Word(offset, size, right, tuple(pieces))

"""A few records at once: straight-line Python, written for one profile and compiled once.

What the generic rule decides anew for each value is decided here when the text is written: only
arithmetic and one struct.pack a record are left.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any, NoReturn, cast

from plotfeed.proto.asterix.codec.layout import Overflow
from plotfeed.proto.asterix.codec.machine_words import Piece, Word, whole
from plotfeed.proto.asterix.codec.scaling import ScalingRule
from plotfeed.proto.errors import EncodeError

CODES = {1: "B", 2: "H", 4: "I", 8: "Q"}

One = Callable[..., bytes]
Many = Callable[[Sequence[Any]], bytes]


def compiled(octets: int, template: int, rules: Sequence[ScalingRule]) -> tuple[One, Many]:
    """A function of one record's values, and one of the columns of many; both give octets."""
    words = whole(octets, template, rules)
    packer = struct.Struct(">" + "".join(CODES[word.size] for word in words))
    names = {
        "pack": packer.pack,
        "rounded": float.__round__,  # half to even, in less than half the time of round()
        "blame": _blame(rules),
        "faults": (TypeError, ValueError, OverflowError, struct.error),
    }
    names |= {f"text{column}": rule.integer for column, rule in enumerate(rules) if rule.text}
    # The text holds numbers and our own variable names only: nothing of the caller's gets in.
    exec(_source(rules, words), names)  # noqa: S102 - as dataclasses do, from our layouts alone
    return cast(One, names["one"]), cast(Many, names["many"])


def _blame(rules: Sequence[ScalingRule]) -> Callable[..., NoReturn]:
    """A function that raises the EncodeError of the first value which the rules refuse."""

    def blame(*values: object) -> NoReturn:
        for rule, value in zip(rules, values, strict=True):
            rule.integer(value)
        raise EncodeError(f"{values} cannot be encoded", field=rules[0].path)

    return blame


def _source(rules: Sequence[ScalingRule], words: Sequence[Word]) -> str:
    values = "".join(f"v{column}, " for column in range(len(rules)))
    packed = f"pack({', '.join(_word(word) for word in words)})"
    steps = [line for column, rule in enumerate(rules) for line in _integer(column, rule)]
    handler = ["except faults:", f"    blame({values})"]
    if not rules:
        return f"one = lambda: {packed}\ndef many(columns): return {packed}\n"
    return "\n".join(
        [
            f"def one({values}):",
            *_indented(1, "try:", *_indented(1, *steps, f"return {packed}"), *handler),
            "def many(columns):",
            *_indented(1, "records = []", "add = records.append"),
            f"    for {values} in zip(*columns):",
            *_indented(2, "try:", *_indented(1, *steps, f"add({packed})"), *handler),
            '    return b"".join(records)',
            "",
        ]
    )


def _indented(levels: int, *lines: str) -> list[str]:
    return ["    " * levels + line for line in lines]


def _integer(column: int, rule: ScalingRule) -> list[str]:
    """Lines that make the integer `r<column>` of the value `v<column>`."""
    r, v = f"r{column}", f"v{column}"
    if rule.text:
        return [f"{r} = text{column}({v})"]
    if not isinstance(rule.lsb, int):
        lines = [f"{r} = rounded({v} / {rule.lsb!r})"]
    elif rule.lsb == 1:
        lines = [f"{r} = {v}"]
    elif rule.lsb % 2:
        lines = [f"{r} = ({v} + {rule.lsb // 2}) // {rule.lsb}"]
    else:
        half = rule.lsb // 2
        lines = [
            f"q = {v} // {half}",
            f"{r} = q + 1 >> 1",
            f"if q & 3 == 1 and {v} == q * {half}: {r} -= 1",  # a tie above an even number
        ]
    match rule.overflow:
        case Overflow.WRAP if rule.modulus & rule.modulus - 1:
            lines.append(f"{r} %= {rule.modulus}")
        case Overflow.WRAP:
            lines.append(f"{r} &= {rule.modulus - 1}")
        case Overflow.SATURATE if rule.low:
            lines.append(f"if {r} > {rule.high}: {r} = {rule.high}")
            lines.append(f"elif {r} < {rule.low}: {r} = {rule.low}")
        case Overflow.SATURATE:
            lines.append(f"if {r} >> {rule.bits}: {r} = {rule.high} if {r} > 0 else 0")
        case Overflow.REFUSE:
            lines.append(f"if not {rule.low} <= {r} <= {rule.high}: raise ValueError")
    if rule.low < 0:
        lines.append(f"{r} &= {(1 << rule.bits) - 1}")
    return lines


def _word(word: Word) -> str:
    terms = [_piece(piece) for piece in word.pieces]
    if word.constant or not terms:
        terms.insert(0, str(word.constant))
    return " | ".join(terms)


def _piece(piece: Piece) -> str:
    text = f"r{piece.column}"
    if piece.shift:
        text += f" << {piece.shift}" if piece.shift > 0 else f" >> {-piece.shift}"
    return f"({text}) & {piece.mask}" if piece.mask else f"({text})"

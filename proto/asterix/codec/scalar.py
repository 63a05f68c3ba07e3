"""A few records at once, value by value: the rule of a column, and Python compiled from rules.

The rule is the reference for both fast paths of the encoder, makes their constants, and finds which
value they stumbled over. What it decides anew for each value is decided once where straight-line
Python is written for a profile: only arithmetic and one struct.pack a record are left.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn, cast

from plotfeed.proto.asterix.codec.layout import Characters, Overflow, Quantity, Raw
from plotfeed.proto.asterix.codec.machine_words import Piece, Word, whole
from plotfeed.proto.asterix.codec.profile import Slot
from plotfeed.proto.errors import EncodeError

CODES = {1: "B", 2: "H", 4: "I", 8: "Q"}

Constants = tuple[int, ...]
"""What stands in the words of a record before any value does."""
Few = Callable[[Sequence[Constants], Sequence[Any]], bytes]


@dataclass(frozen=True, slots=True)
class ScalingRule:
    """How a column becomes integers: round half to even to `lsb`, then what `overflow` says.

    `lsb` is in the column's unit. Where it is an int the column is of integers, and the
    arithmetic is exact. A column of text has its characters in `text`.
    """

    path: str
    right: int
    bits: int
    lsb: float
    low: int
    high: int
    overflow: Overflow
    modulus: int
    text: Characters | None = None

    @classmethod
    def of(cls, slot: Slot, lsb: float | None = None) -> ScalingRule:
        """The rule of a slot; `lsb` stands in for that of its part where columns use other units.

        A raw part takes integers, a quantity floats, characters take text.
        """
        own: float
        match slot.part:
            case Quantity() as part:
                overflow, modulus = part.overflow, part.modulus or 1 << part.bits
                own, (low, high), text = float(part.lsb), part.limits, None
            case Raw() as part:
                overflow, modulus, own, text = Overflow.REFUSE, 0, 1, None
                low, high = part.limits
            case Characters() as part:
                overflow, modulus, own, text = Overflow.REFUSE, 0, 1, part
                low, high = 0, (1 << part.bits) - 1
        used = own if lsb is None else lsb
        return cls(slot.path, slot.right, part.bits, used, low, high, overflow, modulus, text)

    def integer(self, value: object) -> int:
        """The integer for one value, in two's complement: 0 to 2**bits - 1."""
        if self.text is not None:
            return self._characters(self.text, value)
        raw = self._rounded(value)
        match self.overflow:
            case Overflow.WRAP:
                raw %= self.modulus
            case Overflow.SATURATE:
                raw = min(max(raw, self.low), self.high)
            case _ if not self.low <= raw <= self.high:
                least, most = self.low * self.lsb, self.high * self.lsb
                shown = f"{value:.12g}" if isinstance(value, float) else value
                what = f"{shown} is not within {least:.12g} to {most:.12g}"
                raise EncodeError(what, field=self.path)
        return raw & (1 << self.bits) - 1

    def _rounded(self, value: object) -> int:
        if isinstance(self.lsb, int):
            if not isinstance(value, int):
                raise EncodeError(f"{value!r} is not an integer", field=self.path)
            quotient, rest = divmod(value, self.lsb)
            return quotient + (2 * rest + (quotient & 1) > self.lsb)
        if not isinstance(value, int | float):
            raise EncodeError(f"{value!r} is not a number", field=self.path)
        try:
            scaled = value / self.lsb
        except OverflowError:
            scaled = math.inf
        if not math.isfinite(scaled):
            raise EncodeError(f"{value} is not a finite number", field=self.path)
        return round(scaled)

    def _characters(self, part: Characters, value: object) -> int:
        if not isinstance(value, str) or len(value) != part.count:
            raise EncodeError(f"{value!r} is not a text of {part.count}", field=self.path)
        bits = 0
        for character in value:
            place = part.alphabet.find(character)
            if place < 0:
                raise EncodeError(f"{value!r} has {character!r}, which it cannot", field=self.path)
            bits = bits << part.bits_each | place
        return bits


def compiled(
    octets: int, templates: Sequence[int], rules: Sequence[ScalingRule]
) -> tuple[Few, list[Constants]]:
    """A function of constants and values, by row and by column, and the constants of templates."""
    words = whole(octets, rules)
    packer = struct.Struct(">" + "".join(CODES[word.size] for word in words))
    names = {
        "pack": packer.pack,
        "rounded": float.__round__,  # half to even, in less than half the time of round()
        "blame": _blame(rules),
        "faults": (TypeError, ValueError, OverflowError, struct.error),
    }
    names |= {f"text{column}": rule.integer for column, rule in enumerate(rules) if rule.text}
    stamped = [word for word in words if not word.pieces or any(map(word.of, templates))]
    # The text holds numbers and our own variable names only: nothing of the caller's gets in;
    # dataclasses do the same.
    exec(_source(rules, words, stamped), names)  # noqa: S102  # nosec B102
    constants = [tuple(word.of(template) for word in stamped) for template in templates]
    return cast(Few, names["few"]), constants


def _blame(rules: Sequence[ScalingRule]) -> Callable[..., NoReturn]:
    """A function that raises the EncodeError of the first value which the rules refuse."""

    def blame(*values: object) -> NoReturn:
        for rule, value in zip(rules, values, strict=True):
            rule.integer(value)
        raise EncodeError(f"{values} cannot be encoded", field=rules[0].path)

    return blame


def _source(rules: Sequence[ScalingRule], words: Sequence[Word], stamped: Sequence[Word]) -> str:
    values = "".join(f"v{column}, " for column in range(len(rules)))
    constants = "".join(f"c{word.offset}, " for word in stamped)
    packed = f"pack({', '.join(_word(word, word in stamped) for word in words)})"
    steps = [line for column, rule in enumerate(rules) for line in _integer(column, rule)]
    return "\n".join(
        [
            "def few(constants, columns):",
            *_indented(1, "records = []", "add = records.append"),
            f"    for ({constants}), {values} in zip(constants, *columns):",
            *_indented(2, "try:", *_indented(1, *steps, f"add({packed})")),
            *_indented(2, "except faults:", f"    blame({values})"),
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


def _word(word: Word, is_stamped: bool) -> str:
    terms = [f"c{word.offset}"] if is_stamped else []
    return " | ".join(terms + [_piece(piece) for piece in word.pieces])


def _piece(piece: Piece) -> str:
    text = f"r{piece.column}"
    if piece.shift:
        text += f" << {piece.shift}" if piece.shift > 0 else f" >> {-piece.shift}"
    return f"({text}) & {piece.mask}" if piece.mask else f"({text})"

"""Values to the integers that are sent: the rule of one column, one value at a time.

It is the reference for both fast paths of the encoder, makes their constants, and finds which
value they stumbled over.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from plotfeed.proto.asterix.codec.layout import Characters, Overflow, Quantity, Raw
from plotfeed.proto.asterix.codec.profile import Slot
from plotfeed.proto.errors import EncodeError


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
                raise EncodeError(f"{value} is not within {least} to {most}", field=self.path)
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

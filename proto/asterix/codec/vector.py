"""Many records at once: NumPy arrays of big-endian words, column by column.

What all columns of floats have in common is done to all of them in one call: for the hundred
records of a tick, calls cost more than what they do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plotfeed.proto.asterix.codec.layout import Overflow
from plotfeed.proto.asterix.codec.machine_words import Word, cells
from plotfeed.proto.asterix.codec.scalar import ScalingRule
from plotfeed.proto.errors import EncodeError

Integers = NDArray[np.int64]

INT64_SAFE = 2.0**62
FEWEST_TOGETHER = 3
"""Columns of floats from which on it pays to put them into one array."""


class VectorEncoder:
    """Encodes columns of numbers; its octets are those of the scalar path."""

    def __init__(self, octets: int, templates: Sequence[int], rules: Sequence[ScalingRule]) -> None:
        """A template is a record as an integer, in which all values are 0."""
        self._rules = tuple(rules)
        self._together = _FloatColumns.of(rules)
        words = cells(octets, rules)
        self._words = [(word, _name(word), any(map(word.of, templates))) for word in words]
        rows = b"".join(template.to_bytes(octets, "big") for template in templates)
        self._templates = np.frombuffer(rows, dtype=f"V{octets}")
        self._dtype = np.dtype(
            {
                "names": [_name(word) for word in words],
                "formats": [f">u{word.size}" for word in words],
                "offsets": [word.offset for word in words],
                "itemsize": octets,
            }
        )

    def records(
        self, columns: Sequence[ArrayLike], n: int, which: NDArray[np.int64] | None = None
    ) -> bytes:
        """The octets of n records, one after the other; a column is (n,) or one number for all.

        `which` are the templates of the records, (n,); without it, it is the first.
        """
        integers = self._integers(columns)
        templates = self._templates
        records = np.repeat(templates[:1], n) if which is None else templates[which]
        view = records.view(self._dtype)
        for word, name, has_constant in self._words:
            bits = _word(word, integers)
            view[name] = bits | view[name] if has_constant else bits
        return records.tobytes()

    def _integers(self, columns: Sequence[ArrayLike]) -> Sequence[NDArray[np.uint64]]:
        """The integers of columns, in two's complement; (n,) each."""
        together = self._together
        floats = (
            None if together is None else together.integers([columns[i] for i in together.which])
        )
        if together is None or floats is None:
            return [_integers(rule, c) for rule, c in zip(self._rules, columns, strict=True)]
        found = dict(zip(together.which, floats, strict=True))
        return [
            found[i] if i in found else _integers(rule, columns[i])
            for i, rule in enumerate(self._rules)
        ]


@dataclass(frozen=True, slots=True)
class _FloatColumns:
    """Columns of floats as one array, (k, n): what is done to each is done to all in one call.

    `which` are their places among all columns, the others are (k, 1).
    """

    which: tuple[int, ...]
    lsb: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    """What saturates is kept within these."""
    refused: bool
    least: NDArray[np.float64]
    most: NDArray[np.float64]
    """What is beyond these is refused."""
    mask: NDArray[np.int64]

    @classmethod
    def of(cls, rules: Sequence[ScalingRule]) -> _FloatColumns | None:
        """The columns of floats that those of powers of two wrap, if that is several of them."""
        which = [i for i, rule in enumerate(rules) if _goes_together(rule)]
        if len(which) < FEWEST_TOGETHER:
            return None
        chosen = [rules[i] for i in which]

        def limits(overflow: Overflow) -> list[NDArray[np.float64]]:
            bounded = [rule.overflow is overflow for rule in chosen]
            pairs = [
                (rule.low, rule.high) if is_bounded else (-np.inf, np.inf)
                for rule, is_bounded in zip(chosen, bounded, strict=True)
            ]
            return [np.array(limit, np.float64)[:, None] for limit in zip(*pairs, strict=True)]

        low, high = limits(Overflow.SATURATE)
        least, most = limits(Overflow.REFUSE)
        return cls(
            which=tuple(which),
            lsb=np.array([rule.lsb for rule in chosen], np.float64)[:, None],
            low=low,
            high=high,
            refused=any(rule.overflow is Overflow.REFUSE for rule in chosen),
            least=least,
            most=most,
            mask=np.array([(1 << rule.bits) - 1 for rule in chosen], np.int64)[:, None],
        )

    def integers(self, columns: Sequence[ArrayLike]) -> NDArray[np.uint64] | None:
        """Integers of the columns, (k, n); None where one has to be looked at by itself."""
        if any(type(c) is not np.ndarray or c.dtype != np.float64 for c in columns):
            return None
        values = np.array(columns)
        if values.ndim != 2:
            return None
        with np.errstate(over="ignore"):
            values /= self.lsb
        if not np.abs(values).max(initial=0.0) < INT64_SAFE:  # or it is no number
            return None
        np.rint(values, out=values)
        if self.refused and ((values < self.least) | (values > self.most)).any():
            return None
        np.maximum(values, self.low, out=values)
        np.minimum(values, self.high, out=values)
        whole = values.astype(np.int64)
        whole &= self.mask
        return whole.view(np.uint64)


def _goes_together(rule: ScalingRule) -> bool:
    wraps = rule.overflow is Overflow.WRAP
    return not isinstance(rule.lsb, int) and not (wraps and rule.modulus != 1 << rule.bits)


def _name(word: Word) -> str:
    return f"octet{word.offset}"


def _integers(rule: ScalingRule, column: ArrayLike) -> NDArray[np.uint64]:
    """The integers of a column, in two's complement; (n,) to (n,)."""
    raw = _rounded(rule, column)
    match rule.overflow:
        case Overflow.WRAP:
            raw = _wrapped(raw, rule.modulus)
        case Overflow.SATURATE:
            raw = np.clip(raw, rule.low, rule.high)
        case Overflow.REFUSE:
            inside = (raw >= rule.low) & (raw <= rule.high)
            if not inside.all():
                rule.integer(np.asarray(column)[~inside].flat[0].item())
    whole: Integers = np.asarray(raw, dtype=np.int64)
    if rule.low < 0:
        whole = whole & ((1 << rule.bits) - 1)
    return whole.view(np.uint64)


def _wrapped(raw: NDArray[Any], modulus: int) -> NDArray[Any]:
    """Whole numbers modulo another, without the remainder of floats where integers will do."""
    if raw.dtype.kind == "f" and np.abs(raw).max(initial=0) >= INT64_SAFE:
        remainder: NDArray[np.float64] = np.mod(raw, modulus)
        return remainder
    whole: Integers = raw.astype(np.int64, copy=False)
    power_of_two = not modulus & modulus - 1
    return whole & modulus - 1 if power_of_two else whole - whole // modulus * modulus


def _rounded(rule: ScalingRule, column: ArrayLike) -> NDArray[Any]:
    """A column in LSBs: floats that are whole numbers, because they may exceed any integer."""
    if not isinstance(rule.lsb, int):
        values = _array(rule, column, "fiub", np.float64)
        with np.errstate(over="ignore"):
            scaled = values / rule.lsb
        finite = np.isfinite(scaled)
        if not finite.all():
            rule.integer(values[~finite].flat[0].item())
        return np.rint(scaled)
    values = _array(rule, column, "iub", np.int64)
    if rule.lsb == 1:
        return values
    quotient: Integers = values // rule.lsb
    up: NDArray[np.bool_] = 2 * (values - quotient * rule.lsb) + (quotient & 1) > rule.lsb
    return quotient + up


def _array(
    rule: ScalingRule, column: ArrayLike, kinds: str, dtype: type[np.generic]
) -> NDArray[Any]:
    try:
        values = np.asarray(column)
    except ValueError:
        values = np.empty((0, 0))
    if values.ndim > 1 or values.dtype.kind not in kinds:
        wanted = "numbers" if "f" in kinds else "integers"
        raise EncodeError(f"a column of {wanted} is one-dimensional", field=rule.path)
    return values.astype(dtype, copy=False)


def _word(word: Word, integers: Sequence[NDArray[np.uint64]]) -> NDArray[np.uint64]:
    bits: NDArray[np.uint64] | None = None
    for piece in word.pieces:
        part = integers[piece.column]
        if piece.shift > 0:
            part = part << np.uint64(piece.shift)
        elif piece.shift < 0:
            part = part >> np.uint64(-piece.shift)
        if piece.mask:
            part = part & np.uint64(piece.mask)
        bits = part if bits is None else bits | part
    return np.zeros((), np.uint64) if bits is None else bits

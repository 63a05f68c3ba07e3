"""Values to octets, by two paths to the same octets, and records to data blocks.

An `Encoder` is for one profile: fixed items, fixed length.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.state import Floats, Ints
from plotfeed.proto.asterix.codec.layout import HEADER_OCTETS, Category
from plotfeed.proto.asterix.codec.profile import profile
from plotfeed.proto.asterix.codec.scalar import ScalingRule, compiled
from plotfeed.proto.asterix.codec.vector import VectorEncoder
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.units import with_rounding

CROSSOVER = 40
"""Records from which on the vector path is the faster one; tests/benchmarks/bench_asterix.py."""

UDP_OCTETS = 1400
"""A data block of this length goes into one datagram on any common link."""

MAX_OCTETS = 0xFFFF

Constant: TypeAlias = "float | str | Sequence[float] | Sequence[str]"
"""What a part is in all records, or in those of each source that records may be of."""


class StatedDeviations:
    """How standard deviations are stated of values that travel as multiples of an LSB.

    With what the value's own rounding adds, rounded up to their own LSB, of which there are at
    most so many: never as 0, which would say that the value is exact.
    """

    def __init__(self, columns: Sequence[tuple[int, ScalingRule, ScalingRule]]) -> None:
        """The place of each column of deviations, its own rule, and that of its value."""
        self._places = [place for place, _, _ in columns]

        def each_of(numbers: Iterable[float]) -> Floats:
            return np.array(list(numbers), np.float64)[:, None]

        self._value_lsb = each_of(value.lsb for _, _, value in columns)
        self._lsb = each_of(own.lsb for _, own, _ in columns)
        self._most = each_of(own.high for _, own, _ in columns)

    def put_in(self, values: list[Any]) -> None:
        """State those among the columns, (n,) each. What is NaN stays so."""
        sigmas = np.array([values[place] for place in self._places], np.float64)
        rounded = with_rounding(sigmas, self._value_lsb)
        steps = np.minimum(np.ceil(rounded / self._lsb), self._most)
        for place, stated in zip(self._places, steps * self._lsb, strict=True):
            values[place] = stated


class Encoder:
    """Encodes records of the items in `paths` (see profile()).

    `constants` holds the parts that never change, one value for all records or a sequence of one
    for each source that records may be of, whose numbers count from 0. All others are `columns`,
    in the order of the record. `lsb` gives the LSB in the column's unit where that is not the
    layout's: an int for a column of integers, such as nanoseconds, whose arithmetic is then exact.
    `deviations` names the columns that are standard deviations, each with the value whose it is,
    for all records or for none: they are stated as `StatedDeviations` says.

    A value is rounded half to even; outside the range it saturates, wraps or is refused as its
    quantity says. What is not a finite number is refused: EncodeError names its path.
    """

    def __init__(
        self,
        category: Category,
        paths: Iterable[str],
        *,
        constants: Mapping[str, Constant] | None = None,
        lsb: Mapping[str, float] | None = None,
        deviations: Mapping[str, str] | None = None,
    ) -> None:
        constants, lsb = constants or {}, lsb or {}
        drawn = profile(category, paths)
        if unknown := {*constants, *lsb} - {slot.path for slot in drawn.slots}:
            raise EncodeError("the profile has no such part", field=min(unknown))
        self.sources = sources_of(constants.values())
        """How many sources there are."""
        templates = [drawn.template] * self.sources
        rules: list[ScalingRule] = []
        for slot in drawn.slots:
            rule = ScalingRule.of(slot, lsb.get(slot.path))
            if slot.path not in constants:
                rules.append(rule)
                continue
            bits = [rule.integer(value) << slot.right for value in each(constants[slot.path])]
            bits = bits * self.sources if len(bits) == 1 else bits
            templates = [have | more for have, more in zip(templates, bits, strict=True)]
        self.category = category.number
        self.record_length = drawn.octets
        self.columns = tuple(rule.path for rule in rules)
        self._deviations = _stated(rules, deviations or {})
        self._few, self._constants = compiled(drawn.octets, templates, rules)
        self._many = None
        if not any(rule.text for rule in rules):  # no machine word holds text
            self._many = VectorEncoder(drawn.octets, templates, rules).records

    def record(self, *values: Any) -> bytes:
        """One record of the first source, of one value a column in the order of `columns`."""
        columns = [[value] for value in values]
        if self._deviations is not None:
            self._deviations.put_in(columns)
        return self._few(self._constants[:1], columns)

    def records(self, columns: Mapping[str, ArrayLike], sources: Ints | None = None) -> bytes:
        """The records of columns by path; each (n,), or one number or text for all records.

        `sources` are the numbers of the records' sources, (n,); there may be one alone.
        """
        try:
            values: list[Any] = [columns[path] for path in self.columns]
        except KeyError as error:
            raise EncodeError("a column is missing", field=error.args[0]) from None
        if str in map(type, values):  # a text for all records has a length, but not a column's
            values = [np.asarray(c, np.object_) if isinstance(c, str) else c for c in values]
        if self.sources == 1:
            sources = None
        elif sources is None:
            raise EncodeError(f"which of {self.sources} sources is not said", field="records")
        alike = values if sources is None else [*values, sources]
        try:
            lengths = set(map(len, alike))
        except TypeError:  # a number for all records has no length
            lengths = {len(column) for column in alike if not _is_one(column)} or {1}
            n = max(lengths)
            values = [np.broadcast_to(np.asarray(c), n) if _is_one(c) else c for c in values]
        if len(lengths) > 1:
            raise EncodeError(f"columns of different lengths, {sorted(lengths)}", field="records")
        if self._deviations is not None:
            self._deviations.put_in(values)
        n = lengths.pop() if lengths else 1
        if n >= CROSSOVER and self._many is not None:
            return self._many(values, n, sources)
        held = self._constants
        constants = held * n if sources is None else [held[i] for i in sources.tolist()]
        # Python's own numbers cost less than NumPy's one by one.
        values = [c.tolist() if isinstance(c, np.ndarray) else c for c in values]
        return self._few(constants, values)


def _stated(rules: Sequence[ScalingRule], deviations: Mapping[str, str]) -> StatedDeviations | None:
    """What states those deviations which are among the columns, if there are any."""
    by_path = {rule.path: rule for rule in rules}
    found = []
    for place, rule in enumerate(rules):
        if rule.path in deviations:
            value = by_path.get(deviations[rule.path])
            if value is None:
                raise EncodeError("a standard deviation of what is not sent", field=rule.path)
            found.append((place, rule, value))
    return StatedDeviations(found) if found else None


def each(constant: Constant) -> Sequence[float | str]:
    """The values of a constant: one for each source, or one alone."""
    return (constant,) if isinstance(constant, int | float | str) else constant


def sources_of(constants: Iterable[Constant]) -> int:
    """How many sources those constants are of."""
    lengths = {len(each(c)) for c in constants if not isinstance(c, int | float | str)} or {1}
    if len(lengths) > 1:
        raise EncodeError(f"constants of {sorted(lengths)} sources", field="constants")
    return lengths.pop()


def _is_one(column: Any) -> bool:
    """Whether it is one value for all records."""
    return not (column.ndim if isinstance(column, np.ndarray) else hasattr(column, "__len__"))


def blocks_of(
    category: int, records: bytes, record_length: int, max_octets: int = UDP_OCTETS
) -> list[bytes]:
    """Data blocks of whole records, in their order, each no longer than `max_octets`."""
    step = records_a_block(record_length, max_octets) * record_length
    return [
        header(category, len(body)) + body
        for start in range(0, len(records), step)
        for body in [records[start : start + step]]
    ]


def blocks_of_one(encoder: Encoder, records: bytes) -> list[bytes]:
    """A data block for each of an encoder's records, in their order."""
    length = encoder.record_length
    head = header(encoder.category, length)
    return [head + records[start : start + length] for start in range(0, len(records), length)]


def records_a_block(record_length: int, max_octets: int) -> int:
    """How many records of that length a data block holds; none is an `EncodeError`."""
    if not HEADER_OCTETS + record_length <= max_octets <= MAX_OCTETS:
        raise EncodeError(
            f"{max_octets} is not within {HEADER_OCTETS + record_length} to {MAX_OCTETS}",
            field="max_octets",
        )
    return (max_octets - HEADER_OCTETS) // record_length


def header(category: int, octets: int) -> bytes:
    """What comes before the records of a data block, which are so many octets."""
    return (category << 16 | HEADER_OCTETS + octets).to_bytes(HEADER_OCTETS, "big")

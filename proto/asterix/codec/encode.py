"""Values to octets, for one report profile: fixed items, fixed length, two paths, same octets."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.proto.asterix.codec.layout import HEADER_OCTETS, Category
from plotfeed.proto.asterix.codec.profile import profile
from plotfeed.proto.asterix.codec.scalar import compiled
from plotfeed.proto.asterix.codec.scaling import ScalingRule
from plotfeed.proto.asterix.codec.vector import VectorEncoder
from plotfeed.proto.errors import EncodeError

CROSSOVER = 80
"""Records from which on the vector path is the faster one; tests/benchmarks/bench_asterix.py."""

UDP_OCTETS = 1400
"""A data block of this length goes into one datagram on any common link."""

MAX_OCTETS = 0xFFFF


class Encoder:
    """Encodes records of the items in `paths` (see profile()).

    `constants` holds the parts that never change; all others are `columns`, in the order of the
    record. `lsb` gives the LSB in the column's unit where that is not the layout's: an int for a
    column of integers, such as nanoseconds, whose arithmetic is then exact.

    A value is rounded half to even; outside the range it saturates, wraps or is refused as its
    quantity says. What is not a finite number is refused: EncodeError names its path.
    """

    def __init__(
        self,
        category: Category,
        paths: Iterable[str],
        *,
        constants: Mapping[str, float | str] | None = None,
        lsb: Mapping[str, float] | None = None,
    ) -> None:
        constants, lsb = constants or {}, lsb or {}
        drawn = profile(category, paths)
        if unknown := {*constants, *lsb} - {slot.path for slot in drawn.slots}:
            raise EncodeError("the profile has no such part", field=min(unknown))
        template = drawn.template
        rules: list[ScalingRule] = []
        for slot in drawn.slots:
            if slot.path in constants:
                template |= ScalingRule.of(slot).integer(constants[slot.path]) << slot.right
            else:
                rules.append(ScalingRule.of(slot, lsb.get(slot.path)))
        self.category = category.number
        self.record_length = drawn.octets
        self.columns = tuple(rule.path for rule in rules)
        self.record, self._few = compiled(drawn.octets, template, rules)
        """record(*values) is one record of one number a column, in the order of `columns`."""
        self._many = None
        if not any(rule.text for rule in rules):  # no machine word holds text
            self._many = VectorEncoder(drawn.octets, template, rules).records

    def records(self, columns: Mapping[str, ArrayLike]) -> bytes:
        """The records of columns by path; each (n,), or one number or text for all records."""
        try:
            values: list[Any] = [columns[path] for path in self.columns]
        except KeyError as error:
            raise EncodeError("a column is missing", field=error.args[0]) from None
        if str in map(type, values):  # a text for all records has a length, but not a column's
            values = [np.asarray(c, np.object_) if isinstance(c, str) else c for c in values]
        try:
            lengths = set(map(len, values))
        except TypeError:  # a number for all records has no length
            lengths = {len(column) for column in values if not _is_one(column)} or {1}
            n = max(lengths)
            values = [np.broadcast_to(np.asarray(c), n) if _is_one(c) else c for c in values]
        if len(lengths) > 1:
            raise EncodeError(f"columns of different lengths, {sorted(lengths)}", field="records")
        n = lengths.pop() if lengths else 1
        if n >= CROSSOVER and self._many is not None:
            return self._many(values, n)
        # Python's own numbers cost less than NumPy's one by one.
        return self._few([c.tolist() if isinstance(c, np.ndarray) else c for c in values])


def _is_one(column: Any) -> bool:
    """Whether it is one value for all records."""
    return not (column.ndim if isinstance(column, np.ndarray) else hasattr(column, "__len__"))


def blocks_of(
    category: int, records: bytes, record_length: int, max_octets: int = UDP_OCTETS
) -> list[bytes]:
    """Data blocks of whole records, in their order, each no longer than `max_octets`."""
    if not HEADER_OCTETS + record_length <= max_octets <= MAX_OCTETS:
        raise EncodeError(
            f"{max_octets} is not within {HEADER_OCTETS + record_length} to {MAX_OCTETS}",
            field="max_octets",
        )
    step = (max_octets - HEADER_OCTETS) // record_length * record_length
    return [
        bytes([category]) + (HEADER_OCTETS + len(body)).to_bytes(2, "big") + body
        for start in range(0, len(records), step)
        for body in [records[start : start + step]]
    ]

"""Values to octets, by two paths to the same octets, and what report encoders share.

An `Encoder` is for one profile: fixed items, fixed length. `Reports` keep one for each choice of
items.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plotfeed.models.state import Floats
from plotfeed.proto.asterix.codec.layout import HEADER_OCTETS, Category
from plotfeed.proto.asterix.codec.profile import is_at, profile
from plotfeed.proto.asterix.codec.scalar import ScalingRule, compiled
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


class Reports:
    """Data blocks of the items in `always`, and of those in `optional` that have columns.

    `constants` and `lsb` are as for Encoder, and may name parts of items that are not sent.
    """

    def __init__(
        self,
        category: Category,
        always: Iterable[str],
        optional: Iterable[str] = (),
        *,
        constants: Mapping[str, float | str],
        lsb: Mapping[str, float] | None = None,
        max_octets: int = UDP_OCTETS,
        one_a_block: bool = False,
    ) -> None:
        self._category = category
        self._always = tuple(always)
        self._optional = tuple(optional)
        self._constants = constants
        self._lsb = lsb or {}
        self._max_octets = max_octets
        self._one_a_block = one_a_block
        self._encoders: dict[tuple[str, ...], Encoder] = {}
        everything = self._encoder_of(self._optional)
        blocks_of(category.number, b"", everything.record_length, max_octets)

    def blocks(self, columns: Mapping[str, ArrayLike]) -> list[bytes]:
        """Data blocks of the rows of columns by path, in their order."""
        key = tuple(columns)
        encoder = self._encoders.get(key)
        if encoder is None:
            chosen = [path for path in self._optional if any(_belongs(c, path) for c in columns)]
            encoder = self._encoders.setdefault(key, self._encoder_of(chosen))
        length = encoder.record_length
        most = HEADER_OCTETS + length if self._one_a_block else self._max_octets
        return blocks_of(self._category.number, encoder.records(columns), length, most)

    def _encoder_of(self, optional: Sequence[str]) -> Encoder:
        paths = (*self._always, *optional)

        def is_sent(path: str) -> bool:
            return any(_belongs(path, sent) for sent in paths)

        return Encoder(
            self._category,
            paths,
            constants={p: value for p, value in self._constants.items() if is_sent(p)},
            lsb={p: lsb for p, lsb in self._lsb.items() if is_sent(p)},
        )


def _belongs(slot: str, path: str) -> bool:
    """Whether a slot is of the item or subfield at a path."""
    return is_at(slot, path.partition("*")[0])


def measured(columns: Mapping[str, Floats | None]) -> dict[str, Floats]:
    """Columns that hold numbers; None and one of nothing but NaN are not measured.

    The encoder finds a NaN among numbers by itself.
    """
    return {
        path: column
        for path, column in columns.items()
        if column is not None and _is_measured(path, column)
    }


def _is_measured(path: str, column: Floats) -> bool:
    if not math.isnan(column[0]):
        return True
    if np.isnan(column).all():
        return False
    raise EncodeError("NaN in some rows and not in others", field=path)


def checked_position(latitude_deg: Any, longitude_deg: Any, *, field: str) -> None:
    """Refuses what is not on the globe, which quantities of more than a turn would carry."""
    for name, degrees, limit in (("LAT", latitude_deg, 90), ("LON", longitude_deg, 180)):
        inside = np.abs(np.asarray(degrees, dtype=np.float64)) <= limit
        if not inside.all():
            worst = np.asarray(degrees)[~inside].flat[0]
            raise EncodeError(f"{worst} is not within ±{limit} degrees", field=f"{field}/{name}")


def looked_up(values: Mapping[Any, Any], keys: NDArray[Any], what: str, path: str) -> NDArray[Any]:
    """The value of each key; `what` says what they are of where one has none."""
    try:
        found = [values[key] for key in keys.tolist()]
    except KeyError as error:
        raise EncodeError(f"no {what} {error}", field=path) from None
    return np.array(found, np.object_ if isinstance(found[0], str) else None)

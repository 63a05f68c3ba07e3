"""What the report encoders of categories share: data blocks of the items that are measured.

`Reports` keep an `Encoder` for each choice of items. Records may be of several sources, such as
sensors, and in several parts, such as sectors, whose blocks are cut apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Self

from plotfeed.proto.asterix.codec.encode import (
    UDP_OCTETS,
    Constant,
    Encoder,
    blocks_of,
    blocks_of_one,
    header,
    is_at,
    records_a_block,
)
from plotfeed.proto.asterix.codec.layout import HEADER_OCTETS, Category
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.lazy_numpy import np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from plotfeed.models.state import Columns, Floats, Ints


@dataclass(frozen=True, slots=True)
class Parts:
    """Rows in parts that go into data blocks of their own, and the source that each part is of."""

    by: Ints  # Part i is the rows from `by[i]` up to `by[i + 1]`; (m+1,)
    sources: Ints  # By their numbers, as constants of an encoder have them; (m,)

    @classmethod
    def whole(cls, rows: int) -> Self:
        """All rows in one part, of the one source."""
        return cls(np.array([0, rows], np.int64), np.zeros(1, np.int64))

    @classmethod
    def one_each(cls, sources: Ints) -> Self:
        """A row for each of these sources, (m,), in a part of its own."""
        return cls(np.arange(len(sources) + 1), sources)

    def __len__(self) -> int:
        """How many there are."""
        return len(self.sources)

    def edges(self) -> Iterator[tuple[int, int]]:
        """The first row of each part, and the one after its last."""
        return pairwise(self.by.tolist())

    def lengths(self) -> Ints:
        """How many rows each part has; (m,)."""
        return self.by[1:] - self.by[:-1]

    def of_rows(self) -> Ints:
        """The source of each row; (n,)."""
        return np.repeat(self.sources, self.lengths())

    def numbered_from(self, first: Ints) -> Ints:
        """Numbers of all rows, which count on from `first`, (m,), in each part; (n,)."""
        numbers: Ints = np.arange(self.by[-1]) + np.repeat(first - self.by[:-1], self.lengths())
        return numbers


class Reports:
    """Data blocks of the items in `always`, and of those in `optional` that have columns.

    `constants`, `lsb` and `deviations` are as for Encoder, and may name parts of items that are not
    sent; `max_octets` too may be one for each source.
    """

    def __init__(
        self,
        category: Category,
        always: Iterable[str],
        optional: Iterable[str] = (),
        *,
        constants: Mapping[str, Constant],
        lsb: Mapping[str, float] | None = None,
        deviations: Mapping[str, str] | None = None,
        max_octets: int | Sequence[int] = UDP_OCTETS,
        one_a_block: bool = False,
    ) -> None:
        self._category = category
        self._always = tuple(always)
        self._optional = tuple(optional)
        self._constants = constants
        self._lsb = lsb or {}
        self._deviations = deviations
        self._max_octets = [max_octets] if isinstance(max_octets, int) else list(max_octets)
        self._one_a_block = one_a_block
        self._encoders: dict[tuple[str, ...], Encoder] = {}
        everything = self._encoder_of(self._optional)
        records_a_block(everything.record_length, min(self._max_octets))
        records_a_block(everything.record_length, max(self._max_octets))

    def blocks(self, columns: Mapping[str, ArrayLike]) -> list[bytes]:
        """Data blocks of the rows of columns by path, in their order, all of the one source."""
        encoder = self._encoder_for(columns)
        records, length = encoder.records(columns), encoder.record_length
        return blocks_of(encoder.category, records, length, self._limit(0, length))

    def blocks_by(self, columns: Mapping[str, ArrayLike], parts: Parts) -> list[list[bytes]]:
        """Data blocks of each part of the rows of columns by path, in their order."""
        encoder = self._encoder_for(columns)
        records = encoder.records(columns, parts.of_rows() if encoder.sources > 1 else None)
        number, length = encoder.category, encoder.record_length
        if self._one_a_block:
            blocks = blocks_of_one(encoder, records)
            return [blocks[start:end] for start, end in parts.edges()]
        found: list[list[bytes]] = []
        for (first, after), source in zip(parts.edges(), parts.sources.tolist(), strict=True):
            of_part, limit = records[first * length : after * length], self._limit(source, length)
            if len(of_part) > limit - HEADER_OCTETS:
                found.append(blocks_of(number, of_part, length, limit))
            else:
                found.append([header(number, len(of_part)) + of_part] if of_part else [])
        return found

    def _limit(self, source: int, record_length: int) -> int:
        """What a data block of a source may hold, in octets."""
        if self._one_a_block:
            return HEADER_OCTETS + record_length
        most = self._max_octets
        return most[source] if len(most) > 1 else most[0]

    def _encoder_for(self, columns: Iterable[str]) -> Encoder:
        key = tuple(columns)
        encoder = self._encoders.get(key)
        if encoder is None:
            chosen = [path for path in self._optional if any(_belongs(c, path) for c in columns)]
            encoder = self._encoders.setdefault(key, self._encoder_of(chosen))
        return encoder

    def _encoder_of(self, optional: Sequence[str]) -> Encoder:
        paths = (*self._always, *optional)

        def is_sent(path: str) -> bool:
            return any(_belongs(path, sent) for sent in paths)

        return Encoder(
            self._category,
            paths,
            constants={p: value for p, value in self._constants.items() if is_sent(p)},
            lsb={p: lsb for p, lsb in self._lsb.items() if is_sent(p)},
            deviations=self._deviations,
        )


def _belongs(slot: str, path: str) -> bool:
    """Whether a slot is of the item or subfield at a path."""
    return is_at(slot, path.partition("*")[0])


def measured(columns: Columns, names: Mapping[str, str]) -> dict[str, Floats]:
    """Columns by path that hold numbers, of those by name; one of nothing but NaN is not measured.

    The encoder finds a NaN among numbers by itself.
    """
    held = vars(columns)
    return {
        path: column
        for path, name in names.items()
        if (column := held.get(name)) is not None and _is_measured(path, column)
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

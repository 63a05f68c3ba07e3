"""What report encoders share: a profile for each choice of items, and what they refuse alike."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plotfeed.models.state import Floats
from plotfeed.proto.asterix.codec.encode import UDP_OCTETS, Encoder, blocks_of
from plotfeed.proto.asterix.codec.layout import HEADER_OCTETS, Category
from plotfeed.proto.asterix.codec.profile import is_at
from plotfeed.proto.errors import EncodeError

Constants = Mapping[str, float | str]


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
        constants: Constants,
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


def measured(columns: Mapping[str, Floats]) -> dict[str, Floats]:
    """Columns that hold numbers; one of nothing but NaN is not measured.

    The encoder finds a NaN among numbers by itself.
    """
    return {path: column for path, column in columns.items() if _is_measured(path, column)}


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

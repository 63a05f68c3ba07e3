"""Values to octets, column by column: records of a fixed choice of items, and data blocks of them.

Every record of a profile has one length and one FSPEC. What its values are is worked out with NumPy
for all records at once, and put into a record of zeros as big-endian words.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Self, TypeAlias

from plotfeed.proto.asterix.codec.layout import (
    HEADER_OCTETS,
    Category,
    Characters,
    Compound,
    Extended,
    Fixed,
    Group,
    Item,
    Named,
    Overflow,
    Quantity,
    Repetitive,
)
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.lazy_numpy import np
from plotfeed.proto.units import TIME_LSB_NS, with_rounding

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from plotfeed.models.state import Columns, Floats, Ints


UDP_OCTETS = 1400  # A data block of this length goes into one datagram on any common link

MAX_OCTETS = 0xFFFF

# What a part is in all records, or in those of each source that records may be of.
Constant: TypeAlias = "float | str | Sequence[float] | Sequence[str] | Floats"

MAX_REPETITIONS = 255  # the octet that counts them holds no more
# Of a word that ends with the last octet of a part; as many precede a record while it is made.
WORD_OCTETS = 8


class Encoder:
    """Encodes records of the items in `paths` (see profile()).

    `constants` holds the parts that never change, one value for all records or a sequence of one
    for each source that records may be of, whose numbers count from 0. All others are `columns`,
    in the order of the record. `lsb` gives the LSB in the column's unit where that is not the
    layout's: an int for a column of integers, such as nanoseconds, whose arithmetic is then exact.
    `deviations` names the columns that are standard deviations, each with the value whose it is,
    for all records or for none: they are stated with the rounding of these, rounded up.

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
        slots = drawn.slots
        if unknown := {*constants, *lsb} - {slot.path for slot in slots}:
            raise EncodeError("the profile has no such part", field=min(unknown))
        self.category = category.number
        self.record_length = drawn.octets
        stamped = [slot for slot in slots if slot.path in constants]
        varying = [slot for slot in slots if slot.path not in constants]
        self.columns = tuple(slot.path for slot in varying)
        fixed = [_array(constants[slot.path], slot.path) for slot in stamped]
        # How many sources there are.
        self.sources = _rows(fixed, "constants of {} sources", "constants")
        octets = drawn.octets
        bare = drawn.template.to_bytes(WORD_OCTETS + octets, "big")
        self._templates = np.repeat(np.frombuffer(bare, f"V{len(bare)}"), self.sources)
        _Columns(octets, stamped, lsb).put_into(self._templates, fixed)
        self._columns = _Columns(octets, varying, lsb)
        whose = {path: of for path, of in (deviations or {}).items() if path in self.columns}
        self._deviations = _Deviations(self._columns, whose) if whose else None

    def records(self, columns: Mapping[str, ArrayLike], sources: Ints | None = None) -> bytes:
        """The records of columns by path; each (n,), or one number or text for all records.

        `sources` are the numbers of the records' sources, (n,); there may be one alone.
        """
        try:
            values = [_array(columns[path], path) for path in self.columns]
        except KeyError as error:
            raise EncodeError("a column is missing", field=error.args[0]) from None
        if self.sources == 1:
            sources = None
        elif sources is None:
            raise EncodeError(f"which of {self.sources} sources is not said", field="records")
        alike = values if sources is None else [*values, sources]
        n = _rows(alike, "columns of different lengths, {}", "records")
        if self._deviations is not None:
            self._deviations.state(values)
        templates = self._templates
        records = np.repeat(templates, n) if sources is None else templates[sources]
        return self._columns.put_into(records, values)


def _array(column: ArrayLike, path: str) -> NDArray[Any]:
    """A column as an array of one dimension, or of none where it is one value for all."""
    values = np.asarray(column)
    if values.ndim > 1:
        raise EncodeError("a column is one-dimensional", field=path)
    return values


def _rows(columns: Sequence[NDArray[Any]], wrong: str, name: str) -> int:
    """How long columns are, all of which are alike; 1 of nothing but single values."""
    lengths = {len(column) for column in columns if column.ndim} or {1}
    if len(lengths) > 1:
        raise EncodeError(wrong.format(sorted(lengths)), field=name)
    return lengths.pop()


class _Deviations:
    """Columns of standard deviations, of values that travel as multiples of an LSB.

    They are stated with what the value's own rounding adds, rounded up to their own LSB, of which
    there are at most so many: never as 0, which would say that the value is exact.
    """

    def __init__(self, columns: _Columns, whose: Mapping[str, str]) -> None:
        places = {slot.path: place for place, slot in enumerate(columns.slots)}
        for path, of in whose.items():
            if of not in places:
                raise EncodeError("a standard deviation of what is not sent", field=path)
        self._places = [places[path] for path in whose]
        lsb = np.array(columns.lsb, np.float64)[:, None]
        most = [[_rule(columns.slots[place].part)[2]] for place in self._places]
        self._most = np.array(most, np.float64)
        self._lsb = lsb[self._places]
        self._value_lsb = lsb[[places[of] for of in whose.values()]]

    def state(self, values: list[NDArray[Any]]) -> None:
        """State those among the columns, (n,) each. What is NaN stays so."""
        sigmas = np.array([values[place] for place in self._places], np.float64)
        rounded = with_rounding(sigmas, self._value_lsb)
        steps = np.minimum(np.ceil(rounded / self._lsb), self._most)
        for place, stated in zip(self._places, steps * self._lsb, strict=True):
            values[place] = stated


class _Columns:
    """Puts columns of values into records, in which their bits are 0."""

    def __init__(self, octets: int, slots: Sequence[Slot], lsb: Mapping[str, float]) -> None:
        self.slots = slots
        # In the column's unit; an int of a column of integers.
        self.lsb = [
            lsb.get(slot.path, float(slot.part.lsb) if isinstance(slot.part, Quantity) else 1)
            for slot in slots
        ]
        self._octets = octets
        kinds: dict[type, list[int]] = {float: [], int: [], str: []}
        for place, slot in enumerate(slots):
            is_text = isinstance(slot.part, Characters)
            kinds[str if is_text else type(self.lsb[place])].append(place)
        self._texts = kinds.pop(str)
        self._numbers = [
            (which, _Numbers([slots[i] for i in which], [self.lsb[i] for i in which], octets))
            for which in kinds.values()
            if which
        ]

    def put_into(self, records: NDArray[np.void], values: Sequence[NDArray[Any]]) -> bytes:
        """The octets of records, (n,), with those values, (n,) or () each."""
        for which, numbers in self._numbers:
            numbers.put_into(records, [values[place] for place in which])
        octets = records.view(np.uint8).reshape(len(records), records.itemsize)[:, WORD_OCTETS:]
        for place in self._texts:
            slot = self.slots[place]
            end = self._octets - slot.right // 8
            octets[:, end - slot.octets : end] |= _text(slot, values[place], len(records))
        return octets.tobytes()


class _Numbers:
    """Columns of numbers, all of floats or all of integers: all are worked out in one call.

    Each is ORed into a big-endian word that ends with its last octet; neighbours have 0 there.
    """

    def __init__(self, slots: Sequence[Slot], lsb: Sequence[float], octets: int) -> None:
        self._slots = slots
        self._is_whole = isinstance(lsb[0], int)
        self._lsb = self._each(lsb)
        self._counts_lsb = not self._is_whole or bool((self._lsb != 1).any())
        treated, low, high = zip(*(_rule(slot.part) for slot in slots), strict=True)
        self._low, self._high = self._each(low), self._each(high)
        self._wrapped = [(i, high[i] + 1) for i, how in enumerate(treated) if how is Overflow.WRAP]
        self._refused = np.array([[how is Overflow.REFUSE] for how in treated])
        self._mask = np.array([[(1 << slot.part.bits) - 1] for slot in slots], np.uint64)
        self._shift = np.array([[slot.right % 8] for slot in slots], np.uint64)
        if long := next((slot for slot in slots if slot.octets > WORD_OCTETS), None):
            raise EncodeError(f"{long.part.bits} bits are more than a word holds", field=long.path)
        self._words = np.dtype(
            {
                "names": [slot.path for slot in slots],
                "formats": ["u8"] * len(slots),
                "offsets": [octets - slot.right // 8 for slot in slots],
                "itemsize": WORD_OCTETS + octets,
            }
        )

    def _each(self, numbers: Sequence[float]) -> NDArray[Any]:
        """A number a column, (k, 1); of a great integer the next float towards 0."""
        if self._is_whole:
            return np.array(numbers, np.int64)[:, None]
        near = [(number, float(number)) for number in numbers]
        below = [f if abs(f) <= abs(number) else math.nextafter(f, 0) for number, f in near]
        return np.array(below, np.float64)[:, None]

    def put_into(self, records: NDArray[np.void], values: Sequence[NDArray[Any]]) -> None:
        """Put values, (n,) or () each, into records, (n,)."""
        table = np.empty((len(self._slots), len(records)), self._lsb.dtype)
        kinds, wanted = ("iub", "an integer") if self._is_whole else ("fiub", "a number")
        for slot, row, column in zip(self._slots, table, values, strict=True):
            if column.dtype.kind not in kinds and column.size:
                raise EncodeError(f"{column.flat[0]!r} is not {wanted}", field=slot.path)
            row[:] = column
        with np.errstate(over="ignore", invalid="ignore"):
            if not self._is_whole:
                np.rint(np.divide(table, self._lsb, out=table), out=table)
            elif self._counts_lsb:
                quotient = table // self._lsb
                table = quotient + (2 * (table - quotient * self._lsb) + (quotient & 1) > self._lsb)
            for row, modulus in self._wrapped:
                np.mod(table[row], modulus, out=table[row])
        kept = np.minimum(np.maximum(table, self._low), self._high)
        changed = kept != table
        if changed.any():
            self._check(changed & ~np.isfinite(table), values, "is not a finite number")
            self._check(changed & self._refused, values, "is not within {:.12g} to {:.12g}")
        bits = (kept.astype(np.int64).view(np.uint64) & self._mask) << self._shift
        words = records.view(self._words)
        for slot, integers in zip(self._slots, bits.astype(">u8").view("u8"), strict=True):
            word = words[slot.path]
            word |= integers

    def _check(self, bad: NDArray[np.bool_], values: Sequence[NDArray[Any]], what: str) -> None:
        if not bad.any():
            return
        place, row = np.argwhere(bad)[0]
        slot, step = self._slots[place], self._lsb[place, 0]
        value = np.broadcast_to(values[place], bad.shape[1])[row].item()
        shown = f"{value:.12g}" if isinstance(value, float) else value
        limits = (float(limit[place, 0] * step) for limit in (self._low, self._high))
        raise EncodeError(f"{shown} {what.format(*limits)}", field=slot.path)


def _rule(part: Named) -> tuple[Overflow, int, int]:
    """What becomes of an integer that is not within the two numbers."""
    if isinstance(part, Quantity) and part.overflow is Overflow.WRAP:
        return part.overflow, 0, (part.modulus or 1 << part.bits) - 1
    if isinstance(part, Quantity):
        return part.overflow, *part.limits
    return Overflow.REFUSE, 0, (1 << part.bits) - 1


def _text(slot: Slot, column: NDArray[Any], n: int) -> NDArray[np.uint8]:
    """The octets in which each of n texts has bits; (n, k)."""
    part, found = slot.part, []
    assert isinstance(part, Characters)  # noqa: S101 - for mypy  # nosec B101
    for value in np.broadcast_to(column, n).tolist():
        if not isinstance(value, str) or len(value) != part.count:
            raise EncodeError(f"{value!r} is not a text of {part.count}", field=slot.path)
        bits = 0
        for character in value:
            place = part.alphabet.find(character)
            if place < 0:
                raise EncodeError(f"{value!r} has {character!r}, which it cannot", field=slot.path)
            bits = bits << part.bits_each | place
        found.append((bits << slot.right % 8).to_bytes(slot.octets, "big"))
    return np.frombuffer(b"".join(found), np.uint8).reshape(n, slot.octets)


@dataclass(frozen=True, slots=True)
class Slot:
    """Where a named part lies: its path, and the bits of the record to its right."""

    path: str
    part: Named
    right: int

    @property
    def octets(self) -> int:
        """Number of octets in which the part has bits."""
        return -(-(self.right % 8 + self.part.bits) // 8)


def profile(category: Category, paths: Iterable[str]) -> Profile:
    """The profile with those items.

    A path is an item ("I048/040"), a subfield of a compound ("I048/130/PRL") or a part of an
    extended item, which takes the item up to and including that part's group ("I048/020/ME").
    What is repetitive is followed by how often: "I016/410*2" has the slots of "I016/410/0" and
    "I016/410/1".
    """
    drawn = Profile(dict(map(_split, paths)))
    drawn.slots_chosen(category.uap)
    if unknown := drawn.chosen.keys() - drawn.used:
        raise EncodeError(f"category {category.number} has no such item", field=min(unknown))
    return drawn


def _split(path: str) -> tuple[str, int | None]:
    """A path and how often what it names is repeated; None if it does not say."""
    name, star, times = path.partition("*")
    if not star:
        return path, None
    if not times.isdecimal() or not 0 <= int(times) <= MAX_REPETITIONS:
        raise EncodeError(f"repeated not 0 to {MAX_REPETITIONS} times", field=path)
    return name, int(times)


@dataclass(slots=True)
class Profile:
    """Records of `octets` octets, drawn from left to right; `template` has every slot zero."""

    chosen: Mapping[str, int | None]
    used: set[str] = field(default_factory=set)
    octets: int = 0
    template: int = 0  # A record as an integer
    # Path, part, and where the part ends, in bits from the start.
    drawn: list[tuple[str, Named, int]] = field(default_factory=list)

    @property
    def slots(self) -> tuple[Slot, ...]:
        """Where named parts lie, in the order of the record."""
        return tuple(Slot(path, part, self.octets * 8 - stop) for path, part, stop in self.drawn)

    def _append(self, octets: int, bits: int) -> None:
        self.octets += octets
        self.template = self.template << octets * 8 | bits

    def slots_chosen(self, slots: Sequence[Item | None], above: str = "") -> bool:
        """Octets of seven flags and FX, and the items that they announce; whether there are any.

        `above` comes before the names of the slots.
        """
        there = {
            place: (each, f"{above}{each.name}")
            for place, each in enumerate(slots)
            if each and any(is_at(path, f"{above}{each.name}") for path in self.chosen)
        }
        last = max(there, default=0) // 7
        for octet in range(last + 1):
            bits = sum(1 << 7 - place % 7 for place in there if place // 7 == octet)
            self._append(1, bits | (octet < last))
        for item, path in there.values():
            self.item(item, path)
        return bool(there)

    def group(self, prefix: str, group: Group, *, more: bool = False, named: bool = False) -> None:
        """A group; its only part needs no name unless `named`. `more` is its extension bit."""
        self._append(group.octets, int(more))
        end = self.octets * 8
        for part, right in group.fields:
            path = f"{prefix}/{part.name}" if named or len(group.fields) > 1 else prefix
            self.drawn.append((path, part, end - right))

    def item(self, item: Item, path: str) -> None:
        """An item, or a subfield, at its path."""
        self.used.add(path)
        match item:
            case Fixed(_, group):
                self.group(path, group)
            case Extended(_, groups):
                self._extended(path, groups)
            case Repetitive(_, group):
                self._repetitive(path, group)
            case Compound(_, subfields):
                if not self.slots_chosen(subfields, f"{path}/"):
                    asked = min(each for each in self.chosen if is_at(each, path))
                    raise EncodeError("name a subfield that it has", field=asked)
            case _:
                raise EncodeError("an item of no fixed length fits no profile", field=path)

    def _extended(self, path: str, groups: Sequence[Group]) -> None:
        asked = [
            self.chosen.keys() & {f"{path}/{part.name}" for part, _ in group.fields}
            for group in groups
        ]
        self.used.update(*asked)
        last = max((index for index, found in enumerate(asked) if found), default=0)
        for index, group in enumerate(groups[: last + 1]):
            self.group(path, group, more=index < last, named=True)

    def _repetitive(self, path: str, group: Group) -> None:
        times = self.chosen.get(path)
        if times is None or (group.fx and not times):
            raise EncodeError("say how often it is repeated, such as *1", field=path)
        if not group.fx:
            self._append(1, times)
        for index in range(times):
            self.group(f"{path}/{index}", group, more=group.fx and index < times - 1)


def is_at(path: str, name: str) -> bool:
    """Whether a path is that of `name` or of something in it."""
    return path == name or path.startswith(f"{name}/")


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


# What the report encoders of categories share: data blocks of the items that are measured.
#
# `Reports` keep an `Encoder` for each choice of items. Records may be of several sources, such as
# sensors, and in several parts, such as sectors, whose blocks are cut apart.


@dataclass(frozen=True, slots=True)
class Parts:
    """Rows in parts that go into data blocks of their own, and the source that each part is of."""

    by: Ints  # Part i is the rows from `by[i]` up to `by[i + 1]`; (m+1,)
    sources: Ints  # By their numbers, as constants of an encoder have them; (m,)

    @classmethod
    def whole(cls, rows: int) -> Self:
        """All rows in one part, of the one source."""
        return cls(np.array([0, rows], np.int64), np.zeros(1, np.int64))

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
    sent; `max_octets` too may be one for each source. Times of day are whole nanoseconds since
    1970. A category's own class makes columns of what sources measure, by `_columns`.
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
        self._time = category.time
        self._lsb = {self._time: TIME_LSB_NS, **(lsb or {})}
        self._deviations = deviations
        self._max_octets = [max_octets] if isinstance(max_octets, int) else list(max_octets)
        self._one_a_block = one_a_block
        self._encoders: dict[tuple[str, ...], Encoder] = {}
        everything = self._encoder_of(self._optional)
        records_a_block(everything.record_length, min(self._max_octets))
        records_a_block(everything.record_length, max(self._max_octets))

    def _columns(self, *told: Any) -> Mapping[str, ArrayLike]:
        """Columns by path of rows, at least one, of the parts that they are in, and of the rest.

        Without a class of their own, rows are columns by path already.
        """
        columns: Mapping[str, ArrayLike] = told[0]
        return columns

    def blocks(self, rows: Columns, *more: Any) -> list[bytes]:
        """Data blocks of all rows of one source, in their order, none longer than `max_octets`.

        `more` is as for `blocks_by`, of one part.
        """
        return self.blocks_by(rows, Parts.whole(len(rows)), *more)[0]

    def one_each(
        self, t_utc_ns: ArrayLike, sources: Ints, further: Mapping[str, ArrayLike] | None = None
    ) -> list[bytes]:
        """A data block for each time, (m,), of sources by their numbers, (m,).

        `further` columns are by path, (m,) each.
        """
        columns = {self._time: t_utc_ns, **(further or {})}
        encoder = self._encoder_for(columns)
        records, length = encoder.records(columns, sources), encoder.record_length
        head = header(encoder.category, length)
        return [head + records[at : at + length] for at in range(0, len(records), length)]

    def blocks_by(
        self, rows: Columns | Mapping[str, ArrayLike], parts: Parts, *more: Any
    ) -> list[list[bytes]]:
        """Data blocks of each part of the rows, all of which measure the same, in their order.

        A column of nothing but NaN, or of no kinds, is not measured; one with some is an
        EncodeError. What `more` there is to say, the class says.
        """
        if not len(rows):
            return [[] for _ in parts.sources]
        columns = self._columns(rows, parts, *more)
        encoder = self._encoder_for(columns)
        records = encoder.records(columns, parts.of_rows() if encoder.sources > 1 else None)
        number, length = encoder.category, encoder.record_length
        most = [HEADER_OCTETS + length] if self._one_a_block else self._max_octets
        found: list[list[bytes]] = [[] for _ in parts.sources]
        filled = np.flatnonzero(parts.lengths())
        of_filled = zip(
            filled.tolist(),
            (parts.by[filled] * length).tolist(),
            (parts.by[filled + 1] * length).tolist(),
            parts.sources[filled].tolist(),
            strict=True,
        )
        for part, first, after, source in of_filled:
            of_part, limit = records[first:after], most[source if len(most) > 1 else 0]
            if len(of_part) > limit - HEADER_OCTETS:
                found[part] = blocks_of(number, of_part, length, limit)
            else:
                found[part] = [header(number, len(of_part)) + of_part]
        return found

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
    held, found = vars(columns), {}
    for path, name in names.items():
        if (column := held.get(name)) is not None:
            if not math.isnan(column[0]):
                found[path] = column
            elif not np.isnan(column).all():
                raise EncodeError("NaN in some rows and not in others", field=path)
    return found


def checked_places(place: ArrayLike, *, field: str) -> tuple[Floats, Floats, Floats]:
    """Latitudes and longitudes, degrees, and heights, metres, of places, (3,) or (n, 3); (n,) each.

    Refuses those that are not on the globe.
    """
    latitude_deg, longitude_deg, height_m = np.atleast_2d(np.asarray(place, np.float64)).T
    checked_position(latitude_deg, longitude_deg, field=field)
    return latitude_deg, longitude_deg, height_m


def checked_position(latitude_deg: Any, longitude_deg: Any, *, field: str) -> None:
    """Refuses what is not on the globe, which quantities of more than a turn would carry."""
    for name, degrees, limit in (("LAT", latitude_deg, 90), ("LON", longitude_deg, 180)):
        inside = np.abs(np.asarray(degrees, dtype=np.float64)) <= limit
        if not inside.all():
            worst = np.asarray(degrees)[~inside].flat[0]
            raise EncodeError(f"{worst} is not within ±{limit} degrees", field=f"{field}/{name}")

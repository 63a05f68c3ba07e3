"""Serialised Ledgers of many sectors at once, from structures of arrays.

Messages of protobuf may be put together by joining their octets, and so these are: the octets are
those that protobuf itself would make, fields in the order of their numbers, no defaults.
Submessages are rows, of whatever lengths, and each field of all of them a column: all rows are
filled in at their widest, with a mask of what each of them has.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import accumulate, pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.state import FALSE_ALARM, OTHER, Bools, Floats, Ints, Looks, Plots
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.units import decibels
from plotfeed.proto.varint import varint, varint_octets

VARINT, DOUBLE, LENGTH = 0, 1, 2  # Wire types
Octets = NDArray[np.uint8]

_SHIFTS = np.arange(0, 70, 7, dtype=np.uint64)
# From each of them on, a number takes an octet more.
_THRESHOLDS = (1 << _SHIFTS[1:]).astype(np.uint64)
_PLACES = np.arange(10)


class Field(Protocol):
    """A field of all rows."""

    @property
    def width(self) -> int:
        """Octets that it takes at most."""

    @property
    def lengths(self) -> Ints | int:
        """Octets that it takes in each row, (n,), or in all of them."""

    def fill(self, octets: Octets, mask: Bools) -> None:
        """Write its octets, (n, width), and which of them a row has, where these are not all."""


def tag(field: int, wire_type: int) -> bytes:
    """What stands before a field, which is told by its number as everywhere here."""
    return varint(field << 3 | wire_type)


def text_field(field: int, text: str) -> bytes:
    """A field of text; nothing if it is empty, which is the default."""
    octets = text.encode()
    return tag(field, LENGTH) + varint(len(octets)) + octets if octets else b""


class Doubles:
    """A field of 64-bit floats; where `held` is not given, zero is a default and is left out."""

    def __init__(self, field: int, values: Floats, held: Bools | None = None) -> None:
        self._tag = np.frombuffer(tag(field, DOUBLE), np.uint8)
        self._bits = np.ascontiguousarray(values, "<f8").view(np.int64)
        self.width = len(self._tag) + 8
        found: Bools = self._bits != 0 if held is None else held
        self._held = None if found.all() else found
        self.lengths = self.width if self._held is None else self.width * self._held

    def fill(self, octets: Octets, mask: Bools) -> None:
        """Write them, and which rows have one."""
        octets[:, : len(self._tag)] = self._tag
        octets[:, len(self._tag) :] = self._bits.view(np.uint8).reshape(-1, 8)
        if self._held is not None:
            mask &= self._held[:, None]


class Integers:
    """A field of integers or booleans; zero is a default and is left out, but not of lengths."""

    def __init__(self, field: int, values: NDArray[Any], wire_type: int = VARINT) -> None:
        self._tag = np.frombuffer(tag(field, wire_type), np.uint8)
        self._numbers = values.astype(np.uint64)  # a negative one in two's complement
        least, most = int(self._numbers.min()), int(self._numbers.max())
        shortest, longest = varint_octets(least), varint_octets(most)
        self._held = None if least or wire_type == LENGTH else self._numbers != 0
        self.width = len(self._tag) + longest if most or self._held is None else 0
        self._own: Ints | int = longest
        if shortest < longest:
            self._own = 1 + np.searchsorted(_THRESHOLDS, self._numbers, side="right")
        lengths = len(self._tag) + self._own
        self.lengths = lengths if self._held is None else lengths * self._held

    def fill(self, octets: Octets, mask: Bools) -> None:
        """Write seven bits an octet, the lowest first; the highest bit says that more follow."""
        if not self.width:
            return
        head = len(self._tag)
        octets[:, :head] = self._tag
        own, places = self._own, _PLACES[: self.width - head]
        if len(places) > 1:
            octets[:, head:] = self._numbers[:, None] >> _SHIFTS[: len(places)] & np.uint64(0x7F)
        else:
            octets[:, head] = self._numbers
        if isinstance(own, int):
            octets[:, head:-1] |= 0x80
        else:
            octets[:, head:] |= (places < own[:, None] - 1) * np.uint8(0x80)
            mask[:, head:] = places < own[:, None]
        if self._held is not None:
            mask &= self._held[:, None]


class Constant:
    """A field that is the same in every row, its octets given as they are."""

    def __init__(self, octets: bytes) -> None:
        self._octets = np.frombuffer(octets, np.uint8)
        self.width = self.lengths = len(octets)

    def fill(self, octets: Octets, _mask: Bools) -> None:
        """Write them."""
        octets[:] = self._octets


class TextTable:
    """Fields of octets by number, such as names of drones, which may become more."""

    def __init__(self, entries: Sequence[bytes] = ()) -> None:
        self._lengths = np.zeros(0, np.int64)
        self._octets = np.zeros((0, 0), np.uint8)
        self.extend(entries)

    def __len__(self) -> int:
        return len(self._lengths)

    def extend(self, entries: Sequence[bytes]) -> None:
        """Add others, by the next numbers."""
        if not entries:
            return
        self._lengths = np.concatenate([self._lengths, [len(each) for each in entries]])
        width = max(int(self._lengths.max()), self._octets.shape[1])
        rows = np.frombuffer(b"".join(each.ljust(width, b"\0") for each in entries), np.uint8)
        before = np.pad(self._octets, ((0, 0), (0, width - self._octets.shape[1])))
        self._octets = np.concatenate([before, rows.reshape(len(entries), width)])

    def put(self, numbers: Sequence[int], entries: Sequence[bytes]) -> None:
        """Have others in the place of those numbers."""
        width = max(map(len, entries), default=0)
        more = max(0, width - self._octets.shape[1])
        self._octets = np.pad(self._octets, ((0, 0), (0, more)))
        for number, entry in zip(numbers, entries, strict=True):
            self._octets[number, : len(entry)] = np.frombuffer(entry, np.uint8)
            self._lengths[number] = len(entry)

    def cut(self, length: int) -> None:
        """Have no more than so many."""
        self._lengths, self._octets = self._lengths[:length].copy(), self._octets[:length].copy()

    def of(self, numbers: Ints) -> Field:
        """The fields of those numbers, in that order."""
        return _FromTable(self._octets[numbers], self._lengths[numbers])


class _FromTable:
    def __init__(self, octets: Octets, lengths: Ints) -> None:
        self._octets, self.lengths = octets, lengths
        self.width = int(lengths.max(initial=0))

    def fill(self, octets: Octets, mask: Bools) -> None:
        octets[:] = self._octets[:, : self.width]
        mask[:] = np.arange(self.width) < self.lengths[:, None]


def submessages(field: int, rows: int, fields: Sequence[Field]) -> tuple[bytes, Ints]:
    """Rows of those fields, at least one, as that repeated field.

    With where each row begins and ends, (n+1,).
    """
    lengths = np.zeros(rows, np.int64)
    for each in fields:
        lengths += each.lengths
    before = Integers(field, lengths, LENGTH)
    widths = [before.width, *(each.width for each in fields)]
    octets = np.empty((rows, sum(widths)), np.uint8)
    mask = np.ones(octets.shape, np.bool_)
    place = 0
    for each, width in zip((before, *fields), widths, strict=True):
        each.fill(octets[:, place : place + width], mask[:, place : place + width])
        place += width
    ends = np.zeros(rows + 1, np.int64)
    np.cumsum(lengths + before.lengths, out=ends[1:])
    return octets[mask].tobytes(), ends


_LEDGER, _LOOK, _PLOT, _SENT = (
    {field.name: field.number for field in message.DESCRIPTOR.fields}
    for message in (pb.Ledger, pb.Look, pb.PlotTruth, pb.Sent)
)
_SCAN, _SECTOR = (tag(_LEDGER[name], VARINT) for name in ("scan", "sector"))
_LOOKS, _PLOTS, _MESSAGES = (tag(_LEDGER[name], LENGTH) for name in ("looks", "plots", "messages"))
MANY = 16  # Rows from which on it is faster to fill in octets than objects of protobuf
_DELIVERED = pb.Sent(delivered=True, fate=pb.SENT).SerializeToString()


class LedgerOctets:
    """What sectors say of looks, plots and messages, made for many at a time."""

    def __init__(self) -> None:
        self._names: Sequence[str] = ()
        # The names that are in the tables: `self._names` may have grown since.
        self._tabled: list[str] = []
        self._looked_at = TextTable()
        self._caused_by = TextTable([b""])  # the first one is of false alarms
        self._others_looked_at = TextTable()
        self._others_caused_by = TextTable([b""])
        self._has_others = False
        self._are_others = np.zeros(0, np.bool_)  # By the row of a drone
        self._topics = TextTable()
        self._topic_numbers: dict[str, int] = {}

    def truths(
        self, looks: Looks, looks_by: Ints, plots: Plots, plots_by: Ints, *, names: Sequence[str]
    ) -> list[bytes]:
        """The looks and plots of sectors, (m,), as fields of their Ledgers; drones by `names`.

        Where other drones have the names of some, that is another list; one may grow as it is.
        Those of sector i are the rows from `looks_by[i]` up to `looks_by[i + 1]`, (m+1,), and so
        are plots.
        """
        self._name_drones(names)
        looked, told = self._looks(looks), self._plots(plots)
        of_looks = _parts(*looked, looks_by) if looked else None
        of_plots = _parts(*told, plots_by) if told else None
        if of_looks is None or of_plots is None:
            return of_looks or of_plots or [b""] * (len(looks_by) - 1)
        return [one + other for one, other in zip(of_looks, of_plots, strict=True)]

    def sent(
        self,
        topics: Sequence[str],
        due_utc_ns: Ints,
        sent_utc_ns: Ints,
        octets: Ints,
        numbers: Ints,
    ) -> tuple[bytes, Ints]:
        """Messages that left when they were due, at least one, (n,), as fields of their Ledgers.

        With where each of them begins and ends, (n+1,).
        """
        known = self._topic_numbers
        new = [topic for topic in dict.fromkeys(topics) if topic not in known]
        known.update(zip(new, range(len(known), len(known) + len(new)), strict=True))
        self._topics.extend([text_field(_SENT["topic"], topic) for topic in new])
        return submessages(
            _LEDGER["messages"],
            len(topics),
            [
                self._topics.of(np.array([known[topic] for topic in topics], np.int64)),
                Integers(_SENT["due_utc_ns"], due_utc_ns),
                Integers(_SENT["sent_utc_ns"], sent_utc_ns),
                Integers(_SENT["octets"], octets),
                Constant(_DELIVERED),
                Integers(_SENT["link_due_utc_ns"], due_utc_ns),
                Integers(_SENT["number"], numbers),
            ],
        )

    def _name_drones(self, names: Sequence[str]) -> None:
        tabled, anew = self._tabled, names is not self._names
        if anew:
            self._names = names
            if len(names) < len(tabled):
                del tabled[len(names) :]
                for table, first in self._tables():
                    table.cut(len(names) + first)
            others = [i for i, (a, b) in enumerate(zip(tabled, names, strict=False)) if a != b]
            if others:
                fields = _fields([names[i] for i in others])
                for (table, first), found in zip(self._tables(), fields, strict=True):
                    table.put([i + first for i in others], found)
                for i in others:
                    tabled[i] = names[i]
        if len(names) > len(tabled):
            new = names[len(tabled) :]
            for (table, _), found in zip(self._tables(), _fields(new), strict=True):
                table.extend(found)
            tabled.extend(new)
            anew = True
        if anew:
            self._are_others = np.array([OTHER in name for name in tabled], np.bool_)
            self._has_others = bool(self._are_others.any())

    def _tables(self) -> Sequence[tuple[TextTable, int]]:
        """Tables by the row of a drone, and the row in each at which the first one stands."""
        return (
            (self._looked_at, 0),
            (self._caused_by, 1),
            (self._others_looked_at, 0),
            (self._others_caused_by, 1),
        )

    def _looks(self, looks: Looks) -> tuple[bytes, Ints] | None:
        if len(looks) < MANY:
            return _joined(_LOOKS, self._few_looks(looks)) if len(looks) else None
        columns: list[Field] = [
            self._looked_at.of(looks.drone),
            Integers(_LOOK["time_utc_ns"], looks.t_utc_ns),
            Doubles(_LOOK["range_m"], looks.range_m),
            Doubles(_LOOK["azimuth_deg"], looks.azimuth_deg),
            Doubles(_LOOK["elevation_deg"], looks.elevation_deg),
            Doubles(_LOOK["snr_db"], decibels(looks.snr)),
            Doubles(_LOOK["pd"], looks.pd),
            Integers(_LOOK["detected"], looks.detected),
            Integers(_LOOK["channel"], looks.channel),
        ]
        if looks.emitted_utc_ns is not None:
            columns.append(Integers(_LOOK["emitted_utc_ns"], looks.emitted_utc_ns))
        if self._has_others:
            columns.append(self._others_looked_at.of(looks.drone))
        return submessages(_LEDGER["looks"], len(looks), columns)

    def _few_looks(self, looks: Looks) -> Iterator[pb.Look]:
        names = (
            "channel", "t_utc_ns", "range_m", "azimuth_deg", "elevation_deg", "pd", "detected"
        )  # fmt: skip
        columns = [getattr(looks, name).tolist() for name in names]
        columns += [decibels(looks.snr).tolist(), looks.drone.tolist()]
        emitted = looks.emitted_utc_ns
        columns.append([None] * len(looks) if emitted is None else emitted.tolist())
        for (
            channel, t, range_m, azimuth_deg, elevation_deg, pd, detected, snr_db, drone, emitted_ns
        ) in zip(*columns, strict=True):  # fmt: skip
            drone_id, other = _named(self._names[drone])
            yield pb.Look(
                drone=drone_id,
                other=other,
                time_utc_ns=t,
                range_m=range_m,
                azimuth_deg=azimuth_deg,
                elevation_deg=elevation_deg,
                snr_db=snr_db,
                pd=pd,
                detected=detected,
                channel=channel,
                emitted_utc_ns=emitted_ns or None,
            )

    def _few_plots(self, plots: Plots) -> Iterator[pb.PlotTruth]:
        names = ("t_utc_ns", "true_range_m", "true_azimuth_deg", "true_elevation_deg", "drone")
        columns = [getattr(plots, name).tolist() for name in names]
        rates_m_s, merged = plots.true_range_rate_m_s, plots.merged_drones
        for i, (t, range_m, azimuth_deg, elevation_deg, drone) in enumerate(
            zip(*columns, strict=True)
        ):
            truth = pb.PlotTruth(time_utc_ns=t)
            if drone != FALSE_ALARM:
                drone_id, other = _named(self._names[drone])
                is_somewhere = not (other and np.isnan(range_m))
                truth = pb.PlotTruth(
                    drone=drone_id,
                    other=other,
                    time_utc_ns=t,
                    range_m=range_m if is_somewhere else None,
                    azimuth_deg=azimuth_deg if is_somewhere else None,
                    elevation_deg=elevation_deg if is_somewhere else None,
                )
            if rates_m_s is not None and not np.isnan(rates_m_s[i]):
                truth.range_rate_m_s = rates_m_s[i]
            if merged is not None:
                truth.merged_drones.extend(self._names[other] for other in merged[i])
            yield truth

    def _plots(self, plots: Plots) -> tuple[bytes, Ints] | None:
        if len(plots) < MANY:
            return _joined(_PLOTS, self._few_plots(plots)) if len(plots) else None
        is_true = plots.drone != FALSE_ALARM
        if self._has_others:
            is_true &= ~(np.isnan(plots.true_range_m) & self._are_others[plots.drone])
        columns: list[Field] = [
            self._caused_by.of(plots.drone + 1),
            Integers(_PLOT["time_utc_ns"], plots.t_utc_ns),
            Doubles(_PLOT["range_m"], plots.true_range_m, is_true),
            Doubles(_PLOT["azimuth_deg"], plots.true_azimuth_deg, is_true),
            Doubles(_PLOT["elevation_deg"], plots.true_elevation_deg, is_true),
        ]
        rates_m_s = plots.true_range_rate_m_s
        if rates_m_s is not None:
            columns.append(Doubles(_PLOT["range_rate_m_s"], rates_m_s, ~np.isnan(rates_m_s)))
        if plots.merged_drones is not None:
            columns.append(self._merged(plots.merged_drones.tolist()))
        if self._has_others:
            columns.append(self._others_caused_by.of(plots.drone + 1))
        return submessages(_LEDGER["plots"], len(plots), columns)

    def _merged(self, merged: Sequence[Sequence[int]]) -> Field:
        named, field = self._names, _PLOT["merged_drones"]
        fields = [b"".join(_repeated(field, named[i]) for i in some) for some in merged]
        return TextTable(fields).of(np.arange(len(fields)))


def _named(name: str) -> tuple[str, str]:
    """A name as that of a drone, and as that of something else; one of them is empty."""
    return ("", name) if OTHER in name else (name, "")


def _fields(names: Sequence[str]) -> Iterator[list[bytes]]:
    """Octets of fields with those names, in the order of the tables; empty where it is another."""
    for which, field in enumerate(("drone", "other")):
        for numbers in (_LOOK, _PLOT):
            yield [text_field(numbers[field], _named(name)[which]) for name in names]


@lru_cache(maxsize=4096)
def _repeated(number: int, name: str) -> bytes:
    octets = name.encode()
    return varint(number << 3 | LENGTH) + varint(len(octets)) + octets


def sent_field(sent: pb.Sent) -> bytes:
    """A message, whatever became of it, as a field of its Ledger."""
    return _submessage(_MESSAGES, sent)


def _submessage(head: bytes, message: pb.Look | pb.PlotTruth | pb.Sent) -> bytes:
    octets = message.SerializeToString()
    return head + varint(len(octets)) + octets


def _joined(head: bytes, messages: Iterable[pb.Look | pb.PlotTruth]) -> tuple[bytes, Ints]:
    """Rows as `submessages` makes them, and where each begins and ends, (n+1,)."""
    parts = [_submessage(head, message) for message in messages]
    return b"".join(parts), np.array([0, *accumulate(map(len, parts))], np.int64)


def ledger(
    sensor: str,
    scan: int,
    sector: int,
    *,
    truth: bytes,
    sent: bytes,
    link: str = "",
    claims: bytes = b"",
) -> bytes:
    """A serialised Ledger of its looks and plots, its messages, and its link's keys in JSON.

    `claims` are what drones said of themselves, as octets of the entry.
    """
    head = _sensor(sensor)
    if scan:
        head += _SCAN + varint(scan)
    if sector:
        head += _SECTOR + varint(sector)
    return b"".join((head, truth, sent, _link(link), claims))


@lru_cache(maxsize=4096)
def _sensor(sensor: str) -> bytes:
    return text_field(_LEDGER["sensor"], sensor)


@lru_cache(maxsize=4096)
def _link(link: str) -> bytes:
    return text_field(_LEDGER["link"], link)


def _parts(octets: bytes, ends: Ints, by: Ints) -> list[bytes]:
    """The octets of rows by sector."""
    return [octets[first:after] for first, after in pairwise(ends[by].tolist())]

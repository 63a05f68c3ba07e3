"""The ledger of many sectors at once, read back: row by row what protobuf's own objects hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.link import ledger_messages as writing
from plotfeed.feeds.link.ledger_messages import Kept, ledger_messages
from plotfeed.feeds.messages.batch import Batch, edges
from plotfeed.feeds.messages.message import HELD_NS, Message, records
from plotfeed.models.beam import Sector, Sectors
from plotfeed.models.state import FALSE_ALARM, Looks, Plots
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.ledger import entries_in, tables_of
from plotfeed.proto.ledger_pb2 import LedgerBatch
from plotfeed.proto.units import decibels

NAMES = ["d", "drone-1", "x" * 64, "ünïcödé", "visitor", "bird/gulls-1"]
SENSORS = ["near", "far", "ünïcödé"]
LINKS = ["", '{"latency_ms":50.0}']
FATES = [pb.SENT, pb.LOST, pb.UNDELIVERED, pb.ENDED]
TOPICS = ["plotfeed/r/plots", "plotfeed/r/asterix/048", "é" * 100]
SAID_OF_LOOKS = ("range_m", "azimuth_deg", "elevation_deg", "pd")
TRUE_OF_PLOTS = ("range_m", "azimuth_deg", "elevation_deg", "range_rate_m_s")
seeds = st.integers(0, 2**32)


class Made:
    """Columns at random, odd values among them, of what batches hold."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    def happens(self) -> bool:
        return bool(self.rng.integers(2))

    def one_of(self, some: Sequence[Any]) -> Any:
        return some[self.rng.integers(len(some))]

    def times(self, n: int) -> Any:
        usual = self.rng.integers(1_700_000_000 * 10**9, 1_900_000_000 * 10**9, n)
        return np.where(self.rng.random(n) < 0.3, self.rng.choice([-5, 0, 1, 2**62], n), usual)

    def numbers(self, n: int) -> Any:
        usual = self.rng.standard_normal(n) * 10.0 ** self.rng.integers(-300, 300, n)
        odd = self.rng.choice([0.0, -0.0, math.nan, math.inf, 1.5], n)
        return np.where(self.rng.random(n) < 0.3, odd, usual)

    def drones(self, n: int, least: int = 0, most: int = len(NAMES)) -> Any:
        return self.rng.integers(least, most, n)

    def looks(self, n: int, names: int) -> Looks:
        return Looks(
            drone=self.drones(n, most=names),
            channel=self.rng.integers(-1, 300, n),
            t_utc_ns=self.times(n),
            snr=np.abs(np.nan_to_num(self.numbers(n), posinf=1e12)),
            detected=self.rng.random(n) < 0.5,
            emitted_utc_ns=self.times(n) if self.happens() else None,
            **{name: self.numbers(n) for name in SAID_OF_LOOKS},
        )

    def plots(self, n: int, names: int) -> Plots:
        drone, more = self.drones(n, FALSE_ALARM, names), dict[str, Any]()
        if self.happens():  # of a false alarm there is none
            rates = np.where(drone == FALSE_ALARM, math.nan, self.numbers(n))
            more["true_range_rate_m_s"] = rates
        if self.happens():
            merged = np.empty(n, object)
            merged[:] = [
                () if of == FALSE_ALARM else tuple(self.drones(self.rng.integers(4), most=names))
                for of in drone
            ]
            more["merged_drones"] = merged
        columns = {f"true_{name}": self.numbers(n) for name in TRUE_OF_PLOTS[:3]}
        return Plots.of(drone=drone, t_utc_ns=self.times(n), **columns, **more)

    def message(self) -> Message:
        payload, due_ns = self.rng.bytes(self.rng.integers(9)), int(self.times(1)[0])
        one = Message(self.one_of(TOPICS), payload, "", due_ns)
        one.number, one.copy = (int(n) for n in self.rng.integers([6, 2]))
        if self.happens():
            one.leaves_utc_ns = self.one_of([HELD_NS, int(self.times(1)[0])])
        one.sent_utc_ns, one.fate = int(self.times(1)[0]), self.one_of(FATES)
        one.flipped_bit = int(self.rng.integers(2**20)) if self.happens() else None
        one.not_to = tuple(["MQTT", "udp[0] 192.0.2.1:8600"][: self.rng.integers(3)])
        return one

    def batch(self, names: Sequence[str] = NAMES) -> Batch:
        m = int(self.rng.integers(1, 5))
        looks_by, plots_by = (edges(self.rng.integers(0, 5, m)) for _ in "ab")
        of = zip(self.rng.integers(0, 2**62, m), self.times(m), strict=True)
        sectors = [
            Sectors.of([Sector(int(scan), i, 0, int(end), 0.0, 1.0)], self.one_of(range(3)))
            for i, (scan, end) in enumerate(of)
        ]
        said = [pb.Claim(drone=self.one_of(NAMES), time_utc_ns=t) for t in range(2)]
        return Batch(
            sectors=Sectors.joined(sectors),
            looks=self.looks(int(looks_by[-1]), len(names)),
            looks_by=looks_by,
            plots=self.plots(int(plots_by[-1]), len(names)),
            plots_by=plots_by,
            sensors=SENSORS,
            names=names,
            messages=[[self.message() for _ in range(self.rng.integers(5))] for _ in range(m)],
            links=[self.one_of(LINKS) for _ in range(m)],
            claims=said[: self.rng.integers(3)] if m == 1 and self.happens() else None,
        )

    def kept(self, names: Sequence[str] = NAMES) -> list[Kept]:
        """Sectors of some batches."""
        held = [self.batch(names) for _ in range(self.rng.integers(1, 4))]
        return [(batch, row) for batch in held for row in range(len(batch))]


def named(name: str) -> dict[str, Any]:
    """What is no drone has a kind before a slash, and a field of its own."""
    return {"other" if "/" in name else "drone": name}


def by_protobuf(batch: Batch, row: int) -> bytes:
    """The entry of a sector, look by look and plot by plot."""
    one, names = batch.one(row), batch.names
    looks, plots, of = one.looks, one.plots, one.sectors
    entry = pb.Ledger(
        sensor=one.sensor, scan=int(of.scan[0]), sector=int(of.index[0]), link=one.links[0],
        messages=records(one.messages[0]), claims=one.claims or (),
    )  # fmt: skip
    snr_db = decibels(looks.snr)
    for i in range(len(looks)):
        entry.looks.add(
            **named(names[looks.drone[i]]),
            **{name: getattr(looks, name)[i] for name in SAID_OF_LOOKS},
            time_utc_ns=int(looks.t_utc_ns[i]),
            snr_db=snr_db[i],
            detected=bool(looks.detected[i]),
            channel=int(looks.channel[i]),
        )
        if looks.emitted_utc_ns is not None and looks.emitted_utc_ns[i]:
            entry.looks[-1].emitted_utc_ns = int(looks.emitted_utc_ns[i])
    for i in range(len(plots)):
        truth: dict[str, Any] = {}
        if plots.drone[i] != FALSE_ALARM:
            truth = named(names[plots.drone[i]])
            columns = {name: getattr(plots, f"true_{name}") for name in TRUE_OF_PLOTS}
            truth |= {
                name: column[i]
                for name, column in columns.items()
                if column is not None and not math.isnan(column[i])
            }
        if plots.merged_drones is not None:
            truth["merged_drones"] = [names[drone] for drone in plots.merged_drones[i]]
        entry.plots.add(time_utc_ns=int(plots.t_utc_ns[i]), **truth)
    return entry.SerializeToString(deterministic=True)


lists = st.just(NAMES) | st.lists(st.text(max_size=6), min_size=1, max_size=5)


@given(seeds, st.sampled_from([1, 900, 900_000]), st.lists(lists, min_size=1, max_size=4))
def test_what_is_read_of_sectors_is_what_protobuf_makes_of_them(
    seed: int, most: int, names_of: list[list[str]]
) -> None:
    """Of several batches in any order, each with drones of its own, in a message or in many."""
    made = Made(seed)
    kept = [each for names in names_of for each in made.kept(names)]
    kept = [kept[i] for i in made.rng.permutation(len(kept))]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writing, "MOST_OCTETS", most)
        payloads = [message.payload for message in ledger_messages("p", kept)]
    entries = [entry for payload in payloads for entry in entries_in(payload)]
    found = [entry.SerializeToString(deterministic=True) for entry in entries]
    assert found == [by_protobuf(*each) for each in kept]


@given(seeds)
def test_old_messages_give_the_tables_that_columns_give(seed: int) -> None:
    """So does a file in which both are."""
    kept = Made(seed).kept()
    new = [message.payload for message in ledger_messages("p", kept)]
    old = [entry.SerializeToString() for payload in new for entry in entries_in(payload)]
    told = tables_of([*old, b"\xff", *new])
    n = len(kept)
    assert told.entries.payload.tolist()[:n] == [*range(n)]
    assert {*told.entries.payload[n:].tolist()} == {n + 1 + i for i in range(len(new))}
    halves = (told.of(np.arange(n)), told.of(np.arange(n, 2 * n)))
    for name in ("entries", "looks", "plots", "messages"):
        one, other = (vars(getattr(half, name)) for half in halves)
        for column in one.keys() - {"payload"}:
            assert one[column].dtype == other[column].dtype
            np.testing.assert_array_equal(one[column], other[column])


COLUMNS = [
    (part.name, field.name)
    for part in LedgerBatch.DESCRIPTOR.fields
    if part.message_type is not None and not part.is_repeated
    for field in part.message_type.fields
]
OF_AN_OCTET = ("fate", "detected")


@given(
    seeds,
    st.lists(st.tuples(st.sampled_from(COLUMNS), st.integers(-(2**31), 2**31 - 1)), min_size=1),
    st.booleans(),
)
def test_columns_that_contradict_each_other_are_no_ledger_and_stop_nobody(
    seed: int, wrong: list[Any], is_longer: bool
) -> None:
    kept = Made(seed).kept()
    batch = LedgerBatch.FromString(ledger_messages("p", kept)[0].payload)
    for (part, name), value in wrong:
        column = getattr(getattr(batch, part), name)
        number = value % 2 if name in OF_AN_OCTET else value
        if is_longer or not column:
            column.append(number)
        else:
            column[value % len(column)] = number
    payload = batch.SerializeToString()
    told = tables_of([payload])
    try:
        entries = entries_in(payload)
    except DecodeError:
        entries = []
    assert len(entries) in (0, len(told))
    for table in (told.looks, told.plots, told.messages):
        assert {len(column) for column in vars(table).values()} == {len(table)}
        assert (table.entry < len(told)).all()

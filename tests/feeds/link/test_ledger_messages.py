"""The ledger of many sectors at once, read back: row by row what protobuf's own objects hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
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
times = st.one_of(st.integers(1_700_000_000 * 10**9, 1_900_000_000 * 10**9), st.integers(-5, 2**62))
numbers = st.one_of(st.floats(width=64), st.sampled_from([0.0, -0.0, math.nan, 1.5]))
positive = st.floats(0.0, 1e12)
drones = st.integers(0, len(NAMES) - 1)
looks = st.tuples(
    drones, st.integers(-1, 300), times, numbers, numbers, numbers,
    positive, numbers, st.booleans(), st.one_of(st.just(0), times),
)  # fmt: skip
plots = st.tuples(
    st.integers(FALSE_ALARM, len(NAMES) - 1), times, numbers, numbers, numbers, numbers,
    st.lists(drones, max_size=3),
)  # fmt: skip
messages = st.tuples(
    st.sampled_from(["plotfeed/r/plots", "plotfeed/r/asterix/048", "é" * 100]),
    times,
    st.one_of(st.just(None), st.just(HELD_NS), times),
    times,
    st.binary(max_size=9),
    st.sampled_from([pb.SENT, pb.LOST, pb.UNDELIVERED, pb.ENDED]),
    st.integers(0, 5),
    st.integers(0, 1),
    st.one_of(st.just(None), st.integers(0, 2**20)),
    st.lists(st.sampled_from(["MQTT", "udp[0] 192.0.2.1:8600"]), max_size=2),
)
claims = st.lists(st.builds(pb.Claim, drone=st.sampled_from(NAMES), time_utc_ns=times), max_size=2)
sectors = st.tuples(
    st.tuples(st.sampled_from(range(3)), st.integers(0, 2**62), st.integers(0, 1000), times),
    st.sampled_from(LINKS),
    st.lists(looks, max_size=4),
    st.lists(plots, max_size=4),
    st.lists(messages, max_size=4),
)
batches = st.lists(
    st.tuples(
        st.lists(sectors, min_size=1, max_size=4),
        st.booleans(),
        st.booleans(),
        st.booleans(),
        st.one_of(st.just(None), claims),
    ),
    min_size=1,
    max_size=3,
)
EMPTY = ((0, 0, 0, 0), "", [], [(-1, 0, 0.0, 0.0, 0.0, 0.0, [])], [])


def looks_of(rows: list[Any]) -> Looks:
    if not rows:
        return Looks.none()
    drone, channel, t, *floats, detected, emitted = zip(*rows, strict=True)
    names = ("range_m", "azimuth_deg", "elevation_deg", "snr", "pd")
    return Looks(
        drone=np.array(drone),
        channel=np.array(channel),
        t_utc_ns=np.array(t),
        detected=np.array(detected),
        emitted_utc_ns=np.array(emitted) if any(emitted) else None,
        **{name: np.array(column) for name, column in zip(names, floats, strict=True)},
    )


def plots_of(rows: list[Any], with_rates: bool, with_merged: bool) -> Plots:
    more: dict[str, Any] = {}
    if with_rates:
        # Of a false alarm there is none.
        rates = [math.nan if row[0] == FALSE_ALARM else row[5] for row in rows]
        more["true_range_rate_m_s"] = np.array(rates, np.float64)
    if with_merged:
        merged = np.empty(len(rows), object)
        merged[:] = [() if row[0] == FALSE_ALARM else tuple(row[6]) for row in rows]
        more["merged_drones"] = merged
    return Plots.of(
        drone=np.array([row[0] for row in rows], np.int64),
        t_utc_ns=np.array([row[1] for row in rows], np.int64),
        true_range_m=np.array([row[2] for row in rows], np.float64),
        true_azimuth_deg=np.array([row[3] for row in rows], np.float64),
        true_elevation_deg=np.array([row[4] for row in rows], np.float64),
        **more,
    )


def outgoing_of(row: Any) -> Message:
    topic, due, link_due, sent, payload, fate, number, copy, bit, not_to = row
    one = Message(topic, payload, "", due)
    one.number, one.copy = number, copy
    one.leaves_utc_ns = due if link_due is None else link_due
    one.sent_utc_ns, one.fate, one.flipped_bit, one.not_to = sent, fate, bit, tuple(not_to)
    return one


def batch_of(made: Any, names: Sequence[str] = NAMES) -> Batch:
    rows, with_rates, with_merged, is_late, said = made
    return Batch(
        sectors=Sectors.joined(
            [Sectors.of([Sector(scan, i, 0, end, 0.0, 1.0)], s) for (s, scan, i, end), *_ in rows]
        ),
        looks=looks_of([look for _, _, seen, *_ in rows for look in seen]),
        looks_by=edges(np.array([len(seen) for _, _, seen, *_ in rows])),
        plots=plots_of([p for *_, told, _ in rows for p in told], with_rates, with_merged),
        plots_by=edges(np.array([len(told) for *_, told, _ in rows])),
        sensors=SENSORS,
        names=names,
        messages=[[*map(outgoing_of, sent)] for *_, sent in rows],
        links=[link for _, link, *_ in rows],
        claims=said if len(rows) == 1 and is_late else None,
    )


def kept_of(made: list[Any]) -> list[Kept]:
    held = [batch_of(each) for each in made]
    return [(batch, row) for batch in held for row in range(len(batch))]


def named(name: str) -> dict[str, Any]:
    """What is no drone has a kind before a slash, and a field of its own."""
    return {"other" if "/" in name else "drone": name}


def known(**values: float) -> dict[str, float]:
    return {name: value for name, value in values.items() if not math.isnan(value)}


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
            time_utc_ns=int(looks.t_utc_ns[i]),
            range_m=looks.range_m[i],
            azimuth_deg=looks.azimuth_deg[i],
            elevation_deg=looks.elevation_deg[i],
            snr_db=snr_db[i],
            pd=looks.pd[i],
            detected=bool(looks.detected[i]),
            channel=int(looks.channel[i]),
        )
        if looks.emitted_utc_ns is not None and looks.emitted_utc_ns[i]:
            entry.looks[-1].emitted_utc_ns = int(looks.emitted_utc_ns[i])
    for i in range(len(plots)):
        truth: dict[str, Any] = {}
        if plots.drone[i] != FALSE_ALARM:
            truth = named(names[plots.drone[i]]) | known(
                range_m=plots.true_range_m[i],
                azimuth_deg=plots.true_azimuth_deg[i],
                elevation_deg=plots.true_elevation_deg[i],
            )
        if plots.true_range_rate_m_s is not None:
            truth |= known(range_rate_m_s=plots.true_range_rate_m_s[i])
        if plots.merged_drones is not None:
            truth["merged_drones"] = [names[drone] for drone in plots.merged_drones[i]]
        entry.plots.add(time_utc_ns=int(plots.t_utc_ns[i]), **truth)
    return entry.SerializeToString(deterministic=True)


def read(kept: Sequence[Kept]) -> list[bytes]:
    """What is read back of sectors, sector by sector."""
    payloads = [message.payload for message in ledger_messages("p", kept)]
    entries = [entry for payload in payloads for entry in entries_in(payload)]
    return [entry.SerializeToString(deterministic=True) for entry in entries]


@example(made=[([EMPTY], False, False, False, None)], most=900_000, order=0)
@given(batches, st.sampled_from([1, 900, 900_000]), st.integers(0, 2**32))
def test_what_is_read_of_sectors_is_what_protobuf_makes_of_them(
    made: list[Any], most: int, order: int
) -> None:
    """Of several batches in any order, in one message or in as many as there are sectors."""
    kept = kept_of(made)
    kept = [kept[i] for i in np.random.default_rng(order).permutation(len(kept))]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writing, "MOST_OCTETS", most)
        assert read(kept) == [by_protobuf(*each) for each in kept]


@given(st.lists(st.lists(st.text(max_size=6), min_size=1, max_size=5), min_size=1, max_size=4))
def test_rows_may_be_other_drones_of_another_list(lists: list[list[str]]) -> None:
    kept = []
    for names in lists:
        seen = [(i, 0, 5, 1.0, 2.0, 3.0, 4.0, 0.5, True, 0) for i in range(len(names))]
        told = [(i, 5, 1.0, 2.0, 3.0, 4.0, []) for i in range(len(names))]
        one = ((0, 1, 2, 3), "", seen, told, [])
        kept.append((batch_of(([one], False, False, False, None), names), 0))
    assert read(kept) == [by_protobuf(*each) for each in kept]


@given(batches)
def test_old_messages_give_the_tables_that_columns_give(made: list[Any]) -> None:
    """So does a file in which both are."""
    kept = kept_of(made)
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
    batches,
    st.lists(st.tuples(st.sampled_from(COLUMNS), st.integers(-(2**31), 2**31 - 1)), min_size=1),
    st.booleans(),
)
def test_columns_that_contradict_each_other_are_no_ledger_and_stop_nobody(
    made: list[Any], wrong: list[Any], is_longer: bool
) -> None:
    kept = kept_of(made)
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

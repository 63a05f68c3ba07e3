"""Ledgers of many sectors at once, against protobuf's own octets of the same."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from plotfeed.models.state import FALSE_ALARM, Looks, Plots
from plotfeed.proto import ledger_octets
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger_octets import LedgerOctets, ledger, sent_field
from plotfeed.proto.units import decibels

NAMES = ["d", "drone-1", "x" * 64, "ünïcödé", "visitor", "bird/gulls-1"]
times = st.one_of(st.integers(1_700_000_000 * 10**9, 1_900_000_000 * 10**9), st.integers(-5, 2**62))
numbers = st.one_of(st.floats(width=64), st.sampled_from([0.0, -0.0, math.nan, 1.5]))
positive = st.floats(0.0, 1e12)
looks = st.tuples(
    st.integers(0, len(NAMES) - 1), st.integers(-1, 300), times, numbers, numbers, numbers,
    positive, numbers, st.booleans(), st.one_of(st.just(0), times),
)  # fmt: skip
plots = st.tuples(
    st.integers(FALSE_ALARM, len(NAMES) - 1), times, numbers, numbers, numbers, numbers,
    st.lists(st.integers(0, len(NAMES) - 1), max_size=3),
)  # fmt: skip
sectors = st.lists(
    st.tuples(st.lists(looks, max_size=4), st.lists(plots, max_size=4)), min_size=1, max_size=5
)


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


def named(name: str) -> dict[str, Any]:
    """What is no drone has a kind before a slash, and a field of its own."""
    return {"other" if "/" in name else "drone": name}


def by_protobuf(looks: Looks, plots: Plots, **more: Any) -> pb.Ledger:
    """An entry, look by look and plot by plot."""
    entry = pb.Ledger(**more)
    snr_db = decibels(looks.snr)
    for i in range(len(looks)):
        entry.looks.add(
            **named(NAMES[looks.drone[i]]),
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
        truth = entry.plots.add(time_utc_ns=int(plots.t_utc_ns[i]))
        if plots.drone[i] != FALSE_ALARM:
            whose = named(NAMES[plots.drone[i]])
            truth.MergeFrom(pb.PlotTruth(**whose))
            if "drone" in whose or not np.isnan(plots.true_range_m[i]):
                truth.range_m = plots.true_range_m[i]
                truth.azimuth_deg = plots.true_azimuth_deg[i]
                truth.elevation_deg = plots.true_elevation_deg[i]
        if plots.true_range_rate_m_s is not None and not np.isnan(plots.true_range_rate_m_s[i]):
            truth.range_rate_m_s = plots.true_range_rate_m_s[i]
        if plots.merged_drones is not None:
            truth.merged_drones.extend(NAMES[drone] for drone in plots.merged_drones[i])
    return entry


def ends(counts: list[int]) -> Any:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


NOTHING_TOLD = [([], [(-1, 0, 0.0, 0.0, 0.0, 0.0, [])])]
"""A false alarm at the beginning of 1970: all of its fields are defaults."""


@example(sectors=NOTHING_TOLD, with_rates=False, with_merged=False, many=1)
@given(sectors, st.booleans(), st.booleans(), st.sampled_from([1, 100]))
def test_looks_and_plots_are_what_protobuf_makes_of_them(
    sectors: list[Any], with_rates: bool, with_merged: bool, many: int
) -> None:
    """Whether they are few or many."""
    octets = LedgerOctets()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ledger_octets, "MANY", many)
        truths = truths_of(octets, sectors, with_rates, with_merged)
    expected = [
        by_protobuf(looks_of(seen), plots_of(told, with_rates, with_merged)).SerializeToString()
        for seen, told in sectors
    ]
    assert truths == expected


def truths_of(
    octets: LedgerOctets, sectors: list[Any], with_rates: bool, with_merged: bool
) -> list[bytes]:
    return octets.truths(
        looks_of([row for rows, _ in sectors for row in rows]),
        ends([len(rows) for rows, _ in sectors]),
        plots_of([row for _, rows in sectors for row in rows], with_rates, with_merged),
        ends([len(rows) for _, rows in sectors]),
        names=NAMES,
    )


messages = st.lists(
    st.tuples(
        st.sampled_from(["plotfeed/r/plots", "plotfeed/r/asterix/048", "é" * 100]),
        times,
        times,
        st.integers(0, 2**31 - 1),
        st.integers(0, 2**62),
    ),
    min_size=1,
    max_size=6,
)


@given(messages, messages, st.integers(0, 2**62), st.integers(0, 1000), st.sampled_from(["", "{}"]))
def test_messages_and_the_whole_entry_are_what_protobuf_makes_of_them(
    some: list[Any], others: list[Any], scan: int, sector: int, link: str
) -> None:
    """Topics that have been told of before have their numbers already."""
    octets = LedgerOctets()
    for messages in (some, others):
        sent = [
            pb.Sent(
                topic=topic,
                due_utc_ns=due_ns,
                sent_utc_ns=sent_ns,
                octets=size,
                delivered=True,
                fate=pb.SENT,
                link_due_utc_ns=due_ns,
                number=number,
            )
            for topic, due_ns, sent_ns, size, number in messages
        ]
        topics, *columns = zip(*messages, strict=True)
        fields, places = octets.sent(topics, *(np.array(c, np.int64) for c in columns))
        parts = [fields[a:b] for a, b in pairwise(places)]
        assert parts == [sent_field(one) for one in sent]
        expected = pb.Ledger(sensor="r", scan=scan, sector=sector, messages=sent, link=link)
        assert (
            ledger("r", scan, sector, truth=b"", sent=fields, link=link)
            == expected.SerializeToString()
        )


def test_drones_may_become_more() -> None:
    names: list[str] = []
    octets = LedgerOctets()
    for i, name in enumerate(NAMES):
        names.append(name)
        seen = looks_of([(i, 0, 5, 1.0, 2.0, 3.0, 4.0, 0.5, True, 0)])
        told = plots_of([(i, 5, 1.0, 2.0, 3.0, 4.0, [])], with_rates=False, with_merged=False)
        truths = octets.truths(seen, ends([1]), told, ends([1]), names=names)
        assert truths == [by_protobuf(seen, told).SerializeToString()]


@given(st.lists(st.lists(st.text(max_size=6), min_size=1, max_size=5), min_size=1, max_size=6))
def test_rows_may_be_other_drones_of_another_list_and_old_lists_come_again(
    lists: list[list[str]],
) -> None:
    octets = LedgerOctets()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ledger_octets, "MANY", 1)
        for names in [*lists, *lists]:
            rows = range(len(names))
            seen = looks_of([(i, 0, 5, 1.0, 2.0, 3.0, 4.0, 0.5, True, 0) for i in rows])
            told = plots_of([(i, 5, 1.0, 2.0, 3.0, 4.0, []) for i in rows], False, False)
            n = ends([len(names)])
            entry = pb.Ledger.FromString(octets.truths(seen, n, told, n, names=names)[0])
            assert [look.drone or look.other for look in entry.looks] == names
            assert [plot.drone or plot.other for plot in entry.plots] == names


@pytest.mark.parametrize("fate", [pb.LOST, pb.UNDELIVERED, pb.SENT])
def test_any_fate_is_told(fate: pb.Fate) -> None:
    one = pb.Sent(topic="t", fate=fate, number=3, copy=1, flipped_bit=0)
    entry = pb.Ledger(sensor="r", messages=[one])
    assert ledger("r", 0, 0, truth=b"", sent=sent_field(one)) == entry.SerializeToString()

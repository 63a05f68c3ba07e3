"""Batches of plots in protobuf: the octets are protobuf's own, however many are made at once."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.models.state import Plots
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.plot_messages import MANY, plot_batches
from plotfeed.proto.units import decibels
from plotfeed.proto.varint import varint

DOUBLES = [
    field.name
    for field in pb.Plot.DESCRIPTOR.fields
    if field.type == field.TYPE_DOUBLE and field.name != "snr_db"
]
NOW_NS = 1_700_000_000_000_000_000


def by_protobuf(sensor: str, scan: int, sector: int, plots: Plots) -> bytes:
    """What the library makes of it, field by field."""
    batch = pb.PlotBatch(sensor=sensor, scan=scan, sector=sector)
    for i in range(len(plots)):
        row = batch.plots.add(
            time_utc_ns=int(plots.t_utc_ns[i]),
            channel=int(plots.channel[i]),
            kind=plots.kind[i],
            identity=plots.identity[i],
        )
        known = {name: getattr(plots, name) for name in DOUBLES}
        known["snr_db"] = decibels(plots.snr)
        for name, column in known.items():
            if column is not None and not math.isnan(column[i]):
                setattr(row, name, float(column[i]))
    return batch.SerializeToString()


@st.composite
def columns(draw: st.DrawFn, n: int) -> Plots:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    names = draw(st.lists(st.sampled_from([*DOUBLES, "snr"]), unique=True))
    given_: dict[str, Any] = {name: rng.uniform(0.0, 1e4, n) for name in names}
    for name in draw(st.lists(st.sampled_from(names), max_size=2)) if names else []:
        given_[name][rng.random(n) < draw(st.sampled_from([0.3, 1.0]))] = np.nan
    low, high = draw(st.sampled_from([(0, 1), (1, 4), (0, 3), (1, 128), (1, 300)]))
    if draw(st.booleans()):
        given_["channel"] = rng.integers(low, high, n)
    texts = draw(st.sampled_from([[""], ["video", "contröl"], ["", "video"]]))
    if draw(st.booleans()):
        given_["kind"] = rng.choice(np.array(texts, np.object_), n)
        given_["identity"] = rng.choice(np.array(texts, np.object_), n)
    early = draw(st.sampled_from([NOW_NS, NOW_NS, 5, -NOW_NS]))
    times = early + np.sort(rng.integers(0, 10**9, n))
    return Plots.of(t_utc_ns=times, drone=np.full(n, -1), **given_)


@given(st.data(), st.lists(st.integers(0, 2 * MANY), min_size=1, max_size=6))
def test_octets_are_those_of_protobuf(data: st.DataObject, counts: list[int]) -> None:
    by = [0, *np.cumsum(counts).tolist()]
    plots = data.draw(columns(by[-1]))
    numbers = st.sampled_from([0, 1, 127, 128, 300, 1_700_000_000])
    sensors = [data.draw(st.sampled_from(["", "north", "øst"])) for _ in counts]
    scans, sectors = ([data.draw(numbers) for _ in counts] for _ in range(2))
    assert plot_batches(sensors, scans, sectors, plots, by) == [
        by_protobuf(sensor, scan, sector, plots.between(a, b))
        for sensor, scan, sector, a, b in zip(sensors, scans, sectors, by[:-1], by[1:], strict=True)
    ]


@pytest.mark.parametrize("number", [0, 1, 127, 128, 300, 2**31 - 1, 2**62, -1, -(2**40)])
def test_numbers_of_no_fixed_length_are_those_of_protobuf(number: int) -> None:
    octets = pb.PlotBatch(scan=number).SerializeToString()
    assert octets[1:] == (varint(number) if number else b"")

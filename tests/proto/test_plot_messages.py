"""Plots in our messages: the octets are protobuf's own, and what is told is read back."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.models.state import NS, Plots
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.plot_messages import MANY, plot_batches, plots_in_batch
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


T_NS = 1_767_268_800 * NS
PLOTS = Plots.of(
    t_utc_ns=np.array([T_NS, T_NS + NS]),
    bistatic_range_m=np.array([2000.0, 3000.0]),
    azimuth_deg=np.array([45.0, 90.0]),
    sigma_bistatic_range_m=np.array([2.5, 2.5]),
    channel=np.array([1, 2]),
)


def test_a_batch_says_all_that_is_measured_and_no_more() -> None:
    found = plots_in_batch(plot_batches(["north"], [3], [1], PLOTS, [0, len(PLOTS)])[0])
    assert found.t_utc_ns.tolist() == PLOTS.t_utc_ns.tolist()
    assert found.sensor.tolist() == ["north"] * 2
    assert found.bistatic_range_m.tolist() == [2000.0, 3000.0]
    assert found.channel.tolist() == [1, 2]
    for name in ("range_m", "elevation_deg", "height_m", "altitude_m", "sigma_range_m"):
        assert np.isnan(getattr(found, name)).all()
    assert (found.category == 0).all()
    none = MeasuredPlots.of(())
    assert len(none) == 0
    assert len(MeasuredPlots.joined([none, found, found])) == 4


def test_a_detection_of_sapient_is_one_plot() -> None:
    pb = pytest.importorskip("sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2")
    from plotfeed.proto.sapient.decode_sapient import plots_in_sapient

    message = pb.SapientMessage()
    message.timestamp.FromNanoseconds(T_NS)
    report = message.detection_report
    report.range_bearing.azimuth, report.range_bearing.range_error = 45.0, 2.0
    report.object_info.add(type="age", value="0.5")
    report.object_info.add(type="bistatic range", value="2000.25")
    found = plots_in_sapient(message.SerializeToString())
    assert found.t_utc_ns.tolist() == [T_NS - NS // 2]
    assert found.bistatic_range_m.tolist() == [2000.25]
    assert (found.azimuth_deg.tolist(), found.sigma_range_m.tolist()) == ([45.0], [2.0])
    assert np.isnan(found.range_m).all()
    report.object_info[0].value = "inf"
    with pytest.raises(DecodeError, match="object_info"):
        plots_in_sapient(message.SerializeToString())

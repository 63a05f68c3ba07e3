"""Plots from octets: what is told is there, what is not is NaN, and nonsense is refused."""

from __future__ import annotations

import numpy as np
import pytest

from plotfeed.models.state import NS, Plots
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.plot_messages import plot_batches, plots_in_batch

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


def test_no_plots_join_with_others_to_those() -> None:
    none, some = (
        MeasuredPlots.of(()),
        plots_in_batch(plot_batches(["north"], [3], [1], PLOTS, [0, len(PLOTS)])[0]),
    )
    assert len(none) == 0
    assert len(MeasuredPlots.joined([none, some, some])) == 4


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

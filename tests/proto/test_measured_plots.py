"""Plots from octets: what is told is there, what is not is NaN, and nonsense is refused."""

from __future__ import annotations

import numpy as np
import pytest

from plotfeed.models.state import NS, Plots
from plotfeed.proto.asterix.cat015 import Geometry, PlotEncoder015
from plotfeed.proto.asterix.cat048 import PlotEncoder048
from plotfeed.proto.asterix.decode_plots import plots_in_asterix
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.measured_plots import NOT_TOLD, MeasuredPlots
from plotfeed.proto.plot_messages import plot_batches, plots_in_batch
from plotfeed.proto.utc import DAY_NS

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


def test_a_multistatic_range_is_no_range() -> None:
    (payload,) = PlotEncoder015(25, 14, geometry=Geometry.MULTISTATIC).blocks(PLOTS)
    found = plots_in_asterix(payload, T_NS + DAY_NS // 3)
    assert found.t_utc_ns.tolist() == PLOTS.t_utc_ns.tolist()
    assert found.bistatic_range_m == pytest.approx([2000, 3000])
    assert (found.sigma_bistatic_range_m >= 2.5).all()  # with the rounding of the range, and up
    assert found.sigma_bistatic_range_m == pytest.approx([2.5, 2.5], abs=0.1 + 1e-9)
    assert np.isnan(found.range_m).all()
    assert (found.category.tolist(), found.sic.tolist()) == ([15, 15], [14, 14])


def test_heights_of_048_are_altitudes() -> None:
    own = Plots.of(
        t_utc_ns=PLOTS.t_utc_ns,
        range_m=np.array([1852.0, 3704.0]),
        azimuth_deg=PLOTS.azimuth_deg,
        height_m=np.array([304.8, 304.8]),
    )
    (payload,) = PlotEncoder048(25, 13).blocks(own)
    found = plots_in_asterix(payload, T_NS)
    assert found.range_m.tolist() == [1852.0, 3704.0]
    assert found.altitude_m == pytest.approx([304.8, 304.8])
    assert np.isnan(found.height_m).all()
    assert (found.channel == NOT_TOLD).all()


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

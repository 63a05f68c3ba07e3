"""Plots of a recording beside their truth, whatever order their messages come in."""

from __future__ import annotations

import numpy as np
import pytest
from support.recordings import START_NS, message

from plotfeed.feeds.recording import recorded_plots
from plotfeed.feeds.recording.recorded_plots import (
    SectorKey,
    SectorPlots,
    WaitingPlots,
    plot_topics,
    plots_in_rows,
    sector_plots,
)
from plotfeed.models.state import Ints, Plots
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.cat048 import PlotEncoder048
from plotfeed.replay.recorded import Recorded

KEY = SectorKey("plotfeed", "north", 7, 3)


def block(number: int, *ranges_m: float) -> Recorded:
    plots = Plots.of(
        t_utc_ns=np.full(len(ranges_m), START_NS),
        range_m=np.array(ranges_m),
        azimuth_deg=np.zeros(len(ranges_m)),
    )
    (payload,) = PlotEncoder048(25, 13).blocks(plots)
    properties = (("scan", "7"), ("sector", "3"), ("id", f"asterix-048-7-3-{number}"))
    return message(payload, topic="plotfeed/north/asterix/048", properties=properties)


def batch(*times_ns: int) -> Recorded:
    plots = [pb.Plot(time_utc_ns=t_ns, range_m=1852.0) for t_ns in times_ns]
    told = pb.PlotBatch(sensor="north", scan=7, sector=3, plots=plots)
    return message(told.SerializeToString(), topic="plotfeed/north/plots")


def plots_of(message: Recorded, sensor: str = "north") -> list[SectorPlots]:
    return list(sector_plots([message], lambda _: ("plotfeed", sensor)))


def waiting(*messages: Recorded) -> WaitingPlots:
    plots = WaitingPlots()
    for each in messages:
        for found in plots_of(each):
            plots.add(found)
    return plots


def truth(*times_ns: int) -> Ints:
    return np.array(times_ns, np.int64)


def test_blocks_of_a_sector_are_in_order_and_duplicates_count_once() -> None:
    plots = waiting(block(1, 1852.0), block(0, 3704.0, 5556.0), block(1, 1852.0))
    assert plots.count(KEY) == 3
    found = plots.take(KEY, truth(START_NS, START_NS, START_NS))
    assert found is not None
    assert plots_in_rows(found).range_m.tolist() == [3704.0, 5556.0, 1852.0]
    assert plots.count(KEY) == 0


def test_plots_that_contradict_the_ledger_are_given_up() -> None:
    assert waiting(block(0, 1852.0)).take(KEY, truth(1, 2)) is None
    assert waiting(batch(5, 6)).take(KEY, truth(5, 7)) is None
    found = waiting(batch(5, 6)).take(KEY, truth(5, 6))
    assert found is not None
    assert plots_in_rows(found).t_utc_ns.tolist() == [5, 6]
    assert waiting(batch()).take(KEY, truth()) == []  # neither has any


def test_the_oldest_plots_give_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorded_plots, "MAX_WAITING_PLOTS", 3)
    plots = waiting(batch(1, 2))
    (later,) = plots_of(block(0, 1852.0, 1852.0), "south")
    plots.add(later)
    assert (plots.count(KEY), plots.count(later.key)) == (0, 2)


def test_plots_are_looked_for_where_most_is_said_and_what_cannot_be_read_is_passed_over() -> None:
    assert plot_topics()[:4] == ["plots", "asterix/015", "asterix/048", "asterix/205"]
    assert "sapient" not in plot_topics()
    for payload, topic in ((b"\xff", "plots"), (block(0, 1852.0).payload, "asterix/048")):
        assert plots_of(message(payload, topic=f"plotfeed/north/{topic}")) == []

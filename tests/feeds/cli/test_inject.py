from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.cli.inject import MAX_SPEED, retimed
from plotfeed.feeds.telemetry.flights.flight import Flight
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

S = 1_000_000_000


def flight(*t_s: float) -> Flight:
    reports = [
        PositionReport(
            t_utc_ns=round(t * S),
            latitude_deg=50.0 + t * 1e-5,
            longitude_deg=3.0,
            altitude_m=100.0,
            altitude_reference=AltitudeReference.ELLIPSOID,
            velocity_enu_m_s=(1.0, 2.0, math.nan),
            velocity_accuracy_m_s=0.5,
        )
        for t in t_s
    ]
    return Flight(name="a", reports=tuple(reports))


def test_at_its_own_tempo_and_time_nothing_changes() -> None:
    flown = flight(1000.1, 1000.3, 1002.7)
    assert list(retimed(flown)) == list(flown.reports)


def test_a_shifted_flight_keeps_its_intervals() -> None:
    due = [r.t_utc_ns for r in retimed(flight(1000, 1001, 1003), start_utc_ns=7 * S)]
    assert due == [7 * S, 8 * S, 10 * S]


def test_twice_as_fast_halves_the_intervals_and_doubles_the_velocity() -> None:
    sent = list(retimed(flight(1000, 1001, 1003), speed=2.0, start_utc_ns=7 * S))
    assert [r.t_utc_ns for r in sent] == [7 * S, 7 * S + S // 2, 8 * S + S // 2]
    assert repr(sent[0].velocity_enu_m_s) == "(2.0, 4.0, nan)"
    assert sent[0].velocity_accuracy_m_s == 1.0


@given(
    st.lists(st.floats(0, 1e6), min_size=1, max_size=20, unique_by=lambda t: round(t, 4)),
    st.floats(0.01, MAX_SPEED),
)
def test_reports_stay_in_order(t_s: list[float], speed: float) -> None:
    flown = flight(*sorted(t_s))
    sent = list(retimed(flown, speed=speed, start_utc_ns=S))
    assert len(sent) == len(t_s)
    assert all(a.t_utc_ns < b.t_utc_ns for a, b in pairwise(sent))
    assert sent[0].t_utc_ns == S


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan, math.inf, MAX_SPEED + 1])
def test_a_speed_that_cannot_be_is_refused_at_once(speed: float) -> None:
    with pytest.raises(PlotfeedError, match="speed"):
        retimed(flight(1.0), speed=speed)

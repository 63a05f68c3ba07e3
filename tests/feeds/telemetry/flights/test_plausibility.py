from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.flights.flight import Courses, Log, courses
from plotfeed.feeds.telemetry.flights.smoothed import smoothed
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.models.state import AltitudeReference


def report(i: int, *, latitude_deg: float = 50.0, altitude_m: float = 100.0) -> PositionReport:
    return PositionReport(
        t_utc_ns=i * 200_000_000,
        latitude_deg=latitude_deg + i * 1e-5,
        longitude_deg=180.0 - (i % 2) * 360.0,
        altitude_m=altitude_m,
        altitude_reference=AltitudeReference.MEAN_SEA_LEVEL,
    )


@given(st.sets(st.integers(0, 39), max_size=9), st.booleans())
def test_wrong_fixes_are_found_wherever_they_are(wrong: set[int], high: bool) -> None:
    reports = [
        report(i, altitude_m=100.0 + 900.0 * high, latitude_deg=50.0 + 2.0 * (not high))
        if i in wrong
        else report(i)
        for i in range(40)
    ]
    assert courses(reports).refused.keys() == wrong


def test_steps_of_a_coarse_log_are_plausible() -> None:
    coarse = [report(i, latitude_deg=50.0 + (i // 5) * 1e-4 - i * 1e-5) for i in range(40)]
    assert courses(coarse) == Courses({})


def test_nothing_is_implausible_in_nothing() -> None:
    assert courses([]) == Courses({})


def test_a_jump_that_persists_is_a_new_start() -> None:
    jumped = [report(i, latitude_deg=50.0 + 0.02 * (i >= 20)) for i in range(100)]
    assert courses(jumped) == Courses({}, starts=(20,))


def test_a_jump_there_and_back_is_skipped_as_long_as_most_are_right() -> None:
    jumped = [report(i, latitude_deg=50.0 + 0.02 * (20 <= i < 40)) for i in range(100)]
    assert courses(jumped).refused.keys() == set(range(20, 40))


def test_of_two_sources_in_one_file_the_minority_is_skipped_and_told() -> None:
    both = [report(i, latitude_deg=50.0 + 0.02 * (i % 3 == 0)) for i in range(90)]
    found = courses(both)
    assert found.refused.keys() == set(range(0, 90, 3))
    assert (found.starts, found.second) == ((), 30)


def test_how_fast_a_drone_flies_may_be_said() -> None:
    fast = [report(i, latitude_deg=50.0 + i * 1e-3) for i in range(40)]
    assert courses(fast, 600.0).refused == {}
    assert len(courses(fast, 100.0).refused) > 20


def test_nothing_leads_from_before_a_new_start_to_it_and_no_speed_is_taken_for_it() -> None:
    log = Log()
    for i in range(60):
        one = report(i, latitude_deg=50.0 + 0.02 * (i >= 30))
        log.found.append((f"line {i}", one))
    flight = log.flight("a")
    assert flight.starts == (30,)
    assert "new start" in flight.assumed[0]
    for one in smoothed(flight).reports:
        assert np.hypot(*one.velocity_enu_m_s[:2]) < 10.0

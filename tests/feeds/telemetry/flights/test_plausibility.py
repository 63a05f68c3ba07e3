from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.flights.flight import distance_m, implausible
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


def test_a_degree_of_latitude_and_the_antimeridian() -> None:
    assert distance_m(report(0), report(0, latitude_deg=51.0)) == pytest.approx(111_195, rel=1e-4)
    assert distance_m(report(0), report(1)) == pytest.approx(1.112, rel=1e-3)


@given(st.sets(st.integers(0, 39), max_size=9), st.booleans())
def test_wrong_fixes_are_found_wherever_they_are(wrong: set[int], high: bool) -> None:
    reports = [
        report(i, altitude_m=100.0 + 900.0 * high, latitude_deg=50.0 + 2.0 * (not high))
        if i in wrong
        else report(i)
        for i in range(40)
    ]
    assert implausible(reports).keys() == wrong


def test_steps_of_a_coarse_log_are_plausible() -> None:
    coarse = [report(i, latitude_deg=50.0 + (i // 5) * 1e-4 - i * 1e-5) for i in range(40)]
    assert implausible(coarse) == {}


def test_nothing_is_implausible_in_nothing() -> None:
    assert implausible([]) == {}

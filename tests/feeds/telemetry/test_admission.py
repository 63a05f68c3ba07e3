from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.position_report import PositionReport, Reason, Refused
from plotfeed.feeds.telemetry.receiver import Admission
from plotfeed.models.state import AltitudeReference

S = 1_000_000_000
NOW = 1_700_000_000 * S
REPORT = PositionReport(
    t_utc_ns=NOW,
    latitude_deg=40.0,
    longitude_deg=-3.0,
    altitude_m=700.0,
    altitude_reference=AltitudeReference.ELLIPSOID,
)


def at(t_utc_ns: int) -> PositionReport:
    return replace(REPORT, t_utc_ns=t_utc_ns)


def reason(admission: Admission, drone: str, report: PositionReport) -> Reason:
    with pytest.raises(Refused) as caught:
        admission.admit(drone, report, NOW)
    return caught.value.reason


def test_each_drone_has_its_own_time() -> None:
    admission = Admission()
    admission.admit("a", at(NOW), NOW)
    admission.admit("b", at(NOW - S), NOW)
    assert reason(admission, "a", at(NOW)) is Reason.DUPLICATE
    assert reason(admission, "a", at(NOW - 1)) is Reason.BACKWARDS
    admission.admit("b", at(NOW), NOW)


def test_a_refused_report_does_not_move_the_drones_time() -> None:
    admission = Admission(max_ahead_s=2.0)
    assert reason(admission, "a", at(NOW + 3 * S)) is Reason.FUTURE
    admission.admit("a", at(NOW + 2 * S), NOW)


def test_age_is_limited_only_where_asked() -> None:
    Admission().admit("a", at(0), NOW)
    assert reason(Admission(max_age_s=5), "a", at(NOW - 6 * S)) is Reason.STALE
    Admission(max_age_s=5).admit("a", at(NOW - 5 * S), NOW)


def test_a_drone_beyond_the_most_is_refused() -> None:
    admission = Admission(max_drones=1)
    admission.admit("a", at(NOW - 1), NOW)
    assert reason(admission, "b", REPORT) is Reason.TOO_MANY_DRONES
    admission.admit("a", REPORT, NOW)


@pytest.mark.parametrize("name", ["", "a/b", "+", "a#", "a\0", "a\n", "x" * 65, "\ud800"])
def test_names_that_no_topic_can_carry_are_refused(name: str) -> None:
    assert reason(Admission(), name, REPORT) is Reason.NAME


def test_other_names_are_taken() -> None:
    for name in ("phantom-4", "Σ 1", "x" * 64):
        Admission().admit(name, REPORT, NOW)


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(NOW - 9, NOW)), max_size=40))
def test_what_is_admitted_runs_forward(
    arrivals: list[tuple[str, int]],
) -> None:
    admission, last = Admission(), dict[str, int]()
    for drone, t_utc_ns in arrivals:
        try:
            admission.admit(drone, at(t_utc_ns), NOW)
        except Refused:
            assert t_utc_ns <= last[drone]
        else:
            assert t_utc_ns > last.get(drone, 0)
            last[drone] = t_utc_ns

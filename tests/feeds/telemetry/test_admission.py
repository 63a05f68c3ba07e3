from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.admission import Admission
from plotfeed.feeds.telemetry.position_report import PositionReport, Reason, Refused, ReportRow
from plotfeed.models.state import AltitudeReference

S = 1_000_000_000
NOW = 1_700_000_000 * S


def admit(admission: Admission, drone: str, t_utc_ns: int) -> None:
    hovering = PositionReport(
        t_utc_ns=t_utc_ns,
        latitude_deg=40.0,
        longitude_deg=-3.0,
        altitude_m=700.0,
        altitude_reference=AltitudeReference.ELLIPSOID,
    )
    assert not admission.admit(drone, ReportRow.of(hovering), NOW)


def reason(admission: Admission, drone: str, t_utc_ns: int) -> Reason:
    with pytest.raises(Refused) as caught:
        admit(admission, drone, t_utc_ns)
    return caught.value.reason


def test_each_drone_has_its_own_time() -> None:
    admission = Admission()
    admit(admission, "a", NOW)
    admit(admission, "b", NOW - S)
    assert reason(admission, "a", NOW) is Reason.DUPLICATE
    assert reason(admission, "a", NOW - 1) is Reason.BACKWARDS
    admit(admission, "b", NOW)


def test_a_refused_report_does_not_move_the_drones_time() -> None:
    admission = Admission(max_ahead_s=2.0)
    assert reason(admission, "a", NOW + 3 * S) is Reason.FUTURE
    admit(admission, "a", NOW + 2 * S)


def test_age_is_limited_only_where_asked() -> None:
    admit(Admission(), "a", 0)
    assert reason(Admission(max_age_s=5), "a", NOW - 6 * S) is Reason.STALE
    admit(Admission(max_age_s=5), "a", NOW - 5 * S)
    assert reason(Admission(max_age_s=5, max_late_s=3), "a", NOW - 4 * S) is Reason.LATE
    assert reason(Admission(max_age_s=5, max_late_s=3), "a", NOW - 6 * S) is Reason.STALE
    admit(Admission(max_age_s=5, max_late_s=3), "a", NOW - 3 * S)


def test_a_drone_beyond_the_most_is_refused() -> None:
    admission = Admission(max_drones=1)
    admit(admission, "a", NOW - 1)
    assert reason(admission, "b", NOW) is Reason.TOO_MANY_DRONES
    admit(admission, "a", NOW)


@pytest.mark.parametrize("name", ["", "a/b", "+", "a#", "a\0", "a\n", "x" * 65, "\ud800"])
def test_names_that_no_topic_can_carry_are_refused(name: str) -> None:
    assert reason(Admission(), name, NOW) is Reason.NAME


def test_other_names_are_taken() -> None:
    for name in ("phantom-4", "Σ 1", "x" * 64):
        admit(Admission(), name, NOW)


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(NOW - 9, NOW)), max_size=40))
def test_what_is_admitted_runs_forward(arrivals: list[tuple[str, int]]) -> None:
    admission, last = Admission(), dict[str, int]()
    for drone, t_utc_ns in arrivals:
        try:
            admit(admission, drone, t_utc_ns)
        except Refused:
            assert t_utc_ns <= last[drone]
        else:
            assert t_utc_ns > last.get(drone, 0)
            last[drone] = t_utc_ns

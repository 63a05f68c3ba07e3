from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.position_report import Reason, Refused
from plotfeed.feeds.telemetry.receiver import Admission

S = 1_000_000_000
NOW = 1_700_000_000 * S


def reason(admission: Admission, drone: str, t_utc_ns: int) -> Reason:
    with pytest.raises(Refused) as caught:
        admission.admit(drone, t_utc_ns, NOW)
    return caught.value.reason


def test_each_drone_has_its_own_time() -> None:
    admission = Admission()
    admission.admit("a", NOW, NOW)
    admission.admit("b", NOW - S, NOW)
    assert reason(admission, "a", NOW) is Reason.DUPLICATE
    assert reason(admission, "a", NOW - 1) is Reason.BACKWARDS
    admission.admit("b", NOW, NOW)


def test_a_refused_report_does_not_move_the_drones_time() -> None:
    admission = Admission(max_ahead_s=2.0)
    assert reason(admission, "a", NOW + 3 * S) is Reason.FUTURE
    admission.admit("a", NOW + 2 * S, NOW)


def test_age_is_limited_only_where_asked() -> None:
    Admission().admit("a", 0, NOW)
    assert reason(Admission(max_age_s=5), "a", NOW - 6 * S) is Reason.STALE
    Admission(max_age_s=5).admit("a", NOW - 5 * S, NOW)
    assert reason(Admission(max_age_s=5, max_late_s=3), "a", NOW - 4 * S) is Reason.LATE
    assert reason(Admission(max_age_s=5, max_late_s=3), "a", NOW - 6 * S) is Reason.STALE
    Admission(max_age_s=5, max_late_s=3).admit("a", NOW - 3 * S, NOW)


def test_a_drone_beyond_the_most_is_refused() -> None:
    admission = Admission(max_drones=1)
    admission.admit("a", NOW - 1, NOW)
    assert reason(admission, "b", NOW) is Reason.TOO_MANY_DRONES
    admission.admit("a", NOW, NOW)


@pytest.mark.parametrize("name", ["", "a/b", "+", "a#", "a\0", "a\n", "x" * 65, "\ud800"])
def test_names_that_no_topic_can_carry_are_refused(name: str) -> None:
    assert reason(Admission(), name, NOW) is Reason.NAME


def test_other_names_are_taken() -> None:
    for name in ("phantom-4", "Σ 1", "x" * 64):
        Admission().admit(name, NOW, NOW)


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(NOW - 9, NOW)), max_size=40))
def test_what_is_admitted_runs_forward(
    arrivals: list[tuple[str, int]],
) -> None:
    admission, last = Admission(), dict[str, int]()
    for drone, t_utc_ns in arrivals:
        try:
            admission.admit(drone, t_utc_ns, NOW)
        except Refused:
            assert t_utc_ns <= last[drone]
        else:
            assert t_utc_ns > last.get(drone, 0)
            last[drone] = t_utc_ns

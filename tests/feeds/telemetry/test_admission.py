from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.scene.telemetry_keys import Telemetry
from plotfeed.feeds.telemetry.admission import Admission
from plotfeed.feeds.telemetry.position_report import PositionReport, Reason, Refused
from plotfeed.models.state import AltitudeReference

S = 1_000_000_000
NOW = 1_700_000_000 * S


def admission(look_back_s: float = 1000.0, **keys: Any) -> Admission:
    return Admission(Telemetry(stale_after_s=2.0, **keys), look_back_s)


def admit(door: Admission, drone: str, t_utc_ns: int) -> None:
    hovering = PositionReport(
        t_utc_ns=t_utc_ns,
        latitude_deg=40.0,
        longitude_deg=-3.0,
        altitude_m=700.0,
        altitude_reference=AltitudeReference.ELLIPSOID,
    )
    assert not door.admit(drone, hovering, NOW)


def reason(door: Admission, drone: str, t_utc_ns: int) -> Reason:
    with pytest.raises(Refused) as caught:
        admit(door, drone, t_utc_ns)
    return caught.value.reason


def test_each_drone_has_its_own_time() -> None:
    door = admission()
    admit(door, "a", NOW)
    admit(door, "b", NOW - S)
    assert reason(door, "a", NOW) is Reason.DUPLICATE
    assert reason(door, "a", NOW - 1) is Reason.BACKWARDS
    admit(door, "b", NOW)


def test_a_refused_report_does_not_move_the_drones_time() -> None:
    door = admission(max_ahead_s=2.0)
    assert reason(door, "a", NOW + 3 * S) is Reason.FUTURE
    admit(door, "a", NOW + 2 * S)


def test_age_is_limited_by_the_scene_and_by_what_can_still_be_seen() -> None:
    assert reason(admission(max_age_s=5.0), "a", NOW - 6 * S) is Reason.STALE
    admit(admission(max_age_s=5.0), "a", NOW - 5 * S)
    assert reason(admission(1.0, max_age_s=5.0), "a", NOW - 4 * S) is Reason.LATE
    assert reason(admission(1.0, max_age_s=5.0), "a", NOW - 6 * S) is Reason.STALE
    admit(admission(1.0, max_age_s=5.0), "a", NOW - 3 * S)


def test_a_drone_beyond_the_most_is_refused() -> None:
    door = admission(max_drones=1)
    admit(door, "a", NOW - 1)
    assert reason(door, "b", NOW) is Reason.TOO_MANY_DRONES
    admit(door, "a", NOW)


@pytest.mark.parametrize("name", ["", "a/b", "+", "a#", "a\0", "a\n", "x" * 65, "\ud800"])
def test_names_that_no_topic_can_carry_are_refused(name: str) -> None:
    assert reason(admission(), name, NOW) is Reason.NAME


def test_other_names_are_taken() -> None:
    for name in ("phantom-4", "Σ 1", "x" * 64):
        admit(admission(), name, NOW)


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(NOW - 9, NOW)), max_size=40))
def test_what_is_admitted_runs_forward(arrivals: list[tuple[str, int]]) -> None:
    door, last = admission(), dict[str, int]()
    for drone, t_utc_ns in arrivals:
        try:
            admit(door, drone, t_utc_ns)
        except Refused:
            assert t_utc_ns <= last[drone]
        else:
            assert t_utc_ns > last.get(drone, 0)
            last[drone] = t_utc_ns

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.scene.sea_level import SeaLevel
from plotfeed.feeds.scene.telemetry_keys import Telemetry
from plotfeed.feeds.telemetry.admission import Admission
from plotfeed.feeds.telemetry.position_report import AltitudeDatum, PositionReport, Reason, Refused
from plotfeed.models.frames import geoid_undulation_m
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


REFERENCES = list(AltitudeReference)
LATITUDES, LONGITUDES = [40.45, 5.0, -8.0], [-3.73, 79.0, 147.0]


def heights(datum: AltitudeDatum, reference: AltitudeReference) -> list[float]:
    found: list[float] = datum.heights_m(LATITUDES, LONGITUDES, [100.0] * 3, [reference] * 3)
    return list(found)


def test_each_reference_gives_a_height_above_the_ellipsoid() -> None:
    datum = AltitudeDatum(takeoff_height_m=650.0, sea_level=SeaLevel(51.0))
    assert heights(datum, AltitudeReference.ELLIPSOID) == [100.0] * 3
    assert heights(datum, AltitudeReference.ABOVE_TAKEOFF) == [750.0] * 3
    assert heights(datum, AltitudeReference.MEAN_SEA_LEVEL) == [151.0] * 3


def test_sea_level_is_that_of_each_place_unless_it_is_stated() -> None:
    found = heights(AltitudeDatum(), AltitudeReference.MEAN_SEA_LEVEL)
    assert found == list(100.0 + geoid_undulation_m(LATITUDES, LONGITUDES))
    assert np.ptp(found) > 150.0


def test_references_may_be_mixed() -> None:
    datum = AltitudeDatum(650.0)
    found = datum.heights_m(LATITUDES, LONGITUDES, [100.0] * 3, REFERENCES)
    for i, reference in enumerate(REFERENCES):
        assert found[i] == heights(datum, reference)[i]


def test_without_a_takeoff_height_the_key_is_named() -> None:
    for reference in REFERENCES:
        AltitudeDatum(650.0).check(reference)
    AltitudeDatum().check(AltitudeReference.MEAN_SEA_LEVEL)
    with pytest.raises(Refused, match=r"telemetry\.takeoff_height_m") as caught:
        AltitudeDatum().check(AltitudeReference.ABOVE_TAKEOFF)
    assert caught.value.reason is Reason.ALTITUDE

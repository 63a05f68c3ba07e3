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


def test_each_drone_has_its_own_time_which_a_refused_report_does_not_move() -> None:
    door = admission(max_ahead_s=2.0)
    assert reason(door, "phantom-4", NOW + 3 * S) is Reason.FUTURE
    admit(door, "phantom-4", NOW + 2 * S)
    admit(door, "Σ 1", NOW - S)
    assert reason(door, "phantom-4", NOW + 2 * S) is Reason.DUPLICATE
    assert reason(door, "phantom-4", NOW + 2 * S - 1) is Reason.BACKWARDS
    admit(door, "Σ 1", NOW)


def test_age_is_limited_by_the_scene_and_by_what_can_still_be_seen() -> None:
    assert reason(admission(max_age_s=5.0), "a", NOW - 6 * S) is Reason.STALE
    admit(admission(max_age_s=5.0), "a", NOW - 5 * S)
    assert reason(admission(1.0, max_age_s=5.0), "a", NOW - 4 * S) is Reason.LATE
    assert reason(admission(1.0, max_age_s=5.0), "a", NOW - 6 * S) is Reason.STALE
    admit(admission(1.0, max_age_s=5.0), "x" * 64, NOW - 3 * S)


@pytest.mark.parametrize("name", ["", "a/b", "+", "a#", "a\0", "a\n", "x" * 65, "\ud800"])
def test_names_that_no_topic_can_carry_are_refused(name: str) -> None:
    assert reason(admission(), name, NOW) is Reason.NAME


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


REFERENCES = [*AltitudeReference, *AltitudeReference]
LATITUDES, LONGITUDES = [40.45, 5.0, -8.0] * 2, [-3.73, 79.0, 147.0, 147.0, -3.73, 79.0]


@pytest.mark.parametrize("sea_level_m", [None, 51.0])
def test_each_reference_gives_a_height_above_the_ellipsoid_there(sea_level_m: float | None) -> None:
    """Sea level is that of each place unless it is stated."""
    sea_m = geoid_undulation_m(LATITUDES, LONGITUDES) if sea_level_m is None else np.full(6, 51.0)
    assert sea_level_m or np.ptp(sea_m) > 150.0
    datum = AltitudeDatum(650.0, SeaLevel(sea_level_m))
    above_m = {AltitudeReference.ABOVE_TAKEOFF: 650.0, AltitudeReference.ELLIPSOID: 0.0}
    expected = [100.0 + above_m.get(r, m) for r, m in zip(REFERENCES, sea_m, strict=True)]
    assert list(datum.heights_m(LATITUDES, LONGITUDES, [100.0] * 6, REFERENCES)) == expected


def test_without_a_takeoff_height_the_key_is_named() -> None:
    for reference in REFERENCES:
        AltitudeDatum(650.0).check(reference)
    AltitudeDatum().check(AltitudeReference.MEAN_SEA_LEVEL)
    with pytest.raises(Refused, match=r"telemetry\.takeoff_height_m") as caught:
        AltitudeDatum().check(AltitudeReference.ABOVE_TAKEOFF)
    assert caught.value.reason is Reason.ALTITUDE

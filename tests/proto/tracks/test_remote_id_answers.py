"""A service of network Remote ID tells of what it heard of in the last minute, and no more."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.live.remote_id import report_of_flight
from plotfeed.proto.tracks.remote_id_answers import (
    MAX_DETAILED_DIAGONAL_M,
    DisplayArea,
    KnownFlights,
)
from plotfeed.proto.utc import NS, iso_utc_ms

NOW = 1_767_225_600 * NS
SMALL = DisplayArea.parse("40.44,-3.74,40.45,-3.73")
LARGE = DisplayArea.parse("40.42,-3.76,40.46,-3.72")


def flight(name: str, lat: float, lng: float, age_s: float = 0.0) -> dict[str, Any]:
    stamp = {"value": iso_utc_ms(NOW - round(age_s * NS)), "format": "RFC3339"}
    position = {"lat": lat, "lng": lng, "alt": 700.0, "accuracy_h": "HA3m", "accuracy_v": "VA3m"}
    motion = {"track": 90.0, "speed": 5.0, "speed_accuracy": "SA1mps", "vertical_speed": 0.0}
    state = {"timestamp": stamp, "timestamp_accuracy": 0.0, "position": position, **motion}
    return {"id": name, "aircraft_type": "NotDeclared", "current_state": state}


def known(*flights: dict[str, Any]) -> KnownFlights:
    found = KnownFlights()
    for each in flights:
        found.take([each])
    return found


def ids(answer: dict[str, Any]) -> list[str]:
    return [each["id"] for each in answer["flights"]]


def test_flights_of_the_view_and_of_the_last_minute_are_told_of() -> None:
    found = known(
        flight("here", 40.445, -3.735),
        flight("elsewhere", 40.455, -3.735),
        flight("old", 40.445, -3.735, 60.1),
        flight("late", 40.445, -3.735, 59.9),
    )
    assert ids(found.flights(SMALL, NOW)) == ["here", "late"]
    assert ids(found.flights(SMALL, NOW + NS)) == ["here"]
    assert found.holds("here", NOW)
    assert not found.holds("old", NOW)


def test_the_latest_place_counts_and_those_before_are_told_of_where_asked() -> None:
    found = known(*(flight("a", 40.44 + 0.001 * i, -3.735, 10 - i) for i in range(10)))
    (told,) = found.flights(SMALL, NOW)["flights"]
    assert "recent_positions" not in told
    assert told["current_state"]["position"]["lat"] == pytest.approx(40.449)
    (told,) = found.flights(SMALL, NOW, recent_s=3.5)["flights"]
    places = [each["position"]["lat"] for each in told["recent_positions"]]
    assert places == pytest.approx([40.447, 40.448, 40.449])
    assert report_of_flight(told).latitude_deg == pytest.approx(40.449)


def test_displays_of_small_views_have_flights_with_their_paths() -> None:
    found = known(flight("a", 40.441, -3.735, 1), flight("a", 40.442, -3.735))
    assert SMALL.diagonal_m < MAX_DETAILED_DIAGONAL_M
    place = {"lng": -3.735, "alt": 700.0}
    before, latest = {"lat": 40.441, **place}, {"lat": 40.442, **place}
    path = [{"positions": [before, latest]}]
    told = {"id": "a", "most_recent_position": latest, "recent_paths": path}
    assert found.display_data(SMALL, NOW) == {"flights": [told], "clusters": []}


corner = st.tuples(st.floats(-80, 80), st.floats(-170, 170))


@given(
    corner,
    st.floats(0.02, 0.04),
    st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=12),
)
def test_displays_of_large_views_have_clusters_that_count_all_and_hide_places(
    at: tuple[float, float], size: float, places: list[tuple[float, float]]
) -> None:
    area = DisplayArea(at[0], at[1], at[0] + size, at[1] + size)
    north, east = area.north - area.south, area.east - area.west
    flights = [
        flight(str(n), area.south + up * north, area.west + right * east)
        for n, (up, right) in enumerate(places)
    ]
    inside = [f for f in flights if area.holds(f["current_state"]["position"])]
    told = known(*flights).display_data(area, NOW)
    assert told["flights"] == []
    assert sum(each["number_of_flights"] for each in told["clusters"]) == len(inside)
    for each in told["clusters"]:
        # NetMinClusterSizePercent: no cluster tells a place better than to 15 % of the view.
        assert each["area_sqm"] >= 0.15 * area.area_m2
        (low, high) = each["corners"]
        cell = DisplayArea(low["lat"], low["lng"], high["lat"], high["lng"])
        assert cell.area_m2 == pytest.approx(each["area_sqm"])


def test_diagonals_are_those_of_the_globe() -> None:
    assert DisplayArea.parse("0,0,0,1").diagonal_m == pytest.approx(111_195, abs=1)
    assert DisplayArea.parse("60,1,60,0").diagonal_m == pytest.approx(55_597, abs=5)
    assert DisplayArea.parse("1,0,0,0").diagonal_m == pytest.approx(111_195, abs=1)
    assert 5000 < LARGE.diagonal_m < 7000


@pytest.mark.parametrize("text", ["", "1,2,3", "a,b,c,d", "91,0,0,0", "nan,0,0,0", "0,0,0,inf"])
def test_views_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected"):
        DisplayArea.parse(text)


@pytest.mark.parametrize(
    "damaged",
    [{}, {"id": "a"}, "x", {"id": [], "current_state": {}}, flight("a", float("inf"), 0.0)],
)
def test_what_is_no_flight_is_refused_and_leaves_the_others(damaged: Any) -> None:
    found = known(flight("here", 40.445, -3.735))
    with pytest.raises((KeyError, TypeError, ValueError)):
        found.take([damaged])
    assert ids(found.flights(SMALL, NOW)) == ["here"]
    assert json.dumps(found.flights(SMALL, NOW), allow_nan=False)

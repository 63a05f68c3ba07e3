"""What messages of tracks say is what the tracks are, and what their schemas say they say."""

from __future__ import annotations

import json
import subprocess
import xml.etree.ElementTree as ET
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from pydantic import BaseModel, ConfigDict, Field
from support.told_tracks import RADAR, T_NS, any_tracks, told_tracks

from plotfeed.feeds.telemetry.live.remote_id import report_of_flight
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.json_schemas import JSON_SCHEMAS
from plotfeed.proto.tracks.encode_tracks import (
    UNKNOWN,
    LiveFeatures,
    ToldTracks,
    air_traffic,
    cot_events,
    f3411_flights,
    feature_collection,
    location_fixes,
    track_batch,
)
from plotfeed.proto.tracks.remote_id_answers import (
    MAX_DETAILED_DIAGONAL_M,
    DisplayArea,
    KnownFlights,
)
from plotfeed.proto.utc import NS, iso_utc_ms, utc_ns

# Flight Blender as a judge: https://github.com/openutm/flight-blender at 5d9b953b (27 July 2026);
# the bounds of a place are those of its edition 0a180613, which refuses others at the door.
MOST_INT64 = 2**63 - 1
# Timestamps above are in these units, others in seconds: repositories/flight_feed_repo.py.
MICROSECONDS_FROM, MILLISECONDS_FROM = 1e15, 1e12


class BlenderObservation(BaseModel):
    """`ObservationIn` of domain_types/flight_feed.py, within `ArrayOfObservations` of its API.

    The API's description (api/flight-blender-server-1.0.0-resolved.yaml) bounds the key's length,
    the sources 0 to 11, of which 5 is a primary radar, and both source types.
    """

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    lat_dd: Annotated[float, Field(ge=-90, le=90)]
    lon_dd: Annotated[float, Field(ge=-180, le=180)]
    altitude_mm: float
    icao_address: Annotated[str, Field(max_length=24)]
    traffic_source: Annotated[int, Field(ge=0, le=11)]
    timestamp: Annotated[int, Field(gt=0, le=MOST_INT64)]
    source_type: Literal[0, 1] = 0
    metadata: dict[str, Any] = Field(default_factory=dict)

    @property
    def sensor_time(self) -> datetime:
        """The UTC that it reads the timestamp as."""
        unit = 1.0
        if self.timestamp > MICROSECONDS_FROM:
            unit = 1e-6
        elif self.timestamp > MILLISECONDS_FROM:
            unit = 1e-3
        return datetime.fromtimestamp(self.timestamp * unit, tz=UTC)


class _Body(BaseModel):
    """`ObservationRequest` of the same file."""

    observations: list[BlenderObservation]


def judged(body: bytes) -> list[BlenderObservation]:
    """What it takes of a body; raises `ValueError` where it answers 422.

    It reads JSON as Python does, and types as pydantic does where it is not strict.
    """
    return _Body.model_validate(json.loads(body)).observations


names = st.text(
    st.characters(categories=("L", "M", "N", "P", "S"), exclude_characters="/+#"),
    min_size=1,
    max_size=64,
)
VALIDATORS = {name: Draft202012Validator(schema) for name, schema in JSON_SCHEMAS.items()}
BOUNDS_M = {"HA1m": 1, "HA3m": 3, "HA10m": 10, "HA30m": 30, "HA005NM": 92.6, "HA01NM": 185.2}
BOUNDS_M |= {"HA03NM": 555.6}


def in_json(schema: str, octets: bytes) -> Any:
    """What a message says, once its schema has had nothing against it."""
    found = json.loads(octets)
    VALIDATORS[schema].validate(found)
    return found


@pytest.mark.parametrize("name", JSON_SCHEMAS)
def test_schemas_are_schemas(name: str) -> None:
    Draft202012Validator.check_schema(JSON_SCHEMAS[name])


@settings(max_examples=30)
@given(any_tracks())
def test_protobuf_holds_every_number_unrounded(tracks: ToldTracks) -> None:
    batch = pb.TrackBatch.FromString(track_batch(tracks, RADAR, 17, 3))
    assert (batch.sensor, batch.scan, batch.sector, batch.kind) == ("radar", 17, 3, pb.PLAIN)
    for i, track in enumerate(batch.tracks):
        assert track.id == f"radar-{tracks.track[i]}"
        assert (track.number, track.time_utc_ns) == (tracks.track[i], T_NS)
        for field in pb.Track.DESCRIPTOR.fields:
            if field.name not in ("id", "number", "time_utc_ns"):
                expected = getattr(tracks, field.name)[i]
                assert not field.has_presence or track.HasField(field.name) != np.isnan(expected)
                if not np.isnan(expected):
                    assert getattr(track, field.name) == expected


@settings(max_examples=30)
@given(any_tracks(), names)
def test_events_of_cot_are_xml_that_names_a_track_and_says_what_is_not_known(
    tracks: ToldTracks, name: str
) -> None:
    """takproto reads the rest."""
    for i, octets in enumerate(cot_events(tracks, replace(RADAR, sensor=name))):
        event = ET.fromstring(octets)  # noqa: S314 - our own
        assert event.attrib["uid"] == f"{name}-{tracks.track[i]}"
        assert utc_ns(event.attrib["start"]) == T_NS // 1_000_000 * 1_000_000
        point = event.find("point")
        assert point is not None
        is_flat = bool(np.isnan(tracks.height_m[i]))
        assert (point.attrib["hae"] == UNKNOWN) == (point.attrib["le"] == UNKNOWN) == is_flat


@settings(max_examples=30)
@given(any_tracks())
def test_geojson_has_a_point_for_each_track(tracks: ToldTracks) -> None:
    found = in_json("plotfeed.TrackFeatures", feature_collection(tracks, RADAR))
    for i, feature in enumerate(found["features"]):
        place = [tracks.longitude_deg[i], tracks.latitude_deg[i]]
        if not np.isnan(tracks.height_m[i]):
            place.append(tracks.height_m[i])
        assert feature["geometry"]["coordinates"] == pytest.approx(place, abs=0.01)
        assert feature["properties"]["last"] == tracks.last[i]


@settings(max_examples=30)
@given(any_tracks())
def test_foxgloves_messages_are_by_its_schemas(tracks: ToldTracks) -> None:
    for i, octets in enumerate(location_fixes(tracks, RADAR)):
        fix = in_json("foxglove.LocationFix", octets)
        assert fix["timestamp"]["sec"] * NS + fix["timestamp"]["nsec"] == T_NS
        assert fix["position_covariance"][0] == pytest.approx(tracks.sigma_east_m[i] ** 2)
        assert fix["latitude"] == tracks.latitude_deg[i]
    live = in_json("foxglove.GeoJSON", LiveFeatures().message(tracks, RADAR))
    shown = in_json("plotfeed.TrackFeatures", live["geojson"].encode())["features"]
    assert [feature["id"] for feature in shown] == [f"radar-{n}" for n in tracks.track]


def test_a_map_shows_all_tracks_that_live_whichever_sector_they_were_seen_in() -> None:
    tracks = told_tracks(4, np.random.default_rng(1)).but(last=np.zeros(4, np.bool_))
    live, numbers = LiveFeatures(), tracks.track.tolist()

    def shown(rows: list[int], after_s: float, *, last: bool = False) -> list[int]:
        some = tracks.rows(np.array(rows))
        some = some.but(t_utc_ns=some.t_utc_ns + round(after_s * NS), last=np.full(len(rows), last))
        found = json.loads(json.loads(live.message(some, RADAR))["geojson"])["features"]
        return [numbers.index(feature["properties"]["track"]) for feature in found]

    assert shown([0], 0.0) == [0]
    assert shown([1, 2], 0.5) == [0, 1, 2]
    assert shown([1], 1.0, last=True) == [0, 1, 2]  # once more, to say that it ends
    assert shown([3], 1.5) == [0, 2, 3]
    assert shown([3], 7.0) == [0, 2, 3]
    assert shown([3], 8.0) == [3]  # of the others nothing has come


# Before, milliseconds have too few digits to be told from seconds.
FROM_NS, UNTIL_NS = utc_ns("2001-09-10T00:00:00Z"), utc_ns("2200-01-01T00:00:00Z")


@settings(max_examples=30)
@given(any_tracks(), names, st.integers(FROM_NS, UNTIL_NS), st.sampled_from(["plain", "smoothed"]))
def test_what_is_posted_is_taken_and_means_what_was_measured(
    tracks: ToldTracks, name: str, t_ns: int, kind: str
) -> None:
    tracks = tracks.but(t_utc_ns=np.full(len(tracks), t_ns))
    origin = replace(RADAR, sensor=name, kind="plain" if kind == "plain" else "smoothed-truth")
    body = air_traffic(tracks, origin)
    in_json("plotfeed.AirTraffic", body)
    found = judged(body)
    assert len({each.icao_address for each in found}) == len(tracks)  # by which it keeps them apart
    for i, each in enumerate(found):
        assert each.lat_dd == pytest.approx(tracks.latitude_deg[i], abs=1e-8)
        assert each.lon_dd == pytest.approx(tracks.longitude_deg[i], abs=1e-8)
        height_mm = 1000 * np.nan_to_num(tracks.height_m[i])
        assert each.altitude_mm == pytest.approx(height_mm, abs=0.1)
        assert abs(each.sensor_time.timestamp() - t_ns / NS) < 0.002
        assert (each.traffic_source, each.source_type) == (5, 0)  # a primary radar, not fused
        # It keeps metadata as the text of JSON, and reads them again.
        kept = json.loads(json.dumps(each.metadata))
        assert kept["simulated"] is True
        assert kept["altitude_is_measured"] == (not np.isnan(tracks.height_m[i]))


def test_our_own_schema_promises_no_less_than_it_demands() -> None:
    ours: Any = JSON_SCHEMAS["plotfeed.AirTraffic"]["properties"]["observations"]["items"]
    theirs = BlenderObservation.model_json_schema()
    assert set(theirs["required"]) <= set(ours["required"])
    for key, demanded in theirs["properties"].items():
        promised = ours["properties"][key]
        assert promised["type"] == demanded.get("type", "integer"), key
        assert promised.get("maxLength") == demanded.get("maxLength"), key
        for bound in ("minimum", "maximum"):
            if key.endswith("_dd"):
                assert promised[bound] == demanded[bound], key


def test_places_at_the_edges_of_the_earth_are_taken_and_long_names_stay_apart() -> None:
    keys = set()
    for end, place in (("a", (90.0, 0.0)), ("b", (-90.0, 180.0)), ("c", (0.0, -180.0))):
        columns = zip(("latitude_deg", "longitude_deg"), np.array([place]).T, strict=True)
        tracks = told_tracks(1, np.random.default_rng(2)).but(**dict(columns))
        (found,) = judged(air_traffic(tracks, replace(RADAR, sensor="r" * 63 + end)))
        assert (found.lat_dd, found.lon_dd) == place
        keys.add(found.icao_address)
    assert len(keys) == 3


@settings(max_examples=30)
@given(any_tracks())
def test_f3411_says_what_is_not_known_in_its_words_and_bounds_errors(tracks: ToldTracks) -> None:
    found = in_json("plotfeed.F3411Flights", f3411_flights(tracks, RADAR))["flights"]
    for i, flight in enumerate(found):
        state, flat = flight["current_state"], bool(np.isnan(tracks.height_m[i]))
        place = state["position"]
        assert flight["simulated"]
        assert (place["alt"] == -1000.0) == (place["accuracy_v"] == "VAUnknown") == flat
        assert (state["vertical_speed"] == 63.0) == (flat or abs(tracks.climb_m_s[i]) > 62.0)
        bound_m = BOUNDS_M[place["accuracy_h"]]
        radius_m = 2.4477 * max(tracks.sigma_east_m[i], tracks.sigma_north_m[i])
        assert radius_m <= bound_m
        less = [m for m in BOUNDS_M.values() if m < bound_m]
        assert radius_m > max(less, default=0.0)


# Messages of tracks as takproto, InterUSS's uas-standards and foxglove-sdk read them.

ROOT = Path(__file__).parents[3]
PYTHON = ROOT / ".venv-utm" / "bin" / "python"
ORACLES = ROOT / "tests" / "support" / "utm_oracles.py"
TRACKS = told_tracks(5, np.random.default_rng(601))
FLAT = told_tracks(2, np.random.default_rng(602), has_height=False)


def read(kind: str, payloads: list[bytes]) -> list[dict[str, Any]]:
    if not PYTHON.exists():
        pytest.skip("takproto, uas-standards and foxglove-sdk are not here: make .venv-utm/.ready")
    lines = "".join(json.dumps([kind, payload.decode()]) + "\n" for payload in payloads)
    done = subprocess.run(
        [str(PYTHON), str(ORACLES)], input=lines, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_takproto_reads_where_a_track_is_and_how_it_moves() -> None:
    for i, event in enumerate(read("cot", cot_events(TRACKS, RADAR))):
        assert event["uid"] == event["callsign"] == f"radar-{TRACKS.track[i]}"
        assert (event["type"], event["how"]) == ("a-u-A-M-H-Q", "m-s")
        assert event["sendTime"] == T_NS // 1_000_000
        stays_ms = 0 if TRACKS.last[i] else 6000
        assert event["staleTime"] - event["sendTime"] == pytest.approx(stays_ms, abs=1)
        for name, column, off in (
            ("lat", TRACKS.latitude_deg, 1e-7),
            ("lon", TRACKS.longitude_deg, 1e-7),
            ("hae", TRACKS.height_m, 0.01),
            ("ce", TRACKS.sigma_level_m, 0.01),
            ("le", TRACKS.sigma_up_m, 0.01),
            ("speed", TRACKS.speed_m_s, 0.01),
            ("course", TRACKS.course_deg, 0.01),
        ):
            assert event[name] == pytest.approx(column[i], abs=off), name


def test_interuss_parses_flights_of_sensors_with_heights_and_without() -> None:
    found = read("f3411", [f3411_flights(TRACKS, RADAR), f3411_flights(FLAT, RADAR)])
    for answer, tracks in zip(found, (TRACKS, FLAT), strict=True):
        assert answer["ids"] == [f"radar-{number}" for number in tracks.track]
        assert answer["seconds"] == pytest.approx(T_NS / NS, abs=1e-3)
        assert answer["accuracy_h"].startswith("HA")
    assert found[1]["alt"] == -1000.0


def test_foxglove_knows_every_key_of_a_location_fix() -> None:
    for answer in read("location-fix", location_fixes(TRACKS, RADAR)):
        assert answer == {"name": "foxglove.LocationFix", "unknown": []}


def test_interuss_parses_what_a_service_of_remote_id_answers() -> None:
    flights = KnownFlights()
    flights.take(json.loads(f3411_flights(TRACKS, RADAR))["flights"])
    latitude, longitude = TRACKS.latitude_deg[0], TRACKS.longitude_deg[0]
    one = f"radar-{TRACKS.track[0]}"
    for size, shown in (
        (0.001, {"flights": [one], "clusters": []}),
        (0.02, {"flights": [], "clusters": [1]}),
    ):
        corners = (latitude - size, longitude - size, latitude + size, longitude + size)
        area = DisplayArea.parse(",".join(map(str, corners)))
        provider = flights.flights(area, T_NS, recent_s=60.0)
        (found,) = read("f3411", [json.dumps(provider).encode()])
        assert found["ids"] == [one]
        display = flights.display_data(area, T_NS)
        assert read("display-data", [json.dumps(display).encode()]) == [shown]


# A service of network Remote ID tells of what it heard of in the last minute, and no more.

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

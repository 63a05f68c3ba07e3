"""Every body of air traffic is one that Flight Blender takes, and understands as it is meant."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.flight_blender import BlenderObservation, judged
from support.told_tracks import NS, RADAR, any_tracks, told_tracks

from plotfeed.proto.json_schemas import JSON_SCHEMAS
from plotfeed.proto.tracks.encode_tracks import ToldTracks, air_traffic
from plotfeed.proto.utc import utc_ns

names = st.text(
    st.characters(categories=("L", "M", "N", "P", "S"), exclude_characters="/+#"),
    min_size=1,
    max_size=64,
)
# Before, milliseconds have too few digits to be told from seconds.
FROM_NS, UNTIL_NS = utc_ns("2001-09-10T00:00:00Z"), utc_ns("2200-01-01T00:00:00Z")
PLACES = {"pole": (90.0, 0.0), "south": (-90.0, 180.0), "date line": (0.0, -180.0)}
A_BODY = json.loads(air_traffic(told_tracks(1, np.random.default_rng(5)), RADAR))


@settings(max_examples=60)
@given(any_tracks(), names, st.integers(FROM_NS, UNTIL_NS), st.sampled_from(["plain", "smoothed"]))
def test_what_is_posted_is_taken_and_means_what_was_measured(
    tracks: ToldTracks, name: str, t_ns: int, kind: str
) -> None:
    tracks = tracks.but(t_utc_ns=np.full(len(tracks), t_ns))
    origin = replace(RADAR, sensor=name, kind="plain" if kind == "plain" else "smoothed-truth")
    found = judged(air_traffic(tracks, origin))
    assert len({each.icao_address for each in found}) == len(tracks)  # by which it keeps them apart
    for i, each in enumerate(found):
        assert each.lat_dd == pytest.approx(tracks.latitude_deg[i], abs=1e-8)
        assert each.lon_dd == pytest.approx(tracks.longitude_deg[i], abs=1e-8)
        height_mm = 1000 * np.nan_to_num(tracks.height_m[i])
        assert each.altitude_mm == pytest.approx(height_mm, abs=0.1)
        assert abs(each.sensor_time.timestamp() - t_ns / NS) < 0.002
        assert (each.traffic_source, each.source_type) == (5, 0)  # a primary radar, not fused
        # It keeps metadata as the text of JSON, and reads them again.
        assert json.loads(json.dumps(each.metadata))["simulated"] is True


@pytest.mark.parametrize("place", PLACES)
def test_places_at_the_edges_of_the_earth_are_taken(place: str) -> None:
    tracks = told_tracks(1, np.random.default_rng(6))
    latitude, longitude = (np.array([value]) for value in PLACES[place])
    (found,) = judged(
        air_traffic(tracks.but(latitude_deg=latitude, longitude_deg=longitude), RADAR)
    )
    assert (found.lat_dd, found.lon_dd) == PLACES[place]


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


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *((key, None) for key in ("lat_dd", "lon_dd", "altitude_mm", "icao_address", "timestamp")),
        ("traffic_source", None),
        ("traffic_source", 12),
        ("source_type", 2),
        ("timestamp", 1_700_000_000.5),
        ("timestamp", 0),
        ("lat_dd", 90.1),
        ("lon_dd", float("nan")),
        ("altitude_mm", "high"),
        ("icao_address", "x" * 25),
        ("icao_address", 17),
        ("metadata", "{}"),
    ],
)
def test_the_judge_refuses_what_flight_blender_refuses(key: str, value: object) -> None:
    (each,) = A_BODY["observations"]
    wrong = {**each, key: value}
    if value is None:
        del wrong[key]
    with pytest.raises(ValueError, match=key):
        judged(json.dumps({"observations": [wrong]}).encode())
    assert judged(json.dumps({"observations": [each, {**each, "more": 1}]}).encode())

"""Messages of tracks as takproto, InterUSS's uas-standards and foxglove-sdk read them."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.told_tracks import NS, RADAR, T_NS, told_tracks

from plotfeed.proto.tracks.encode_tracks import cot_events, f3411_flights, location_fixes
from plotfeed.proto.tracks.remote_id_answers import DisplayArea, KnownFlights

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
    for size in (0.001, 0.02):
        corners = (latitude - size, longitude - size, latitude + size, longitude + size)
        area = DisplayArea.parse(",".join(map(str, corners)))
        provider = flights.flights(area, T_NS, recent_s=60.0)
        (found,) = read("f3411", [json.dumps(provider).encode()])
        assert found["ids"] == [f"radar-{TRACKS.track[0]}"]
        (found,) = read("display-data", [json.dumps(flights.display_data(area, T_NS)).encode()])
        if size == 0.001:
            assert found == {"flights": [f"radar-{TRACKS.track[0]}"], "clusters": []}
        else:
            assert found == {"flights": [], "clusters": [1]}

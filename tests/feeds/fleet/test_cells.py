"""Telemetry by cells: whoever may sense a drone hears of it, and nobody far away does."""

from __future__ import annotations

import json
import random
import time
from datetime import UTC, datetime
from typing import Any

import pytest
from support.every_kind import SENSORS
from support.road import SITE, radar, scene, staring

from plotfeed.feeds.fleet.cells import NOWHERE, cell_at, cell_of, cells_of, filters_of, reach_of
from plotfeed.feeds.session.session_part import plain_topic
from plotfeed.models.frames import aer_to_enu

pytest.importorskip("h3")


def report(latitude_deg: float, longitude_deg: float) -> bytes:
    at = datetime.fromtimestamp(time.time(), UTC)
    told = {
        "time_utc": f"{at:%Y-%m-%dT%H:%M:%S}Z", "altitude_m": 900.0,
        "altitude_reference": "ELLIPSOID", "latitude_deg": latitude_deg,
        "longitude_deg": longitude_deg,
    }  # fmt: skip
    return json.dumps(told).encode()


def place(azimuth_deg: float, range_m: float) -> tuple[float, float]:
    latitude_deg, longitude_deg, _ = SITE.to_geodetic(aer_to_enu(azimuth_deg, 0.5, range_m))
    return float(latitude_deg), float(longitude_deg)


@pytest.mark.parametrize("kind", SENSORS)
@pytest.mark.parametrize("resolution", [4, 6, 7])
def test_every_place_in_reach_of_a_sensor_is_in_one_of_its_cells(
    kind: str, resolution: int
) -> None:
    by_chance = random.Random(f"{kind}{resolution}")  # noqa: S311
    made = scene([SENSORS[kind]], seed=1)
    cells = cells_of(made, made.sensor[0], resolution)
    reach_m = reach_of(made, made.sensor[0])
    for _ in range(300):
        range_m = reach_m * by_chance.uniform(0, 1) ** 0.2
        assert cell_at(*place(by_chance.uniform(0, 360), range_m), resolution) in cells


def test_what_is_far_away_is_in_none_of_them() -> None:
    made = scene([radar(scan=staring(), range_max_m=10_000.0)], seed=1)
    cells = cells_of(made, made.sensor[0], 6)
    assert cell_at(*place(30.0, 40_000.0), 6) not in cells
    assert len(cells) < 60


def test_a_worker_subscribes_to_its_cells_and_who_leads_to_what_cannot_be_read() -> None:
    far = {"position_enu_m": [100_000.0, 0.0, 0.0]}
    made = scene([radar(id="a"), radar(id="b", **far)], seed=1)
    ours, theirs = (filters_of(made, [name], name == "a", 6) or () for name in "ab")
    assert not set(ours) & set(theirs)
    nowhere = f"plotfeed/telemetry/cell/{NOWHERE}/+"
    assert nowhere in ours
    assert nowhere not in theirs
    assert filters_of(made, ["a"], True, None) is None


def test_a_report_goes_to_the_cell_where_it_says_the_drone_is() -> None:
    where = place(10.0, 3000.0)
    said: dict[bytes, Any] = {
        report(*where): cell_at(*where, 6),
        report(95.0, 0.0): NOWHERE,
        b"nonsense": NOWHERE,
    }
    assert {payload: cell_of(payload, None, time.time_ns(), 6) for payload in said} == said


def test_topics_with_a_cell_are_taken_for_those_without() -> None:
    assert plain_topic("a/b/telemetry/cell/861f1/drone") == "a/b/telemetry/drone"
    assert plain_topic("a/b/telemetry/drone") == "a/b/telemetry/drone"
    assert plain_topic("a/b/control") == "a/b/control"

"""Logs of a Matrice 300, a rotary UAV and a Pixhawk, in a folder that is not ours."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.given_files import places as files
from support.given_flights import moved_m, places, speeds

from plotfeed.feeds.telemetry.flights import read, smoothed
from plotfeed.feeds.telemetry.flights.flight import FlightOptions
from plotfeed.feeds.telemetry.position_report import UNKNOWN_VELOCITY
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

SEA = AltitudeReference.MEAN_SEA_LEVEL
(MATRICE,), (ROTARY,), (PIXHAWK,) = (
    files(f"flights/{name}") for name in ("matrice_300.srt", "UAV_Rot.csv", "log171.bin")
)
COLUMNS = {PIXHAWK: {}, ROTARY: {"velocity_east_m_s": "Vx m/s", "velocity_north_m_s": "Vy m/s"}}


def test_each_flight_is_read_whole() -> None:
    matrice, rotary, pixhawk = flights = (
        read(MATRICE),
        read(ROTARY, FlightOptions(altitude_reference=SEA)),
        read(PIXHAWK),
    )
    assert [(len(f.reports), f.duration_s) for f in flights] == [
        (381, 380.0),
        (965, 964.0),
        (1037, 209.0),
    ]
    assert places(matrice)[0] == (36.6146, -6.112, 0.3)
    assert max(r.altitude_m for r in matrice.reports) == 87.9
    assert rotary.reports[0].t_utc_ns == 1_575_888_575 * 10**9
    assert all(580 < r.altitude_m < 610 for r in pixhawk.reports)
    assert matrice.skipped == rotary.skipped == ()
    assert sum("GPS status 1" in line for line in pixhawk.skipped) == 161
    assert sum("same time" in line for line in pixhawk.skipped) == 1
    with pytest.raises(PlotfeedError, match="--set altitude_reference"):
        read(ROTARY)


def test_the_matrice_flight_is_plausible() -> None:
    recorded = read(MATRICE)
    smooth = smoothed(recorded)
    quantum_m = math.hypot(11.1, 8.9)
    assert moved_m(recorded, smooth) < quantum_m
    assert speeds(smooth).max() < 20
    ups = [r.velocity_enu_m_s[2] for r in smooth.reports]
    assert -7 < min(ups) < -4
    assert 4 < max(ups) < 7


@pytest.mark.parametrize("path", [PIXHAWK, ROTARY], ids=lambda path: path.name)
def test_a_fine_flight_is_untouched_and_its_own_velocity_agrees(path: Path) -> None:
    recorded = read(path, FlightOptions(altitude_reference=SEA, columns=COLUMNS[path]))
    told = tuple(r._replace(velocity_enu_m_s=UNKNOWN_VELOCITY) for r in recorded.reports)
    bare = replace(recorded, reports=told)
    assert moved_m(bare, smoothed(bare)) < 0.02
    own, fitted = (
        np.array([r.velocity_enu_m_s for r in each.reports]) for each in (recorded, smoothed(bare))
    )
    rms_m_s = np.sqrt(np.mean((fitted - own) ** 2, axis=0))
    if path is PIXHAWK:
        assert rms_m_s == pytest.approx([0.3, 0.3, 0.2], abs=0.1)
    else:
        assert np.hypot(*rms_m_s[:2]) < 1.4

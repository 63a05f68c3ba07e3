"""Logs of flights flown by a scene: the ledger and the file have one path."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from support.given_flights import EVERY_FLIGHT, GivenFlight

from plotfeed.models.frames import aer_to_enu
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, Feed, FeedTable, fly, rotating, staring

SENSORS = ({"id": "staring", "scan": staring(0.2)}, {"id": "turning", "scan": rotating(0.4, 4)})
LONGEST_GAP_S = 3.0
EVERY_SENSOR = pytest.mark.parametrize("sensor", ["staring", "turning"])


@cache
def road(flight: GivenFlight) -> Feed:
    parsed = flight.scene(*SENSORS, seed=101, drone=[flight.as_drone()])
    return fly(parsed, min(flight.flight.duration_s, 125.0))


def detections(flight: GivenFlight, sensor: str) -> FeedTable:
    """Those while the recording goes on without a gap that is not bridged."""
    plots, times_s = road(flight).plots(sensor), flight.times_s
    t_s = (plots.time_utc_ns - START_NS) / NS
    segment = np.clip(np.searchsorted(times_s, t_s, side="right"), 1, len(times_s) - 1)
    bridged = times_s[segment] - times_s[segment - 1] <= LONGEST_GAP_S
    return plots.rows((plots.drone == "d") & bridged)


@EVERY_SENSOR
@EVERY_FLIGHT
def test_the_ledger_has_the_recorded_path(flight: GivenFlight, sensor: str) -> None:
    """To a millimetre, at the time that each plot bears."""
    plots = detections(flight, sensor)
    assert len(plots) > 225
    true = aer_to_enu(plots.true_azimuth_deg, plots.true_elevation_deg, plots.true_range_m)
    path = flight.path((plots.time_utc_ns - START_NS) / NS)
    assert np.linalg.norm(true - path, axis=1).max() < 1e-3


@EVERY_FLIGHT
def test_the_path_is_that_of_the_file(flight: GivenFlight) -> None:
    """Smoothing leaves it within the steps in which the log writes positions."""
    apart_m = np.linalg.norm(flight.knots_enu_m - flight.recorded_enu_m, axis=1)
    assert np.median(apart_m) < flight.step_m / 2
    assert apart_m.max() < flight.step_m * 1.5

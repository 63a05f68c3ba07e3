"""The range gate's messages: every drone within at every scan, its noise Gaussian on each axis.

Each test of significance fails for one seed in 10,000 (`significance.FALSE_ALARM_RATE`); the seeds
are those of the scenes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from plotfeed.models.frames import LocalFrame, aer_to_enu, geodetic_to_ecef
from plotfeed.proto.utc import NS
from plotfeed.testing import SITE, START_NS, flown, fly, scene, staring, waypoint

SIGMA_M = 4.0
POSITION_ENU_M = (120.0, -40.0, 12.0)


def gate(**changes: Any) -> dict[str, Any]:
    keys = {
        "id": "gate",
        "type": "range_gate",
        "scan": staring(),
        "range_max_m": 2000.0,
        "sigma_m": SIGMA_M,
    }
    return keys | changes


def test_heights_and_places_are_those_of_a_sensor_beside_the_site() -> None:
    """Without noise the plot is the drone's own place above the ellipsoid."""
    place = waypoint(75.0, 8.0, 1500.0)
    drone = flown("d", place, waypoint(75.0, 8.0, 1500.01), speed_m_s=0.01)
    sensor = gate(sigma_m=0.0, position_enu_m=POSITION_ENU_M)
    plots = fly(scene([sensor], [drone], seed=82), 20).plots("gate")
    assert len(plots) == 20
    np.testing.assert_allclose(plots.height_m, place["height_m"], atol=0.02)
    here = LocalFrame(*(float(x) for x in SITE.to_geodetic(np.array(POSITION_ENU_M))))
    measured = here.to_ecef(aer_to_enu(plots.azimuth_deg, plots.elevation_deg, plots.range_m))
    expected = geodetic_to_ecef(place["latitude_deg"], place["longitude_deg"], place["height_m"])
    assert np.abs(measured - expected).max() < 0.02


def test_a_drone_is_reported_from_the_scan_in_which_it_comes_within() -> None:
    path = (waypoint(30.0, 3.0, 2200.0), waypoint(30.0, 3.0, 200.0))
    drone = flown("d", *path, speed_m_s=20.0, repeat=False)
    plots = fly(scene([gate()], [drone], seed=83), 99).plots("gate")
    t_s = (plots.time_utc_ns - START_NS) / NS
    assert t_s.min() == pytest.approx(10.0, abs=1.0)
    np.testing.assert_allclose(np.diff(t_s), 1.0)
    np.testing.assert_allclose(plots.true_range_m, 2200 - 20 * t_s, atol=0.5)

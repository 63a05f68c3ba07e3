"""RF sensors among houses: who is in sight is drawn once for each pair, by its elevation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.every_kind import FAR_SENSORS
from support.significance import assert_sum

from plotfeed.feeds.engine.simulation import Simulation, simulate
from plotfeed.models.effects.surroundings import CITIES
from plotfeed.testing import START_NS, held, scene

EMITTER = {"frequency_hz": 2.44e9, "bandwidth_hz": 1e6, "eirp_dbm": 20.0}
LAWS = {"suburban": (4.88, 0.43, 0.1, 21), "urban": (9.61, 0.16, 1, 20),
        "dense-urban": (12.08, 0.11, 1.6, 23), "high-rise": (27.23, 0.08, 2.3, 34)}  # fmt: skip


def flown(*ids: str, n: int = 200, names: str = "d", **path_loss: Any) -> Simulation:
    loss = {"path_loss": path_loss} if path_loss else {}
    sensors = [FAR_SENSORS["rf"] | loss | {"id": name} for name in ids]
    drones = [
        held(f"{names}{i}", 1.2 * i, 4.0 + 0.3 * i, 2000.0, emitters=[EMITTER]) for i in range(n)
    ]
    return simulate(scene(sensors, drones, seed=12), 2, start_utc_ns=START_NS)


def lost_db(named: Simulation, free: Simulation, sensor: str = "rf") -> tuple[Any, Any]:
    """Beyond free space, (scans, drones), and elevations."""
    looks, before = named[sensor].looks, free["rf"].looks
    lost = -10 * np.log10(looks.snr / before.snr).reshape(2, -1)
    return lost, looks.elevation_deg.reshape(2, -1)


@pytest.mark.parametrize("environment", LAWS)
def test_as_many_are_in_sight_as_the_law_of_their_elevation_says(environment: str) -> None:
    a, b, in_sight_db, hidden_db = LAWS[environment]
    named = flown("rf", kind="city", environment=environment)
    lost, elevation_deg = lost_db(named, flown("rf"))
    assert np.ptp(lost, axis=0).max() < 1e-6  # once for all scans
    sight = np.abs(lost[0] - in_sight_db) < 1e-6
    np.testing.assert_allclose(lost[0][~sight], hidden_db, atol=1e-6)
    p = 1 / (1 + a * np.exp(-b * (elevation_deg[0] - a)))
    assert_sum(float(sight.sum()), float(p.sum()), float((p * (1 - p)).sum()))
    model = CITIES[environment]
    np.testing.assert_allclose(model.sight_probability(elevation_deg[0]), p, rtol=1e-12)


def test_shadowing_is_normal_and_each_pair_has_its_own() -> None:
    city = {"kind": "city", "environment": "suburban", "shadowing_db": 6.0}
    named, free = flown("rf", "other", **city), flown("rf")
    found = {}
    for sensor in ("rf", "other"):
        lost, elevation_deg = lost_db(named, free, sensor)
        high = elevation_deg[0] > 25  # all in sight
        found[sensor] = (lost[0][high] - 0.1) / 6.0
        assert len(found[sensor]) > 100
        assert_sum(float((found[sensor] ** 2).sum()), len(found[sensor]), 2 * len(found[sensor]))
    assert abs(np.corrcoef(found["rf"], found["other"])[0, 1]) < 0.4


def test_a_pair_keeps_its_draw_whoever_else_is_there() -> None:
    city = {"kind": "city", "environment": "high-rise", "shadowing_db": 4.0}
    many, few = flown("rf", n=60, **city), flown("rf", n=20, **city)
    snr = [found["rf"].looks.rows(found["rf"].looks.drone < 20).snr for found in (many, few)]
    np.testing.assert_array_equal(*snr)
    others = flown("rf", n=20, names="e", **city)
    assert (others["rf"].looks.snr != few["rf"].looks.snr).any()

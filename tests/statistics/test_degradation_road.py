"""A sensor that does worse than it says: in one respect, and in no other."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from support.every_kind import EMITTER, RADAR, SENSORS, drones
from support.significance import Array, assert_standard_normal

from plotfeed.feeds.formats.sapient.sapient_node import detection_confidence_of, node_of
from plotfeed.models.frames import aer_to_enu, wrap_180
from plotfeed.models.sensors.sensor_model import Targets
from plotfeed.models.state import Emitter, Signature
from plotfeed.testing import START_NS, Feed, FeedTable, fly, held, radar, rotating, scene

KINDS = pytest.mark.parametrize("kind", SENSORS)
SCANS = 30
MEASURED = ("range_m", "azimuth_deg", "elevation_deg", "bistatic_range_m", "range_rate_m_s")


@cache
def road(kind: str, **degradation: float) -> Feed:
    named = {"degradation": degradation} if degradation else {}
    return fly(scene([SENSORS[kind] | named], drones(kind), seed=71), SCANS)


def of_drones(flight: Feed) -> FeedTable:
    plots = flight.plots()
    return plots.rows(plots.drone != "")


def errors(plots: FeedTable, kind: str) -> dict[str, Array]:
    """Errors over the standard deviations that plots state, of what the kind measures at once."""
    place = aer_to_enu(plots.true_azimuth_deg, plots.true_elevation_deg, plots.true_range_m)
    true = {name: getattr(plots, f"true_{name}") for name in MEASURED[:3]}
    if kind == "passive":
        tower = aer_to_enu(300.0, 0.2, 20_000.0)
        ways_m = np.linalg.norm(place, axis=1) + np.linalg.norm(place - tower, axis=1)
        true = {"bistatic_range_m": ways_m - 20_000.0, "azimuth_deg": true["azimuth_deg"]}
    found = {}
    for name, value in true.items():
        sigma = getattr(plots, f"sigma_{name}")
        error = getattr(plots, name) - value
        if name.endswith("_deg"):
            error = wrap_180(error)
        if not np.isnan(sigma).any() and not (kind == "microphones" and name == "range_m"):
            found[name] = error / sigma
    return found


@KINDS
def test_errors_are_so_many_times_those_stated_and_all_else_is_as_it_was(kind: str) -> None:
    plain, worse = (of_drones(road(kind, **more)) for more in ({}, {"error_factor": 3.0}))
    found, before = errors(worse, kind), errors(plain, kind)
    assert found
    for name, error in found.items():
        assert_standard_normal(error / 3.0, name)
        if kind not in ("gate", "passive"):  # theirs depend on the noise of the others
            np.testing.assert_allclose(error, 3 * before[name], atol=1e-6, rtol=1e-6)
    for name in ("snr_db", "sigma_azimuth_deg", "amplitude_dbm"):
        if kind != "gate":
            np.testing.assert_array_equal(getattr(worse, name), getattr(plain, name))
    looks = [road(kind, **more).looks() for more in ({}, {"error_factor": 3.0})]
    for name in ("drone", "pd", "snr_db", "detected"):
        np.testing.assert_array_equal(*(getattr(each, name) for each in looks))


def test_a_factor_of_zero_leaves_none() -> None:
    sensor = RADAR | {"pfa": 1e-4, "degradation": {"false_alarm_factor": 0.0, "pd_factor": 0.0}}
    flight = fly(scene([sensor], drones("active"), seed=73), 5)
    assert not len(flight.plots())
    assert (flight.looks().pd == 0).all()


def test_an_event_degrades_for_as_long_as_it_lasts() -> None:
    event = {"from_s": 20.0, "to_s": 40.0, "set": {"degradation": {"pd_factor": 0.0}}}
    flight = fly(scene([RADAR | {"event": [event]}], drones("active"), seed=74), 60)
    looks = flight.looks()
    at_s = (looks.time_utc_ns - START_NS) / 1e9
    assert (looks.pd[(at_s > 21) & (at_s < 40)] == 0).all()
    assert (looks.pd[(at_s < 20) | (at_s > 41)] > 0).all()


@pytest.mark.parametrize("scan", [{}, {"scan": rotating(1.0, 8)}])
def test_of_echoes_that_merge_so_much_of_pd_is_left_too(scan: dict[str, Any]) -> None:
    """Two drones in one place, weak enough to be missed; and rates are as much worse."""
    weak = {"rcs_m2": 0.001}
    pairs = [held(f"{i}-{j}", 30.0 * i, 5.0, 9000.0, **weak) for i in range(12) for j in range(2)]
    named = {"merging": {}, "doppler": {}} | scan
    looks = [
        fly(scene([radar(**named, **more)], pairs, seed=75), 30).looks()
        for more in ({}, {"degradation": {"pd_factor": 0.5}})
    ]
    assert 0.1 < looks[0].pd.min() < 0.9
    np.testing.assert_allclose(looks[1].pd, 0.5 * looks[0].pd, rtol=1e-12)


WORSE = {"pd_factor": 0.6, "false_alarm_factor": 4.0, "error_factor": 2.0}
SIGNATURE = Signature(rcs_m2=0.1, sound_power_db=90.0, emitters=(Emitter(**EMITTER),))


@KINDS
def test_what_is_predicted_is_as_much_worse(kind: str) -> None:
    """By `check`."""
    there = aer_to_enu(40.0, 12.0, np.array([300.0, 400.0]))
    plain, worse = (
        scene([SENSORS[kind] | more], seed=77).sensor[0] for more in ({}, {"degradation": WORSE})
    )
    site = scene([SENSORS[kind]], seed=77).scene.site
    models = [sensor.model(site) for sensor in (plain, worse)]
    targets = Targets.of_one(SIGNATURE, there)
    before, found = (model.predict(targets) for model in models)
    np.testing.assert_allclose(found.pd, 0.6 * before.pd, rtol=0.03)  # of several channels, more
    np.testing.assert_allclose(found.sigma_azimuth_deg, 2 * before.sigma_azimuth_deg)


@pytest.mark.parametrize("kind", ["active", "microphones"])
def test_the_sensor_says_of_itself_what_it_takes_itself_to_be(kind: str) -> None:
    sensor = SENSORS[kind] | {"report": ["sapient"]}
    plain, worse = (scene([sensor | more], seed=78) for more in ({}, {"degradation": WORSE}))
    assert node_of(worse, worse.sensor[0]) == node_of(plain, plain.sensor[0])
    believes, believed = (detection_confidence_of(s, s.sensor[0]) for s in (worse, plain))
    assert believes is not None
    assert believed is not None
    np.testing.assert_array_equal(believes.log_odds, believed.log_odds)

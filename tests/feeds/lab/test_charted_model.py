"""Steered beams and several receivers in a chart: each target by itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.chart_cases import RADAR, method, scene_of

from plotfeed.feeds.lab.chart import charted
from plotfeed.feeds.lab.chart_command import as_values
from plotfeed.feeds.lab.charted import Effort, charted_model
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.sensors.sensor_model import Targets
from plotfeed.models.state import Signatures

MASTS = [(-8000.0, 15_000.0, 200.0), (17_000.0, 3000.0, 150.0), (2000.0, -17_500.0, 120.0)]
PLACES: dict[str, Any] = {
    "id": "net", "type": "multistatic_passive", "scan": {"kind": "staring", "period_s": 1.0},
    "gain_rx_dbi": 10.0, "azimuth_beamwidth_deg": 10.0, "integration_s": 0.3,
    "external_noise_db": -4.45, "range_max_m": 9000.0, "report": ["asterix-015", "plots"],
    "receivers": [{"id": "r1", "east_m": 2500.0, "north_m": 800.0, "above_site_m": 5.0}],
    "transmitters": [
        {"id": f"m{i}", "preset": "dvb-t", "erp_w": 1e5,
         "place": dict(zip(("east_m", "north_m", "above_site_m"), where, strict=True))}
        for i, where in enumerate(MASTS)
    ],
}  # fmt: skip
WEAK = {
    "id": "d", "speed_m_s": 10.0, "rcs_m2": 3e-4,
    "path": [{"east_m": e, "north_m": 3000.0, "above_site_m": 80.0} for e in (-800.0, 900.0)],
}  # fmt: skip


@pytest.mark.parametrize("degradation", [{}, {"degradation": {"pd_factor": 0.7}}])
def test_places_of_several_receivers_are_charted_each_by_itself(
    degradation: dict[str, Any],
) -> None:
    """Their errors follow least squares to first order, of which there is no precise law."""
    made = scene_of(PLACES | degradation, drones=[WEAK])
    (found,) = as_values(charted(made, Effort.quick(40)))["sensors"]
    assert {s["stage"] for s in found["stages"]} == {
        *("frames", "propagation", "detection", "encoding"),
    }
    for name in ("closed form", "signals, one trial"):
        assert method(found, "detection", name)["errors"]["pd"] < 1e-9
    assert method(found, "detection", "as if pairs were alike")["errors"]["pd"] > 1e-3
    assert method(found, "propagation", "free space")["ours"]
    own = found["own"]
    assert set(own) == {"range_m", "azimuth_deg", "elevation_deg", "pd"}


def test_what_a_place_by_itself_errs_is_what_the_sensor_states() -> None:
    made = scene_of(PLACES, drones=[WEAK | {"rcs_m2": 1.0}])
    model = charted_model(made.sensor[0].model(made.scene.site))
    n = 4000
    places_m = np.tile([300.0, 3000.0, 60.0], (n, 1))
    targets = Targets(
        drone=np.arange(n),
        t_utc_ns=np.zeros(n, np.int64),
        position_enu_m=places_m,
        true_position_enu_m=places_m,
        signatures=Signatures(
            rcs_m2=np.ones(n), sound_power_db=np.full(n, np.nan), emitters=[()] * n
        ),
    )
    looks, plots = model.observe(targets, np.random.default_rng(3))
    assert looks.pd.min() > 0.99
    assert len(plots) == looks.detected.sum()
    found = aer_to_enu(plots.azimuth_deg, plots.elevation_deg, plots.range_m) - places_m[0]
    for name, axis in (("covariance_east_m2", 0), ("covariance_north_m2", 1)):
        stated = getattr(plots, name)
        # Squares over those that are stated; a height that is as expected leaves a little less.
        assert 0.75 < np.mean(found[:, axis] ** 2 / stated) < 1.1


def test_a_steered_beam_is_charted_by_the_dwell_that_points_at_a_target() -> None:
    scan = {"kind": "electronic", "period_s": 0.1, "dwell_s": 0.001, "revisit_s": 0.1}
    sensor = RADAR | {
        "scan": scan, "integration_s": 0.001, "elevation_min_deg": -10.0,
        "elevation_max_deg": 60.0, "azimuth_min_deg": -60.0, "azimuth_max_deg": 60.0,
    }  # fmt: skip
    plain = sensor | {"scan": {"kind": "staring", "period_s": 0.1}}
    drone = WEAK | {"rcs_m2": 0.1}
    steered, still = (
        as_values(charted(scene_of(each, drones=[drone]), Effort.quick(40)))["sensors"][0]
        for each in (sensor, plain)
    )
    stages = {s["stage"] for s in still["stages"]}
    assert {s["stage"] for s in steered["stages"]} == stages - {"false alarms"}
    assert steered["own"] == pytest.approx(
        {name: value for name, value in still["own"].items() if name != "false_alarms"}
    )
    closed = method(steered, "detection", "closed form")
    assert closed["ours"]
    assert closed["share"] < 1e-6

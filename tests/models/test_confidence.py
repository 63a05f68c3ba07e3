"""Of detections with a confidence, as many are of targets, under the prior that it supposes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from plotfeed.feeds.scene.fields import Site
from plotfeed.feeds.scene.scene import from_tree
from plotfeed.models.confidence import TargetPrior, confidence_of
from plotfeed.models.frames import enu_to_aer
from plotfeed.models.sensors.sensor_model import SensorModel, Targets
from plotfeed.models.state import Emitter, Signature
from plotfeed.testing import SITE, radar, staring

HERE = {
    "latitude_deg": SITE.latitude_deg,
    "longitude_deg": SITE.longitude_deg,
    "height_m": SITE.height_m,
}
ALL_ROUND = (-180.0, 180.0)
SENSORS: dict[str, dict[str, Any]] = {
    "active radar": radar(pfa=1e-5, range_max_m=40e3),
    "MIMO radar": {
        "type": "mimo_radar", "scan": staring(),
        "transmitters": [
            {"power_w": 200.0, "east_m": 100.0 * k, "north_m": 30.0 * k, "above_site_m": 0.0}
            for k in range(3)
        ],
        "frequency_hz": 15e9, "gain_tx_dbi": 11.6, "gain_rx_dbi": 11.6, "integration_s": 0.06,
        "range_resolution_m": 20.0, "range_max_m": 10_000.0, "azimuth_beamwidth_deg": 3.0,
        "elevation_beamwidth_deg": 30.0, "elevation_min_deg": -2.0, "elevation_max_deg": 60.0,
        "pfa": 1e-5,
    },
    "passive radar": {
        "type": "passive_radar", "scan": staring(), "gain_rx_dbi": 2.0, "pfa": 1e-4,
        "transmitters": [
            {"id": str(east_km), "erp_w": 1e4, "frequency_hz": 600e6, "bandwidth_hz": 7.61e6,
             "place": {"east_m": 1e3 * east_km, "north_m": 14e3, "above_site_m": 100.0}}
            for east_km in (-14, 20)
        ],
        "azimuth_beamwidth_deg": 2.0, "integration_s": 0.3, "external_noise_db": -4.45,
        "range_max_m": 10_000.0,
    },
    "microphone": {
        "type": "acoustic", "scan": staring(), "range_max_m": 1000.0, "noise_db": 0.0,
        "sensitivity_db": 32.0, "azimuth_beamwidth_deg": 4.0, "pfa": 1e-3,
        "absorption_db_per_km": 5.0, "slope_per_db": 0.5,
    },
    "finder": {
        "type": "rf", "scan": staring(), "frequency_min_hz": 2.40e9, "frequency_max_hz": 2.48e9,
        "channel_bandwidth_hz": 1e6, "integration_s": 1e-5, "range_max_m": 30e3,
        "baseline_m": 0.06, "pfa": 1e-3, "loss_db": 15.0,
    },
}  # fmt: skip
PRIOR = TargetPrior(
    mean_number=2.0,
    signature=Signature(
        rcs_m2=0.01, sound_power_db=80.0, emitters=(Emitter(frequency_hz=2.44e9, eirp_dbm=20.0),)
    ),
)
N = 40_000


def model_of(name: str) -> SensorModel:
    general = {"name": "s", "seed": 1, "site": HERE}
    tree = {"scene": general, "sensor": [SENSORS[name] | {"id": "s"}]}
    (sensor,) = from_tree(tree, Path("confidence.toml")).sensor
    return sensor.model(Site(**HERE))


def shown(model: SensorModel, rng: np.random.Generator) -> tuple[Any, Any]:
    """Ratios of plots of N targets, and of the false alarms of the scans that bring so many."""
    places = PRIOR.places_enu_m(N, model.range_max_m, ALL_ROUND, rng)
    places = places[enu_to_aer(places)[2] <= model.range_max_m]
    _, plots = model.observe(Targets.of_one(PRIOR.signature, places), rng)
    alarms = rng.poisson(model.false_alarms_per_scan * N / PRIOR.mean_number)
    return plots.snr, model.draw_false_snr(min(alarms, 2_000_000), rng)


@pytest.mark.parametrize("name", SENSORS)
def test_as_many_are_of_targets_as_it_says(name: str) -> None:
    model = model_of(name)
    confidence = confidence_of(model, PRIOR, ALL_ROUND, np.random.default_rng(1))
    of_targets, of_alarms = map(confidence.of, shown(model, np.random.default_rng(2)))
    stated = np.concatenate([of_targets, of_alarms])
    is_target = np.arange(len(stated)) < len(of_targets)
    assert is_target.mean() == pytest.approx(stated.mean(), abs=0.03)
    judged = 0
    for low in np.arange(0.0, 1.0, 0.1):
        inside = (stated >= low) & (stated < low + 0.1 + (low > 0.85))
        if inside.sum() >= 50:
            judged += 1
            share, n = is_target[inside].mean(), inside.sum()
            # Its cells hold some 20 draws or more, and confidence changes within a cell.
            allowed = 0.1 + 4.5 * np.sqrt(max(share * (1 - share), 0.01) / n)
            assert share == pytest.approx(stated[inside].mean(), abs=allowed), low
    assert judged
    assert of_targets.mean() > of_alarms.mean() + 0.2


def test_the_stronger_an_echo_the_surer() -> None:
    confidence = confidence_of(model_of("active radar"), PRIOR, ALL_ROUND, np.random.default_rng(1))
    weak, strong = confidence.of(10 ** (np.array([11.0, 30.0]) / 10))
    assert weak < 0.5
    assert strong > 0.95


def test_more_are_expected_more_are_believed() -> None:
    model = model_of("passive radar")
    few, many = (
        confidence_of(
            model, replace(PRIOR, mean_number=number), ALL_ROUND, np.random.default_rng(1)
        ).of(np.array([10.0]))[0]
        for number in (0.1, 10.0)
    )
    assert many / (1 - many) == pytest.approx(100 * few / (1 - few))

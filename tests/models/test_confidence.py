"""Of detections with a confidence, as many are of targets, under the prior that it supposes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.every_kind import MICROPHONES, MIMO, PASSIVE
from support.every_kind import RF as FINDER

from plotfeed.models.confidence import TargetPrior, confidence_of
from plotfeed.models.frames import enu_to_aer
from plotfeed.models.sensors.sensor_model import SensorModel, Targets
from plotfeed.models.state import Emitter, Signature
from plotfeed.testing import radar, scene

ALL_ROUND = (-180.0, 180.0)
RF = {"integration_s": 1e-5, "pfa": 1e-3, "loss_db": 15.0, "range_max_m": 30e3}
SENSORS: dict[str, dict[str, Any]] = {
    "active_radar": radar(pfa=1e-5, range_max_m=40e3),
    "mimo_radar": MIMO | {"gain_tx_dbi": 11.6, "gain_rx_dbi": 11.6, "pfa": 1e-5},
    "passive_radar": PASSIVE | {"gain_rx_dbi": 2.0, "pfa": 1e-4},
    "acoustic": MICROPHONES | {"range_max_m": 1000.0, "sensitivity_db": 32.0, "pfa": 1e-3},
    "rf": FINDER | RF,
}
PRIOR = TargetPrior(
    mean_number=2.0,
    signature=Signature(
        rcs_m2=0.01, sound_power_db=80.0, emitters=(Emitter(frequency_hz=2.44e9, eirp_dbm=20.0),)
    ),
)
N = 40_000


def model_of(name: str) -> SensorModel:
    made = scene([SENSORS[name]], seed=1)
    return made.sensor[0].model(made.scene.site)


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
    confidence = confidence_of(model_of("active_radar"), PRIOR, ALL_ROUND, np.random.default_rng(1))
    weak, strong = confidence.of(10 ** (np.array([11.0, 30.0]) / 10))
    assert weak < 0.5
    assert strong > 0.95


def test_more_are_expected_more_are_believed() -> None:
    model = model_of("passive_radar")
    few, many = (
        confidence_of(
            model, replace(PRIOR, mean_number=number), ALL_ROUND, np.random.default_rng(1)
        ).of(np.array([10.0]))[0]
        for number in (0.1, 10.0)
    )
    assert many / (1 - many) == pytest.approx(100 * few / (1 - few))

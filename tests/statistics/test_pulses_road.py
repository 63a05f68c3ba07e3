"""What pulses make ambiguous or blind, as it leaves: ranges, detections, alarms and reports."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats
from support.every_kind import PASSIVE
from support.radar_equations import LIGHT_M_S
from support.significance import assert_chance, assert_standard_normal

from plotfeed.feeds.cli.check import report
from plotfeed.feeds.scene.scene import SceneError
from plotfeed.testing import fly, held, radar, scene

PRF_HZ = 25_000.0
FOLD_M = LIGHT_M_S / (2 * PRF_HZ)


def spread(n: int = 40, **more: Any) -> list[dict[str, Any]]:
    return [held(f"d{i}", 9.0 * i + 1, 4.0, 1000.0 + 331.0 * i, **more) for i in range(n)]


def test_drones_beyond_are_told_nearer_by_whole_folds() -> None:
    sensor = radar(pulses={"prf_hz": [PRF_HZ]}, range_floor_m=3.0)
    flight = fly(scene([sensor], spread(rcs_m2=1.0), seed=21), 20)
    plots = flight.plots()
    plots = plots.rows(plots.drone != "")
    folds = (plots.true_range_m - plots.range_m) / FOLD_M
    whole = np.rint(folds)
    assert set(whole) == {0.0, 1.0, 2.0}
    assert plots.range_m.max() < FOLD_M
    assert_standard_normal((whole - folds) * FOLD_M / plots.sigma_range_m)
    two = radar(pulses={"prf_hz": [PRF_HZ, 27_000.0]})
    plots = fly(scene([two], spread(rcs_m2=1.0), seed=21), 5).plots()
    plots = plots.rows(plots.drone != "")
    assert np.abs(plots.range_m - plots.true_range_m).max() < 20.0


def test_false_alarms_are_told_within_a_fold_alone() -> None:
    sensor = radar(pulses={"prf_hz": [PRF_HZ]}, pfa=2e-5)
    made, plain = (scene([s], seed=22) for s in (sensor, radar(pfa=2e-5)))
    few, many = (m.sensor[0].model(m.scene.site).false_alarms_per_scan for m in (made, plain))
    assert few == pytest.approx(many * FOLD_M / 20_000.0, rel=1e-9)
    plots = fly(made, 10).plots()
    assert plots.range_m.max() < FOLD_M
    assert_chance(
        2 * min(stats.poisson.cdf(len(plots), 10 * few), stats.poisson.sf(len(plots) - 1, 10 * few))
    )


def test_a_broadcast_has_no_pulses() -> None:
    with pytest.raises(SceneError, match="broadcasts have none"):
        scene([PASSIVE | {"pulses": {"prf_hz": [1e3]}}], seed=27)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"pulses": {"prf_hz": [1e3], "needed": 2}}, "must not exceed the 1"),
        ({"pulses": {"prf_hz": [1e3, 2e3], "intervals": 1}}, "at least one for each"),
        ({"pulses": {"prf_hz": [1e4], "pulse_s": 1e-4}}, "half of the time"),
        ({"pulses": {"prf_hz": [1e4], "beam_passes": True}}, "is of a radar that turns"),
        ({"pulses": {"prf_hz": [1e4]}, "doppler": {"prf_hz": 1e4}}, "pulses say it"),
    ],
)
def test_pulses_that_cannot_be_are_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError, match=said):
        scene([radar(**keys)], seed=27)


def test_check_warns_of_folds() -> None:
    warnings = report(scene([radar(pulses={"prf_hz": [PRF_HZ]})], seed=28))["sensors"][0][
        "warnings"
    ]
    assert any("drones beyond 5996 m are told nearer" in text for text in warnings)

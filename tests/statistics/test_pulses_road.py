"""What pulses make ambiguous or blind, as it leaves: ranges, detections, alarms and reports."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats
from support.every_kind import MIMO, PASSIVE
from support.radar_equations import LIGHT_M_S, mean_snr, multiplier
from support.significance import Array, assert_chance, assert_standard_normal, assert_sum

from plotfeed.feeds.cli.check import report
from plotfeed.feeds.scene.scene import SceneError
from plotfeed.testing import Feed, flown, fly, held, radar, rotating, scene, waypoint

PRF_HZ = 25_000.0
FOLD_M = LIGHT_M_S / (2 * PRF_HZ)
WAVELENGTH_M = LIGHT_M_S / 10e9


def linear(db: Array) -> Array:
    return np.asarray(10 ** (db / 10))


def pd_of(sensor: dict[str, Any], snr: Array) -> Array:
    """Equation 6."""
    return np.asarray((1 + multiplier(sensor) / (1 + snr)) ** -sensor["n_reference"])


def spread(n: int = 40, **more: Any) -> list[dict[str, Any]]:
    return [held(f"d{i}", 9.0 * i + 1, 4.0, 1000.0 + 331.0 * i, **more) for i in range(n)]


def assert_detected(flight: Feed) -> None:
    looks = flight.looks()
    assert_sum(looks.detected.sum(), looks.pd.sum(), (looks.pd * (1 - looks.pd)).sum(), "hits")


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


def test_echoes_are_eclipsed_and_held_down_near_each_pulse() -> None:
    keys = {"prf_hz": [PRF_HZ], "pulse_s": 8e-6, "stc_range_m": 3000.0, "stc_exponent": 3.0}
    looks = fly(scene([radar(pulses=keys)], spread(), seed=23), 3).looks()
    x = looks.range_m / FOLD_M % 1
    eclipsed = np.clip(np.minimum(x, 1 - x) / (8e-6 * PRF_HZ), 0, 1) ** 2
    held_down = np.minimum(1, x * FOLD_M / 3000.0) ** 3
    expected = mean_snr(radar(), looks.range_m) * eclipsed * held_down
    np.testing.assert_allclose(linear(looks.snr_db), expected, rtol=1e-6)
    assert eclipsed.min() < 0.2


def approaching(speed_m_s: float, n: int = 12, **more: Any) -> list[dict[str, Any]]:
    """Straight at the sensor, from all around."""
    return [
        flown(f"d{i}", waypoint(30.0 * i, 4.0, 5000.0), waypoint(30.0 * i, 4.0, 3500.0),
              speed_m_s=speed_m_s, repeat=False, **more)
        for i in range(n)
    ]  # fmt: skip


@pytest.mark.parametrize("scan", [{}, {"scan": rotating(1.0, 8)}], ids=["staring", "rotating"])
def test_one_frequency_is_blind_where_several_are_not(scan: dict[str, Any]) -> None:
    blind_m_s = 18.0
    prf_hz = 2 * blind_m_s / WAVELENGTH_M
    one = {"prf_hz": [prf_hz], "canceller": "double"}
    stagger = {"prf_hz": [prf_hz, 1.13 * prf_hz, 1.31 * prf_hz], "canceller": "double"}
    seen = []
    for pulses in (one, stagger):
        flight = fly(scene([radar(pulses=pulses, **scan)], approaching(blind_m_s), seed=24), 40)
        assert_detected(flight)
        seen.append(flight.looks())
    assert seen[0].pd.max() < 0.05
    assert seen[1].pd.mean() > 0.5
    looks, turns = seen[1], np.array([1, 1 / 1.13, 1 / 1.31])
    gain = 8 / 3 * np.sin(np.pi * turns) ** 4
    each = pd_of(radar(), mean_snr(radar(), looks.range_m)[:, None] * gain)
    np.testing.assert_allclose(looks.pd, 1 - np.prod(1 - each, axis=1), atol=2e-3)


def test_so_many_of_the_intervals_have_to_detect_and_so_do_false_alarms() -> None:
    pulses = {"prf_hz": [PRF_HZ, 27e3, 29e3], "intervals": 5, "needed": 3}
    sensor = radar(pulses=pulses, pfa=1e-3)
    flight = fly(scene([sensor], spread(rcs_m2=0.002), seed=25), 60)
    assert_detected(flight)
    looks, plots = flight.looks(), flight.plots()
    p = pd_of(sensor, mean_snr(sensor, looks.range_m, 0.002))
    np.testing.assert_allclose(looks.pd, stats.binom.sf(2, 5, p), rtol=1e-6)
    of_drones = plots.rows(plots.drone != "")
    error = (of_drones.range_m - of_drones.true_range_m) / of_drones.sigma_range_m
    assert_standard_normal(error, "errors of the interval that is measured by")
    alarms = int((plots.drone == "").sum())
    cells = 2000 * 180 * 15
    mean = cells * float(stats.binom.sf(2, 5, 1e-3)) * 60
    assert mean < 10
    assert_chance(2 * min(stats.poisson.cdf(alarms, mean), stats.poisson.sf(alarms - 1, mean), 0.5))


def test_a_beam_that_passes_leaves_each_interval_what_it_has_meanwhile() -> None:
    """8 ms on a beam of 2 degrees at 250 degrees a second, 4 intervals of 2 ms."""
    sensor = radar(
        scan=rotating(1.44, 8), integration_s=0.002,
        pulses={"prf_hz": [2000.0], "intervals": 4, "beam_passes": True},
    )  # fmt: skip
    drones = [held(f"d{i}", 9.07 * i + 1, 4.0, 8000.0) for i in range(40)]
    flight = fly(scene([sensor], drones, seed=26), 90)
    assert_detected(flight)
    looks = flight.looks()
    into = looks.time_utc_ns % 2_000_000 / 2e6
    middle_deg = 0.5 * (np.arange(4) - 2 + 0.5 - into[:, None])
    fine = middle_deg[..., None] + 0.5 * (np.arange(200) + 0.5 - 100) / 200
    gain = np.sqrt(0.5 ** ((2 * fine / 2.0) ** 2)).mean(axis=-1) ** 2
    snr = mean_snr(sensor, looks.range_m)[:, None] * gain
    np.testing.assert_allclose(linear(looks.snr_db), snr.mean(axis=1), rtol=1e-4)
    pd = 1 - np.prod(1 - pd_of(sensor, snr), axis=1)
    np.testing.assert_allclose(looks.pd, pd, atol=1e-4)
    assert 0.1 < looks.pd.min() < looks.pd.max() < 0.99
    assert np.ptp(into) > 0.9
    predicted = report(scene([sensor], drones[:1], seed=26))["sensors"][0]
    assert predicted["effects"].keys() == {"pulses"}
    row = min(predicted["table"], key=lambda row: abs(row["range_m"] - 8000.0))
    there = mean_snr(sensor, row["range_m"]) * gain
    mean = (1 - np.prod(1 - pd_of(sensor, there), axis=1)).mean()
    assert row["pd"] == pytest.approx(mean, abs=0.01)


@pytest.mark.parametrize("needed", [1, 2])
def test_intervals_of_a_mimo_radar_decide_by_the_signals_of_all_transmitters(needed: int) -> None:
    pulses = {"prf_hz": [PRF_HZ, 27e3], "intervals": 3, "needed": needed, "pulse_s": 4e-6}
    drones = spread(14, rcs_m2=5e-4)
    plain, found = (
        fly(scene([MIMO | more], drones, seed=29), 40) for more in ({}, {"pulses": pulses})
    )
    assert_detected(found)
    looks, before = found.looks(), plain.looks()
    prf_hz = np.array([PRF_HZ, 27e3, PRF_HZ])
    x = looks.range_m[:, None] * 2 * prf_hz / LIGHT_M_S % 1
    eclipsed = np.clip(np.minimum(x, 1 - x) / (4e-6 * prf_hz), 0, 1) ** 2
    gain = linear(looks.snr_db - before.snr_db)
    np.testing.assert_allclose(gain, eclipsed.mean(axis=1), rtol=1e-6)
    clear = (eclipsed == 1).all(axis=1)
    assert clear.sum() > 100
    p = before.pd[clear]
    np.testing.assert_allclose(looks.pd[clear], stats.binom.sf(needed - 1, 3, p), rtol=1e-6)
    plots = found.plots()
    plots = plots.rows(plots.drone != "")
    assert_standard_normal((plots.range_m - plots.true_range_m) / plots.sigma_range_m)


def test_one_frequency_folds_the_ranges_of_a_mimo_radar_and_blinds_it() -> None:
    mimo = MIMO | {"pulses": {"prf_hz": [PRF_HZ]}, "range_max_m": 15_000.0}
    flight = fly(scene([mimo], spread(14, rcs_m2=300.0), seed=30), 5)
    plots = flight.plots()
    plots = plots.rows(plots.drone != "")
    whole = np.rint((plots.true_range_m - plots.range_m) / FOLD_M)
    assert set(whole) >= {0.0}
    assert plots.range_m.max() < FOLD_M
    blind_m_s = LIGHT_M_S / 15e9 * 2000.0 / 2
    filtered = MIMO | {"pulses": {"prf_hz": [2000.0], "canceller": "single"}}
    looks = fly(scene([filtered], approaching(blind_m_s, rcs_m2=1.0), seed=30), 20).looks()
    assert looks.pd.max() < 0.2


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

"""Two rays over flat ground, as the ledger and the bytes have them, beside the sum of two waves."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.radar_equations import LIGHT_M_S, mean_snr, pd
from support.road import Road, flown, fly, held, radar, scene, staring, waypoint
from support.significance import Array, assert_sum

from plotfeed.models.frames import aer_to_enu

RHO, HEIGHT_M = -0.9, 5.0
GROUND = {"reflection": RHO, "antenna_height_m": HEIGHT_M}
EMITTER = {"frequency_hz": 2.44e9, "bandwidth_hz": 1e6, "eirp_dbm": 20.0}
TOWER = (300.0, 0.3, 15_000.0)
SENSORS: dict[str, dict[str, Any]] = {
    "active": radar(elevation_max_deg=60.0),
    "mimo": {
        "id": "radar", "type": "mimo_radar", "scan": staring(), "frequency_hz": 15e9,
        "transmitters": [{"power_w": 2000.0, "east_m": 8.0, "north_m": 6.0, "above_site_m": 4.0}],
        "gain_tx_dbi": 11.6, "gain_rx_dbi": 11.6, "integration_s": 0.06,
        "range_resolution_m": 20.0, "range_max_m": 10_000.0, "azimuth_beamwidth_deg": 3.0,
        "elevation_beamwidth_deg": 10.0, "elevation_min_deg": -2.0, "elevation_max_deg": 60.0,
    },
    "passive": {
        "id": "radar", "type": "passive_radar", "scan": staring(), "gain_rx_dbi": 2.0,
        "transmitters": [{"id": "tv", "erp_w": 1e4, "frequency_hz": 600e6,
                          "bandwidth_hz": 7.61e6, "place": waypoint(*TOWER)}],
        "azimuth_beamwidth_deg": 2.0, "integration_s": 0.3, "external_noise_db": -4.45,
        "range_max_m": 10_000.0, "cancellation_db": -150.0,
    },
    "rf": {
        "id": "radar", "type": "rf", "scan": staring(), "frequency_min_hz": 2.4e9,
        "frequency_max_hz": 2.5e9, "channel_bandwidth_hz": 1e6, "integration_s": 1e-4,
        "range_max_m": 9000.0, "baseline_m": 0.2,
    },
}  # fmt: skip
TIME_BANDWIDTH = 0.3 * 7.61e6


def one_way(target: Array, antenna: Array, frequency_hz: float) -> Array:
    """Two waves that meet: the straight one, and one from an antenna below the ground."""
    mirrored = antenna * [1, 1, -1]
    straight, bounced = (np.linalg.norm(target - end, axis=-1) for end in (antenna, mirrored))
    waves = 1 + RHO * np.exp(2j * np.pi * (bounced - straight) * frequency_hz / LIGHT_M_S)
    return np.abs(waves) ** 2


def expected(kind: str, places: Array) -> Array:
    """Power beside that of free space, of drones seen from the sensor."""
    here = np.array([0.0, 0.0, HEIGHT_M])
    target = places + here  # heights are above the ground
    match kind:
        case "active":
            return one_way(target, here, 10e9) ** 2
        case "mimo":
            there = here + np.array([8.0, 6.0, 4.0])
            return one_way(target, here, 15e9) * one_way(target, there, 15e9)
        case "passive":
            tower = here + aer_to_enu(*TOWER)
            return one_way(target, here, 600e6) * one_way(target, tower, 600e6)
        case _:
            return one_way(target, here, 2.44e9)


def approach() -> list[dict[str, Any]]:
    """One drone that flies from 3 km to 1 km, some 50 m up."""
    ends = (waypoint(33.0, 1.0, 3000.0), waypoint(33.0, 3.0, 1000.0))
    return [flown("d", *ends, speed_m_s=10.0, repeat=False, emitters=[EMITTER])]


def flight(kind: str, **named: Any) -> Road:
    return fly(scene([SENSORS[kind] | named], approach(), seed=91), 190)


@pytest.mark.parametrize("kind", SENSORS)
def test_the_ground_makes_of_the_ratio_what_two_waves_do(kind: str) -> None:
    free, over_ground = flight(kind).looks(), flight(kind, multipath=GROUND).looks()
    places = aer_to_enu(free.azimuth_deg, free.elevation_deg, free.range_m)
    ratios = [10 ** (looks.snr_db / 10) for looks in (free, over_ground)]
    if kind == "passive":  # before the correlator: the echo disturbs itself
        ratios = [ratio / (TIME_BANDWIDTH - ratio) for ratio in ratios]
    factor = expected(kind, places)
    np.testing.assert_allclose(ratios[1] / ratios[0], factor, rtol=3e-3)
    assert factor.max() > 5 * factor.min()


def test_the_ground_weighs_on_the_direct_signal_too() -> None:
    """Where all disturbance is the transmitter itself, and the way to it lies in a null."""
    loud = {"cancellation_db": 0.0}
    ratios = []
    for more in (loud, loud | {"multipath": GROUND}):
        looks = flight("passive", **more).looks()
        snr = 10 ** (looks.snr_db / 10)
        ratios.append(snr / (TIME_BANDWIDTH - snr))
    looks = flight("passive").looks()
    places = aer_to_enu(looks.azimuth_deg, looks.elevation_deg, looks.range_m)
    here = np.array([0.0, 0.0, HEIGHT_M])
    direct = float(one_way(here + aer_to_enu(*TOWER), here, 600e6))
    assert abs(direct - 1) > 0.2
    np.testing.assert_allclose(ratios[1] / ratios[0], expected("passive", places) / direct, 1e-4)


def test_detections_come_and_go_with_the_lobes() -> None:
    """Drones at elevations of crests and of nulls, by the closed form of Pd."""
    sensor = radar(elevation_max_deg=60.0, multipath=GROUND)
    elevations_deg = 1.0 + np.linspace(0.0, 0.17, 12)
    drones = [
        held(f"{k}-{i}", 60 * i + 5, float(elevation_deg), 9000.0)
        for k, elevation_deg in enumerate(elevations_deg)
        for i in range(6)
    ]
    looks = fly(scene([sensor], drones, seed=92), 150).looks()
    assert looks.pd.max() - looks.pd.min() > 0.4
    snr = 10 ** (looks.snr_db / 10)
    alone = mean_snr(sensor, looks.range_m)
    places = aer_to_enu(looks.azimuth_deg, looks.elevation_deg, looks.range_m)
    np.testing.assert_allclose(snr / alone, expected("active", places), rtol=1e-3)
    np.testing.assert_allclose(looks.pd, pd(sensor, looks.range_m, 0.01 * snr / alone), rtol=1e-9)
    for ring in range(len(elevations_deg)):
        rows = np.char.startswith(looks.drone, f"{ring}-")
        p = looks.pd[rows]
        assert_sum(looks.detected[rows].sum(), p.sum(), (p * (1 - p)).sum(), f"{ring}")


def test_check_predicts_the_lobes(tmp_path: Any) -> None:
    from plotfeed.feeds.cli.check import report

    free, over_ground = (
        report(scene([SENSORS["active"] | named], approach(), seed=93))["sensors"][0]
        for named in ({}, {"multipath": GROUND})
    )
    assert over_ground["effects"] == {"multipath": GROUND}
    assert free["effects"] == {}
    gains_db = [
        a["snr_db"] - b["snr_db"] for a, b in zip(over_ground["table"], free["table"], strict=True)
    ]
    assert -40.1 < min(gains_db) < max(gains_db) < 11.2
    assert max(gains_db) - min(gains_db) > 3

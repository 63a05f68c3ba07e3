"""Two rays over flat ground, as the ledger and the bytes have them, beside the sum of two waves."""

from __future__ import annotations

from typing import Any

from plotfeed.testing import flown, radar, scene, staring, waypoint

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


def approach() -> list[dict[str, Any]]:
    """One drone that flies from 3 km to 1 km, some 50 m up."""
    ends = (waypoint(33.0, 1.0, 3000.0), waypoint(33.0, 3.0, 1000.0))
    return [flown("d", *ends, speed_m_s=10.0, repeat=False, emitters=[EMITTER])]


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
